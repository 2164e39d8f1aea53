"""Pushing: an exported agent with evaluation, film and card, as one commit to the Hugging Face Hub."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from vhs.errors import ConfigError, OutputError
from vhs.eval import evaluate
from vhs.hub.card import FILM_NAME, model_card
from vhs.play import play
from vhs.runs.directory import AGENT_NAME, CONFIG_NAME, META_NAME, is_exported, read_config, read_meta
from vhs.runs.evaluations import read_evaluations, record_evaluation
from vhs.runs.remote import SCHEME, answering, repository
from vhs.task import Task
from vhs.train.export import export_agent

_EPISODES = 3
"""In the film."""


def push(
    run: Path,
    named: str,
    *,
    episodes: int = 300,
    task: Task | None = None,
    private: bool = False,
) -> str:
    """Push a trained agent.

    Args:
        run: directory of a run, or of an exported agent.
        named: ``user/name``, made on the Hub where it is not there yet.
        episodes: of the evaluation that is made where the run has none of its present agent.
        task: what it was trained on; None: the task that its configuration names.
        private: whether a new repository is seen by its owner alone.

    Returns:
        The address of the commit.

    Raises:
        CheckpointError: the run is missing or damaged.
        ConfigError: no such name can be.
        OutputError: the Hub refuses it, or cannot be reached.
    """
    from huggingface_hub import HfApi

    repo, revision = repository(SCHEME + named.removeprefix(SCHEME))
    if revision is not None:
        raise ConfigError(f"{named}: expected user/name, found a revision")
    with tempfile.TemporaryDirectory(prefix="vhs-push-") as folder:
        packed = Path(folder) / "agent"
        pack(run, packed, repo, episodes=episodes, task=task)
        with answering(SCHEME + repo, OutputError):
            api = HfApi()
            api.create_repo(repo, private=private, exist_ok=True)
            done = api.upload_folder(repo_id=repo, folder_path=packed, commit_message="Push an agent of vhs")
    return str(done.commit_url)


def pack(run: Path, directory: Path, repo: str, *, episodes: int, task: Task | None) -> None:
    """Write everything that is pushed into a new directory; arguments and errors as for `push`."""
    if is_exported(run):
        directory.mkdir()
        for name in (AGENT_NAME, META_NAME, CONFIG_NAME):
            shutil.copyfile(run / name, directory / name)
        evaluations = read_evaluations(run)
    else:
        trained = export_agent(run, directory, task).trained_episodes
        evaluations = [entry for entry in read_evaluations(run) if entry["trained_episodes"] == trained]
    if not evaluations:
        evaluations = [evaluate(directory, episodes=episodes, task=task).as_dict()]
    for entry in evaluations:
        record_evaluation(directory, entry)
    play(directory, episodes=_EPISODES, out=directory / FILM_NAME, task=task)
    card = model_card(repo, read_config(directory), read_meta(directory), _shown(evaluations))
    (directory / "README.md").write_text(card, encoding="utf-8")


def _shown(evaluations: list[dict[str, Any]]) -> Mapping[str, Any]:
    """The evaluation of a card: actions sampled, over the most episodes, of the lowest seed."""
    return min(evaluations, key=lambda entry: (entry["greedy"], -entry["episodes"], entry["seed"]))
