"""Exporting: from a run to a directory small enough to ship, with an agent that acts but cannot train on.

``config.yaml`` is the run's; ``agent.safetensors`` holds networks and prototypes (`vhs.runs.agent_file`);
``run.json`` says what trained it and what exported it.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path

from vhs.acting.policy import TrainedAgent, load_agent
from vhs.acting.setup import to_act_here
from vhs.config import Config, dump_config
from vhs.errors import CheckpointError
from vhs.runs.agent_file import encode_agent
from vhs.runs.directory import AGENT_NAME, CONFIG_NAME, META_NAME, describe, is_exported, read_meta


def export_agent(run: Path, directory: Path) -> TrainedAgent:
    """Write the newest agent of a run to a directory that `load_agent` reads.

    Args:
        run: directory of the run.
        directory: a new or an empty one; it appears complete or not at all.

    Returns:
        What was exported.

    Raises:
        CheckpointError: the run is missing or damaged, or the directory is not empty or cannot be written.
    """
    _check_free(directory)
    if is_exported(run):
        raise CheckpointError(f"{run}: expected the directory of a run, found an exported agent")
    trained, meta = load_agent(run), read_meta(run)
    _fix_prototypes(trained)
    about = {name: str(meta.get(name) or "") for name in ("command", "version", "commit")}
    about["trained_episodes"] = str(trained.trained_episodes)
    exported = {name: describe()[name] for name in ("version", "commit", "time")}
    story = {**meta, "trained_episodes": trained.trained_episodes, "exported": exported}
    files = {
        CONFIG_NAME: dump_config(_on_any_machine(trained.config)).encode(),
        META_NAME: (json.dumps(story, indent=2) + "\n").encode(),
        AGENT_NAME: encode_agent(trained.learner, about),
    }
    _write(directory, files)
    return trained


def _fix_prototypes(trained: TrainedAgent) -> None:
    """Embed exact prototypes now: the goal store that they are drawn from stays behind."""
    if trained.config.method.prototype == "exact":
        for label in range(trained.learner.prototypes.num_classes):
            trained.learner.embed_goal(label)


def _on_any_machine(config: Config) -> Config:
    """The same configuration, acting on the CPU that every machine has."""
    return to_act_here(config.model_copy(update={"train": config.train.model_copy(update={"device": "cpu"})}))


def _check_free(directory: Path) -> None:
    if directory.exists() and not (directory.is_dir() and not any(directory.iterdir())):
        kind = "other files in it" if directory.is_dir() else "a file"
        raise CheckpointError(f"{directory}: expected a new or an empty directory, found {kind}")


def _write(directory: Path, files: Mapping[str, bytes]) -> None:
    """Write a directory under a temporary name, then rename it."""
    final = directory.resolve()
    partial = final.with_name(f".partial-{final.name}")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        for name, content in files.items():
            (partial / name).write_bytes(content)
        if final.exists():
            final.rmdir()
        partial.rename(final)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise CheckpointError(f"{directory}: cannot write the agent: {error.strerror}") from error
