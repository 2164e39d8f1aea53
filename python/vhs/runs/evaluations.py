"""The evaluations of a run: `eval.json` in its directory, an entry for each way in which it was evaluated."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from vhs.errors import CheckpointError
from vhs.reading import read_bounded
from vhs.runs.files import write_files
from vhs.runs.lock import hold
from vhs.runs.seal import sealed, unsealed

EVALUATIONS_NAME = "eval.json"

_IDENTITY: Mapping[str, type] = {"trained_episodes": int, "seed": int, "greedy": bool, "episodes": int}
"""What tells two evaluations of a run apart; the same again replaces the old entry."""
_MOST_BYTES = 10_000_000
_PATIENCE_S = 60.0
"""Others write for moments only."""
_RATES = ("success", "failure", "timeout")
_OPTIONAL = "spl"
"""A rate too; null where the task says no shortest way."""


def record_evaluation(run: Path, evaluation: Mapping[str, Any]) -> None:
    """Add an evaluation to those of a run, or replace the one of the same episodes.

    Args:
        run: directory of the run.
        evaluation: the fields of `Evaluation` by name.

    Raises:
        CheckpointError: the present `eval.json` is damaged; it stays as it is.
        OutputError: the directory cannot be written.
    """
    with hold(run, f"{run}: another process records an evaluation", patience_s=_PATIENCE_S):
        others = [entry for entry in read_evaluations(run) if _identity(entry) != _identity(evaluation)]
        entries = sorted([*others, dict(evaluation)], key=_identity)
        write_files(
            run, {EVALUATIONS_NAME: json.dumps([sealed(entry) for entry in entries], indent=2) + "\n"}
        )


def read_evaluations(run: Path) -> list[dict[str, Any]]:
    """The evaluations of a run, none if it has no `eval.json`.

    Raises:
        CheckpointError: the file is damaged or cannot be read.
    """
    path = run / EVALUATIONS_NAME
    try:
        entries = json.loads(read_bounded(path, _MOST_BYTES))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise CheckpointError(f"{path}: cannot read the evaluations: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise CheckpointError(
            f"{path}: expected JSON, found {error}; delete it and evaluate again"
        ) from error
    if not isinstance(entries, list) or not all(map(_is_evaluation, entries)):
        raise CheckpointError(
            f"{path}: expected a list of evaluations with {', '.join([*_IDENTITY, *_RATES, _OPTIONAL])}; "
            "delete it and evaluate again"
        )
    try:
        return [unsealed(entry) for entry in entries]
    except ValueError as error:
        raise CheckpointError(f"{path}: expected {error}; delete it and evaluate again") from error


def _identity(evaluation: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(evaluation[name] for name in _IDENTITY)


def _is_evaluation(entry: Any) -> bool:
    return (
        isinstance(entry, dict)
        and all(type(entry.get(name)) is kind for name, kind in _IDENTITY.items())
        and all(_is_share(entry.get(name)) for name in _RATES)
        and _OPTIONAL in entry
        and (entry[_OPTIONAL] is None or _is_share(entry[_OPTIONAL]))
    )


def _is_share(value: Any) -> bool:
    return isinstance(value, int | float) and 0 <= value <= 1
