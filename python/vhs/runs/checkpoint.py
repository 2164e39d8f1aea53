"""Checkpoints: complete or absent, the newest complete one counts.

A checkpoint is a directory ``checkpoints/episode-000012345`` with ``state.pt`` (weights, optimiser,
prototypes, generators, counters, and what rebuilds the episodes under way: `vhs.acting.replay`) and
``goals.vhs`` (the goal store). It is written under a temporary name, flushed to disk and then renamed, and
renamed before it is removed, so a kill at any moment leaves whole checkpoints and perhaps temporary names.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from vhs import GoalStore
from vhs.errors import CheckpointError
from vhs.runs.files import new_directory, remove_directory, remove_partial, writing

_DIRECTORY = "checkpoints"
_PREFIX = "episode-"
_STATE = "state.pt"
_GOALS = "goals.vhs"
_NAME = re.compile(rf"{_PREFIX}[0-9]{{9,}}")


def save_checkpoint(
    run: Path, episode: int, state: Mapping[str, Any], goal_store: GoalStore, *, keep: int
) -> Path:
    """Write a checkpoint and remove the oldest beyond `keep`.

    Args:
        run: directory of the run.
        episode: episodes so far; names the checkpoint.
        state: tensors and plain values.
        goal_store: saved beside it.
        keep: number of checkpoints that stay.

    Returns:
        The directory of the checkpoint; one of the same episode stays as it is.

    Raises:
        OutputError: it cannot be written; those before it are untouched.
    """
    root = run / _DIRECTORY
    with writing(root):
        root.mkdir(parents=True, exist_ok=True)
    final = root / f"{_PREFIX}{episode:09d}"
    if final.exists():
        # Nothing has been learned since; replacing it would leave a moment without it.
        return final
    content = io.BytesIO()  # torch would hide what the system says of a full disk
    torch.save(dict(state), content)
    with new_directory(final) as partial, writing(final):
        (partial / _STATE).write_bytes(content.getbuffer())
        goal_store.save(partial / _GOALS)
    for old in _checkpoints(run)[:-keep]:
        remove_directory(old)
    return final


def remove_partial_checkpoints(run: Path) -> None:
    """Remove what a kill while saving left behind; no other process may be saving.

    Raises:
        OutputError: it cannot be removed.
    """
    if (run / _DIRECTORY).is_dir():
        remove_partial(run / _DIRECTORY, rf"{_PREFIX}\d+")


def load_checkpoint(run: Path) -> tuple[dict[str, Any], GoalStore]:
    """Read the newest checkpoint of a run.

    Raises:
        CheckpointError: there is none, it cannot be read, or it is damaged.
    """
    found = _checkpoints(run)
    if not found:
        raise CheckpointError(f"{run}: expected a checkpoint in {run / _DIRECTORY}, found none")
    newest = found[-1]
    try:
        state = torch.load(newest / _STATE, map_location="cpu", weights_only=True)
        goal_store = GoalStore.load(newest / _GOALS, stacking="channels")
    except MemoryError as error:
        raise CheckpointError(f"{newest}: cannot be read: not enough memory") from error
    except Exception as error:  # torch.load raises whatever its reader meets in a damaged file
        if isinstance(error, OSError) and not isinstance(error, FileNotFoundError):
            raise CheckpointError(f"{newest}: cannot be read: {error.strerror or error}") from error
        older = f"; move it away to go on from {found[-2].name}" if len(found) > 1 else ""
        raise CheckpointError(f"{newest}: damaged checkpoint: {error}{older}") from error
    if not isinstance(state, dict):
        raise CheckpointError(f"{newest / _STATE}: expected a mapping, found {type(state).__name__}")
    return state, goal_store


@contextmanager
def fitting(run: Path) -> Iterator[None]:
    """Say that a checkpoint was made by something else when its parts cannot be put to use.

    Raises:
        CheckpointError: a part is missing or does not fit what the configuration describes.
    """
    try:
        yield
    except CheckpointError:
        raise
    except KeyError as error:
        raise CheckpointError(
            f"{run}: expected a checkpoint of this version of vhs, found one without {error}"
        ) from error
    except (IndexError, RuntimeError, TypeError, ValueError) as error:
        raise CheckpointError(f"{run}: the checkpoint does not fit the configuration: {error}") from error


def has_checkpoint(run: Path) -> bool:
    """Whether the run can be resumed."""
    return bool(_checkpoints(run))


def newest_checkpoint(run: Path) -> int:
    """Episodes behind the newest checkpoint of a run, 0 if there is none."""
    return max((_episode(path) for path in _checkpoints(run)), default=0)


def _checkpoints(run: Path) -> list[Path]:
    """The checkpoints in order of their episodes; other names in the directory are not ours."""
    found = [path for path in (run / _DIRECTORY).glob(f"{_PREFIX}*") if _NAME.fullmatch(path.name)]
    return sorted((path for path in found if path.is_dir()), key=_episode)


def _episode(path: Path) -> int:
    return int(path.name.removeprefix(_PREFIX))
