"""How far a run of a sweep is, read from its directory alone: that is what makes a sweep resumable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from vhs.runs.checkpoint import newest_checkpoint
from vhs.runs.evaluations import read_evaluations
from vhs.runs.rows import read_log
from vhs.sweep.file import EvalSection
from vhs.sweep.plan import PlannedRun

Stage = Literal["train", "eval", "finished"]


def next_stage(run: PlannedRun, directory: Path, evaluation: EvalSection) -> Stage:
    """What is left to do: training, its evaluation, or nothing.

    Raises:
        CheckpointError: the evaluations are damaged.
    """
    if newest_checkpoint(directory) < run.config.train.episodes:
        return "train"
    return "eval" if find_evaluation(directory, evaluation) is None else "finished"


def find_evaluation(directory: Path, evaluation: EvalSection) -> Mapping[str, Any] | None:
    """The wanted evaluation of the newest checkpoint, if it is there."""
    wanted = evaluation.model_dump() | {"trained_episodes": newest_checkpoint(directory)}
    entries = read_evaluations(directory)
    return next((entry for entry in entries if wanted.items() <= entry.items()), None)


def newest_row(directory: Path) -> Mapping[str, Any] | None:
    """The last row of a run's log that can be read; None where there is none."""
    rows = rows_so_far(directory)
    return rows[-1] if rows else None


def rows_so_far(directory: Path) -> Sequence[Mapping[str, Any]]:
    """The rows of a run's log that can be read."""
    return read_log(directory, on_damage=lambda error: None)
