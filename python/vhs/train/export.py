"""Exporting: from a run to a directory small enough to ship, with an agent that acts but cannot train on.

``config.yaml`` is the run's; ``agent.safetensors`` holds networks and prototypes (`vhs.runs.agent_file`);
``run.json`` says what trained it and what exported it.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from vhs.acting.policy import Policy, load_agent
from vhs.acting.setup import to_act_here
from vhs.config import Config, dump_config
from vhs.errors import CheckpointError
from vhs.runs.agent_file import CONFIG_DIGEST, encode_agent
from vhs.runs.directory import AGENT_NAME, CONFIG_NAME, META_NAME, describe, is_exported, read_meta
from vhs.runs.files import is_partial, write_files
from vhs.runs.seal import sealed
from vhs.task import Task


def export_agent(run: Path, directory: Path, task: Task | None = None) -> Policy:
    """Write the newest agent of a run to a directory that `load_agent` reads.

    Args:
        run: directory of the run.
        directory: a new or an empty one, a mounted volume too; it holds a whole agent or none.
        task: what it was trained on; None: the task that its configuration names.

    Returns:
        What was exported.

    Raises:
        CheckpointError: the run is missing or damaged, or the directory is not empty.
        OutputError: the directory cannot be written.
    """
    _check_free(directory)
    if is_exported(run):
        raise CheckpointError(f"{run}: expected the directory of a run, found an exported agent")
    trained, meta = load_agent(run, task), read_meta(run)
    for label in range(len(trained.goals.counts)):
        trained.goals.refresh(label)  # exact prototypes: the images behind them stay here
    about = {name: str(meta.get(name) or "") for name in ("command", "version", "commit")}
    about["trained_episodes"] = str(trained.trained_episodes)
    config = dump_config(_on_any_machine(trained.config))
    about[CONFIG_DIGEST] = hashlib.sha256(config.encode()).hexdigest()
    exported = {name: describe()[name] for name in ("version", "commit", "time")}
    story = {**meta, "trained_episodes": trained.trained_episodes, "exported": exported}
    files: dict[str, str | bytes] = {
        AGENT_NAME: encode_agent(trained.agent, trained.goals, about),
        META_NAME: json.dumps(sealed(story), indent=2) + "\n",
        # Last: a directory without a configuration is neither a run nor an agent.
        CONFIG_NAME: config,
    }
    write_files(directory, files)
    return trained


def _on_any_machine(config: Config) -> Config:
    """The same configuration, acting on the CPU that every machine has."""
    return to_act_here(config.model_copy(update={"train": config.train.model_copy(update={"device": "cpu"})}))


def _check_free(directory: Path) -> None:
    if not directory.exists():
        return
    if not directory.is_dir() or not all(map(is_partial, directory.iterdir())):
        kind = "other files in it" if directory.is_dir() else "a file"
        raise CheckpointError(f"{directory}: expected a new or an empty directory, found {kind}")
