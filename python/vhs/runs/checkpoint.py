"""Checkpoints: complete or absent, the newest complete one counts, and none is read that has changed.

A checkpoint is a directory ``checkpoints/episode-000012345`` with `state.json` and `state.safetensors`
(weights, optimiser, prototypes, kept episodes, generators, counters, and what rebuilds the episodes under
way: `vhs.acting.resume`), `goals.vhs` (the goal store) and, written last, `manifest.json`, which has the
SHA-256 of each of them. It appears under its name when it is whole, and loses that name before a file of it
is removed, so a kill at any moment leaves whole checkpoints and perhaps temporary names. Other names are
not ours.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vhs import DamagedFileError, GoalStore, UnsupportedError
from vhs.errors import CheckpointError, without_frames
from vhs.reading import read_bounded
from vhs.runs.files import new_directory, remove_directory, remove_partial, write_files, writing
from vhs.runs.state import decode_state, encode_state

FORMAT = "vhs-checkpoint-2"
"""1 was `state.pt`, a pickle without a digest, of vhs up to 0.1.0."""

_DIRECTORY = "checkpoints"
_PREFIX = "episode-"
_NAME = re.compile(rf"{_PREFIX}[0-9]{{9,}}")
_MANIFEST, _TREE, _TENSORS, _GOALS = "manifest.json", "state.json", "state.safetensors", "goals.vhs"
_OLD_STATE = "state.pt"
_MOST_BYTES = {_MANIFEST: 100_000, _TREE: 2**30, _TENSORS: 2**36}
_PIECE = 1 << 20
_DAMAGE = (FileNotFoundError, ValueError, DamagedFileError, UnsupportedError)


def save_checkpoint(
    run: Path, episode: int, state: Mapping[str, Any], goal_store: GoalStore, *, keep: int
) -> Path:
    """Write a checkpoint and remove the oldest beyond `keep`.

    Args:
        run: directory of the run.
        episode: episodes so far; names the checkpoint.
        state: tensors and plain values, as `vhs.runs.state` takes them.
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
    tree, tensors = encode_state(state)
    with new_directory(final) as partial:
        with writing(final):
            (partial / _TREE).write_bytes(tree)
            (partial / _TENSORS).write_bytes(tensors)
            goal_store.save(partial / _GOALS)
            manifest = {"format": FORMAT, "episodes": episode, "files": _digests(partial)}
        write_files(partial, {_MANIFEST: json.dumps(manifest, indent=2) + "\n"})
    for old in _checkpoints(run)[:-keep]:
        remove_directory(old)
    return final


def load_checkpoint(run: Path) -> tuple[dict[str, Any], GoalStore]:
    """Read the newest checkpoint of a run.

    Raises:
        CheckpointError: there is none, it cannot be read, a file of it has changed since it was written, or
            another version made it.
    """
    found = _checkpoints(run)
    if not found:
        raise CheckpointError(f"{run}: expected a checkpoint in {run / _DIRECTORY}, found none")
    try:
        return read_checkpoint(found[-1])
    except CheckpointError as error:
        if not isinstance(error.__cause__, _DAMAGE) or len(found) < 2:
            raise
        raise CheckpointError(f"{error}; move it away to go on from {found[-2].name}") from error


def read_checkpoint(checkpoint: Path) -> tuple[dict[str, Any], GoalStore]:
    """Read one checkpoint.

    Args:
        checkpoint: its directory.

    Raises:
        CheckpointError: as `load_checkpoint`.
    """
    try:
        _check(checkpoint)
        tree, tensors = (read_bounded(checkpoint / name, _MOST_BYTES[name]) for name in (_TREE, _TENSORS))
        state, goal_store = decode_state(tree, tensors), GoalStore.load(checkpoint / _GOALS)
        if not isinstance(state, dict):
            raise ValueError(f"expected a mapping as state, found {type(state).__name__}")
    except MemoryError as error:
        raise CheckpointError(f"{checkpoint}: cannot be read: not enough memory") from error
    except _DAMAGE as error:
        raise CheckpointError(f"{checkpoint}: damaged checkpoint: {without_frames(error)}") from error
    except OSError as error:
        raise CheckpointError(f"{checkpoint}: cannot be read: {error.strerror or error}") from error
    return state, goal_store


def remove_partial_checkpoints(run: Path) -> None:
    """Remove what a kill while saving left behind; no other process may be saving.

    Raises:
        OutputError: it cannot be removed.
    """
    if (run / _DIRECTORY).is_dir():
        remove_partial(run / _DIRECTORY, _NAME.pattern)


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
    except (AttributeError, IndexError, RuntimeError, TypeError, ValueError) as error:
        raise CheckpointError(
            f"{run}: the checkpoint does not fit the configuration: {without_frames(error)}"
        ) from error


def has_checkpoint(run: Path) -> bool:
    """Whether the run can be resumed."""
    return bool(_checkpoints(run))


def newest_checkpoint(run: Path) -> int:
    """Episodes behind the newest checkpoint of a run, 0 if there is none."""
    return max((_episode(path) for path in _checkpoints(run)), default=0)


def _check(checkpoint: Path) -> None:
    """Compare a checkpoint with its manifest.

    Raises:
        CheckpointError: vhs up to 0.1.0 made it.
        OSError: a file is missing or cannot be read.
        ValueError: a file has changed since the manifest was written, or another version wrote it.
    """
    if (checkpoint / _OLD_STATE).exists() and not (checkpoint / _MANIFEST).exists():
        raise CheckpointError(
            f"{checkpoint}: expected a checkpoint of format {FORMAT}, found {_OLD_STATE}, which vhs up to "
            "0.1.0 wrote; go on with that version, or export the agent with it"
        )
    manifest = json.loads(read_bounded(checkpoint / _MANIFEST, _MOST_BYTES[_MANIFEST]))
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        found = manifest.get("format") if isinstance(manifest, dict) else type(manifest).__name__
        raise ValueError(f"expected one of format {FORMAT}, found {found!r}")
    if manifest.get("episodes") != _episode(checkpoint):
        raise ValueError(f"its manifest is that of episode {manifest.get('episodes')}")
    if not isinstance(manifest.get("files"), dict) or set(manifest["files"]) != {_TREE, _TENSORS, _GOALS}:
        raise ValueError("its manifest lists other files than a checkpoint has")
    for name, digest in _digests(checkpoint).items():
        if manifest["files"][name] != digest:
            raise ValueError(f"{name} is another file than the one that was written")


def _digests(checkpoint: Path) -> dict[str, str]:
    """SHA-256 of each file of a checkpoint but the manifest, by name."""
    return {name: _sha256(checkpoint / name) for name in (_TREE, _TENSORS, _GOALS)}


def _sha256(path: Path) -> str:
    if not path.is_file() and path.exists():
        raise ValueError(f"{path.name} is no regular file")
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            digest.update(piece)
    return digest.hexdigest()


def _checkpoints(run: Path) -> list[Path]:
    """The checkpoints in order of their episodes."""
    found = [path for path in (run / _DIRECTORY).glob(f"{_PREFIX}*") if _NAME.fullmatch(path.name)]
    return sorted((path for path in found if path.is_dir()), key=_episode)


def _episode(path: Path) -> int:
    return int(path.name.removeprefix(_PREFIX))
