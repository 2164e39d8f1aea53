"""LeRobot data sets: a buffer as one that `LeRobotDataset` reads, and any of them as a buffer.

A row of theirs is an observation and the action that followed; what was seen after an episode's last action
has no row. What we write keeps it, and all else that rows do not say, in `meta/vhs.npz` and `meta/vhs.json`,
which LeRobot leaves alone. Of others' data sets the last row's observation stands for it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from numpy.typing import NDArray

from vhs._core import ArgumentError, EpisodeBuffer
from vhs.datasets.episodes import Episode, buffer_from, episodes_of, recipe_of, record
from vhs.task import Outcome

__all__ = ["from_lerobot", "to_lerobot"]

_IMAGE, _STATE, _ACHIEVED = "observation.image", "observation.state", "observation.achieved_goal"


def to_lerobot(
    buffer: EpisodeBuffer,
    repo_id: str,
    root: str | PathLike[str],
    *,
    fps: int,
    ids: Iterable[int] | None = None,
    task: Callable[[Episode], str] | None = None,
    video: bool = False,
) -> LeRobotDataset:
    """Write finished episodes as a data set.

    Rows have `observation.image` where frames are colour pictures, uint8 [H, W, 3], and `observation.state`
    where they are not; `action`, `next.reward`, `next.done`, `next.success`; `observation.achieved_goal`
    where goals are vectors; fields of observations as `observation.NAME`, of steps as `step.NAME`.

    Args:
        buffer: Holds the episodes. Frames are written once, not as stacks.
        repo_id: Name of the data set, such as "me/rooms".
        root: Its folder, which must not exist.
        fps: Steps a second, for timestamps.
        ids: Of the episodes; None: all, oldest first.
        task: What an episode is told, in words; None: "goal 3" of class 3.
        video: Whether pictures are compressed, with loss, as films. False: as PNG; what is read is then what
            was written, to the byte.

    Returns:
        The data set, finalised: to be read.

    Raises:
        ArgumentError: When there is no episode to write.
        EpisodeError: For an id that was evicted or never existed.
        OSError: For a folder that exists.
    """
    episodes = list(episodes_of(buffer, ids))
    if not episodes:
        raise ArgumentError("`buffer`: expected finished episodes to write, found none")
    said = task or (lambda episode: f"goal {episode.label}")
    dataset = LeRobotDataset.create(repo_id, fps, _features(buffer, video), root=root, use_videos=video)
    for episode in episodes:
        for row in _rows(buffer, episode):
            dataset.add_frame({**row, "task": said(episode)})
        dataset.save_episode()
    dataset.finalize()
    _note(buffer, episodes, Path(root) / "meta")
    return LeRobotDataset(repo_id, root=root)


def _frame_name(buffer: EpisodeBuffer) -> str:
    shape = buffer.frame_shape
    return _IMAGE if buffer.dtype == np.uint8 and len(shape) == 3 and shape[-1] == 3 else _STATE


def _features(buffer: EpisodeBuffer, video: bool) -> dict[str, Any]:
    def of(dtype: Any, shape: tuple[int, ...] = ()) -> dict[str, Any]:
        return {"dtype": np.dtype(dtype).name, "shape": shape or (1,), "names": None}

    features = {"action": of("float32", (buffer.action_dim,)) if buffer.action_dim else of("int64")}
    features |= {"next.reward": of("float32"), "next.done": of("bool"), "next.success": of("bool")}
    features["step.value"] = of("float32")
    if _frame_name(buffer) == _IMAGE:
        kind = "video" if video else "image"
        features[_IMAGE] = {
            "dtype": kind,
            "shape": buffer.frame_shape,
            "names": ["height", "width", "channels"],
        }
    else:
        features[_STATE] = of(buffer.dtype, buffer.frame_shape)
    if buffer.goals == "vectors":
        features[_ACHIEVED] = of(buffer.goal_dtype, buffer.goal_shape)
    for name, declared in buffer.fields.items():
        features[f"{declared.per}.{name}"] = of(declared.dtype, declared.shape)
    return features


def _rows(buffer: EpisodeBuffer, episode: Episode) -> Iterator[dict[str, Any]]:
    steps, values = len(episode.rewards), episode.values
    assert values is not None
    for t in range(steps):
        is_last = t == steps - 1
        row: dict[str, Any] = {
            _frame_name(buffer): episode.frames[t],
            "action": np.atleast_1d(episode.actions[t]),
            "next.reward": episode.rewards[t : t + 1],
            "next.done": np.array([is_last]),
            "next.success": np.array([is_last and episode.outcome is Outcome.SUCCESS]),
            "step.value": values[t : t + 1],
        }
        if episode.achieved_goals is not None:
            row[_ACHIEVED] = episode.achieved_goals[t]
        for name, part in episode.fields.items():
            row[f"{buffer.fields[name].per}.{name}"] = np.atleast_1d(part[t])
        yield row


def _note(buffer: EpisodeBuffer, episodes: list[Episode], folder: Path) -> None:
    """Keep what rows do not say."""
    kept: dict[str, Any] = {
        "lengths": [len(episode.rewards) for episode in episodes],
        "frames": [episode.frames[-1] for episode in episodes],
        "outcomes": [int(episode.outcome) for episode in episodes],
        "terminated": [episode.terminated for episode in episodes],
        "labels": [episode.label for episode in episodes],
        "interactions": [episode.interaction for episode in episodes],
    }
    if buffer.goals != "labels":
        kept["desired_goals"] = [episode.desired_goal for episode in episodes]
    if buffer.goals == "vectors":
        kept["achieved_goals"] = [episode.achieved_goals[-1] for episode in episodes]  # type: ignore[index]
    for name, declared in buffer.fields.items():
        if declared.per == "observation":
            kept[f"fields.{name}"] = [episode.fields[name][-1] for episode in episodes]
    stacked: dict[str, Any] = {name: np.stack(parts) for name, parts in kept.items()}
    np.savez(folder / "vhs.npz", **stacked)
    (folder / "vhs.json").write_text(json.dumps(recipe_of(buffer)), encoding="utf-8")


def from_lerobot(
    dataset: LeRobotDataset, buffer: EpisodeBuffer | None = None, *, image: str | None = None, seed: int = 0
) -> EpisodeBuffer:
    """Record the episodes of a data set in a buffer.

    Of a data set that `to_lerobot` wrote, all comes back. Of another one, frames are the pictures of one
    camera, or `observation.state` where there is none; what else is observed in numbers becomes fields; the
    class of an episode's goal is its `task_index`; rewards are `next.reward`, or 0; an episode whose last
    `next.success` is true is a success that ended the task, another a timeout.

    Args:
        dataset: A `LeRobotDataset`, of all episodes or some.
        buffer: Takes them, in its stream 0; None: a new one that fits.
        image: The camera, such as "observation.images.top"; None: the first one.
        seed: Of a new buffer's generator.

    Raises:
        ArgumentError: For a camera that there is not, a data set without observations, or one of ours whose
            episodes were changed since.
        VhsError: What the buffer says of an episode that does not fit; those before it are recorded.
    """
    meta = Path(dataset.root) / "meta"
    is_own = dataset.episodes is None and (meta / "vhs.json").is_file()
    read: Iterator[Episode]
    if is_own:
        recipe = json.loads((meta / "vhs.json").read_text(encoding="utf-8"))
        with np.load(meta / "vhs.npz") as kept:
            read = _own(_Rows(dataset), recipe, dict(kept))
    else:
        episodes = list(_foreign(_Rows(dataset), _frames_of(dataset, image)))
        recipe, read = _recipe(episodes), iter(episodes)
    if buffer is None:
        buffer = buffer_from(recipe, capacity_steps=int(dataset.num_frames), seed=seed)
    for episode in read:
        record(buffer, episode)
    return buffer


class _Rows:
    """The columns of a data set, and the rows of each of its episodes."""

    def __init__(self, dataset: LeRobotDataset) -> None:
        self.dataset = dataset
        self.features: dict[str, Any] = dataset.meta.features
        self._table = dataset.hf_dataset.with_format("arrow")
        numbers = np.array(self._table["episode_index"].to_pylist())
        starts = np.flatnonzero(np.diff(numbers, prepend=numbers[:1] - 1))
        ends = [*starts[1:].tolist(), len(numbers)]
        self.episodes = [slice(*span) for span in zip(starts.tolist(), ends, strict=True)]

    def pictures(self, name: str, rows: slice) -> NDArray[np.uint8]:
        """uint8 [T, H, W, C]; LeRobot shows them as float32 [C, H, W] in 0..1."""
        shown = [self.dataset[row][name].numpy() for row in range(rows.start, rows.stop)]
        stack = np.stack(shown).transpose(0, 2, 3, 1)
        return stack if stack.dtype == np.uint8 else np.rint(stack * 255).astype(np.uint8)

    def numbers(self, name: str, rows: slice) -> NDArray[Any]:
        """[T, *shape]; as they are stored, not in float32 as LeRobot shows them. One number is [T]."""
        feature = self.features[name]
        shape = () if tuple(feature["shape"]) == (1,) else tuple(feature["shape"])
        part = self._table[rows][name].to_pylist()
        return np.array(part, dtype=feature["dtype"]).reshape(len(part), *shape)

    def frames(self, name: str, rows: slice) -> NDArray[Any]:
        if self.features[name]["dtype"] in ("image", "video"):
            return self.pictures(name, rows)
        part = self.numbers(name, rows)
        return part[:, None] if part.ndim == 1 else part


def _own(rows: _Rows, recipe: dict[str, Any], kept: dict[str, NDArray[Any]]) -> Iterator[Episode]:
    lengths = [span.stop - span.start for span in rows.episodes]
    if lengths != kept["lengths"].tolist():
        raise ArgumentError(
            f"`dataset`: expected episodes of {kept['lengths'].tolist()} steps, as meta/vhs.npz says, found "
            f"{lengths}: it was changed since; without meta/vhs.json it is read as another's"
        )
    for number, span in enumerate(rows.episodes):

        def whole(name: str, last: str, span: slice = span, number: int = number) -> NDArray[Any]:
            part = rows.frames(name, span)
            final = kept[last][number]
            return np.concatenate([part.reshape(len(part), *final.shape), final[None]])

        fields = {}
        for name, (shape, _, per, _) in recipe["fields"].items():
            if per == "observation":
                fields[name] = whole(f"observation.{name}", f"fields.{name}")
            else:
                part = rows.numbers(f"step.{name}", span)
                fields[name] = part.reshape(len(part), *shape)
        actions = rows.numbers("action", span)
        yield Episode(
            frames=whole(_IMAGE if _IMAGE in rows.features else _STATE, "frames"),
            actions=actions.reshape(-1, recipe["action_dim"]) if recipe["action_dim"] else actions,
            rewards=rows.numbers("next.reward", span),
            values=rows.numbers("step.value", span),
            outcome=Outcome(int(kept["outcomes"][number])),
            terminated=bool(kept["terminated"][number]),
            label=int(kept["labels"][number]),
            interaction=int(kept["interactions"][number]),
            desired_goal=kept["desired_goals"][number] if "desired_goals" in kept else None,
            achieved_goals=whole(_ACHIEVED, "achieved_goals") if "achieved_goals" in kept else None,
            fields=fields,
        )


def _frames_of(dataset: LeRobotDataset, image: str | None) -> str:
    """What frames are taken from."""
    cameras = list(dataset.meta.camera_keys)
    if image is not None:
        if image not in cameras:
            known = ", ".join(cameras) or "no camera"
            raise ArgumentError(f"`image`: expected one of {known}, got {image!r}")
        return image
    if cameras:
        return str(cameras[0])
    if _STATE in dataset.meta.features:
        return _STATE
    raise ArgumentError(f"`dataset`: expected a camera or {_STATE}, found {', '.join(dataset.meta.features)}")


def _foreign(rows: _Rows, frames: str) -> Iterator[Episode]:
    cameras = set(rows.dataset.meta.camera_keys)
    beside = [
        name
        for name in rows.features
        if name.startswith("observation.") and name != frames and name not in cameras
    ]
    for span in rows.episodes:
        count = span.stop - span.start
        done = "next.success" in rows.features and bool(rows.numbers("next.success", span)[-1])
        actions = rows.numbers("action", span)
        if actions.ndim != 1 or actions.dtype.kind not in "iu":
            actions = actions.reshape(count, -1).astype(np.float32)
        others = {name: _with_last(rows.numbers(name, span)) for name in beside}
        has_rewards = "next.reward" in rows.features
        yield Episode(
            frames=_with_last(rows.frames(frames, span)),
            actions=actions,
            rewards=rows.numbers("next.reward", span) if has_rewards else np.zeros(count, np.float32),
            outcome=Outcome.SUCCESS if done else Outcome.TIMEOUT,
            terminated=done,
            label=int(rows.numbers("task_index", span)[0]),
            fields={name.removeprefix("observation."): part for name, part in others.items()},
        )


def _with_last(part: NDArray[Any]) -> NDArray[Any]:
    return np.concatenate([part, part[-1:]])


def _recipe(episodes: list[Episode]) -> dict[str, Any]:
    """A buffer that fits others' episodes."""
    first = episodes[0]
    return {
        "frame_shape": first.frames.shape[1:],
        "dtype": first.frames.dtype,
        "max_episode_steps": max(len(episode.rewards) for episode in episodes),
        "frame_stack": 1,
        "num_goals": max(episode.label for episode in episodes) + 1,
        "interactions": [],
        "action_dim": first.actions.shape[1] if first.actions.ndim == 2 else 0,
        "fields": {name: (part.shape[1:], part.dtype) for name, part in first.fields.items()},
    }
