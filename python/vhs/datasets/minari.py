"""Minari data sets: a buffer as one that `minari.load_dataset` reads, and any of them as a buffer."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from typing import Any

import minari
import numpy as np
from gymnasium import spaces
from minari.data_collector import EpisodeBuffer as MinariEpisode
from numpy.typing import NDArray

from vhs._core import ArgumentError, EpisodeBuffer
from vhs.actions import stored_action
from vhs.buffer import as_goal
from vhs.datasets.episodes import Episode, buffer_from, episodes_of, recipe_of, record
from vhs.readers import GoalReader, Seen, entries_of, reader_of
from vhs.task import default_outcome

__all__ = ["from_minari", "to_minari"]

_NOTE = "vhs"
"""The entry of a data set's metadata that says what buffer it is from."""


def to_minari(
    buffer: EpisodeBuffer,
    dataset_id: str,
    *,
    ids: Iterable[int] | None = None,
    action_space: spaces.Space[Any] | None = None,
    jpeg: bool = False,
    **about: Any,
) -> minari.MinariDataset:
    """Write finished episodes as a data set, in Minari's folder of such.

    Observations are dictionaries: `observation`, `achieved_goal` and `desired_goal` where goals are vectors;
    `image` and `goal` (a class, or a picture) where they are not, `interaction` where there are several; and
    fields of observations. Values and fields of steps are infos.

    Args:
        buffer: Holds the episodes. Frames are written once, not as stacks.
        dataset_id: Its name, such as "rooms/random-v0".
        ids: Of the episodes; None: all, oldest first.
        action_space: Of the environment; None: as wide as the buffer's actions.
        jpeg: Whether images are compressed with loss. False: what is read is what was written, to the byte.
        about: Further arguments of `minari.create_dataset_from_buffers`, such as `author` and `env`.

    Raises:
        ArgumentError: When there is no episode to write.
        EpisodeError: For an id that was evicted or never existed.
        ValueError: Of Minari, such as for a data set that exists.
    """
    episodes = list(episodes_of(buffer, ids))
    if not episodes:
        raise ArgumentError("`buffer`: expected finished episodes to write, found none")
    dataset = minari.create_dataset_from_buffers(
        dataset_id,
        [_written(buffer, episode) for episode in episodes],
        observation_space=_observation_space(buffer),
        action_space=_action_space(buffer, episodes) if action_space is None else action_space,
        jpeg_encoding=jpeg,
        **about,
    )
    dataset.storage.update_metadata({_NOTE: recipe_of(buffer)})
    dataset.storage.update_episode_metadata(
        [{"outcome": episode.outcome.name.lower()} for episode in episodes]
    )
    return dataset


def _written(buffer: EpisodeBuffer, episode: Episode) -> MinariEpisode:
    steps, infos = len(episode.rewards), {"value": _with_first(episode.values)}
    shown: dict[str, Any] = {}
    for name, part in episode.fields.items():
        if buffer.fields[name].per == "step":
            infos[name] = _with_first(part)
        else:
            shown[name] = part
    ends = np.arange(steps) == steps - 1
    return MinariEpisode(
        observations=_told(buffer, episode, steps) | shown,
        actions=episode.actions,
        rewards=episode.rewards,
        terminations=ends & episode.terminated,
        truncations=ends & (not episode.terminated),
        infos=infos,
    )


def _told(buffer: EpisodeBuffer, episode: Episode, steps: int) -> dict[str, Any]:
    """Frames, and what the episode is told at each of them."""

    def each(what: Any) -> NDArray[Any]:
        return np.stack([np.asarray(what)] * (steps + 1))

    told: dict[str, Any] = {"image": episode.frames, "goal": each(episode.label)}
    if buffer.goals == "vectors":
        told = {"observation": episode.frames, "achieved_goal": episode.achieved_goals}
        told["desired_goal"] = each(episode.desired_goal)
    elif buffer.goals == "observations":
        told["goal"] = each(episode.desired_goal)
    if buffer.goals != "labels" and buffer.num_goals > 1:
        told["label"] = each(episode.label)
    if buffer.num_interactions > 1:
        told["interaction"] = each(episode.interaction)
    return told


def _with_first(part: Any) -> NDArray[Any]:
    """What steps have, as infos: those of a reset come before."""
    return np.concatenate([np.zeros_like(part[:1]), part])


def _observation_space(buffer: EpisodeBuffer) -> spaces.Dict:
    frame = _box(buffer.frame_shape, buffer.dtype)
    goal = _box(buffer.goal_shape, buffer.goal_dtype)
    parts: dict[str, spaces.Space[Any]] = {"image": frame, "goal": goal}
    if buffer.goals == "vectors":
        parts = {"observation": frame, "achieved_goal": goal, "desired_goal": goal}
    elif buffer.goals == "labels":
        parts["goal"] = spaces.Discrete(buffer.num_goals)
    if buffer.goals != "labels" and buffer.num_goals > 1:
        parts["label"] = spaces.Discrete(buffer.num_goals)
    if buffer.num_interactions > 1:
        parts["interaction"] = spaces.Discrete(buffer.num_interactions)
    for name, declared in buffer.fields.items():
        if declared.per == "observation":
            parts[name] = _box(declared.shape, declared.dtype)
    return spaces.Dict(parts)


def _box(shape: tuple[int, ...], dtype: np.dtype[Any]) -> spaces.Space[Any]:
    if dtype.kind == "b":
        return spaces.Box(0, 1, shape, np.bool_)
    if dtype.kind == "f":
        return spaces.Box(-np.inf, np.inf, shape, dtype)
    limits = np.iinfo(dtype)
    return spaces.Box(limits.min, limits.max, shape, dtype)


def _action_space(buffer: EpisodeBuffer, episodes: list[Episode]) -> spaces.Space[Any]:
    if buffer.action_dim:
        return spaces.Box(-np.inf, np.inf, (buffer.action_dim,), np.float32)
    first, known = buffer.first_action, buffer.num_actions
    if known is None:
        known = max(int(episode.actions.max()) for episode in episodes) + 1 - first
    return spaces.Discrete(known, start=first)


def from_minari(
    dataset: minari.MinariDataset | str,
    buffer: EpisodeBuffer | None = None,
    *,
    reader: GoalReader | None = None,
    seed: int = 0,
) -> EpisodeBuffer:
    """Record the episodes of a data set in a buffer.

    Args:
        dataset: One that was loaded, or its name, in Minari's local folder.
        buffer: Takes them, in its stream 0; None: a new one. A data set of `to_minari` says what it must be;
            of another it is read off the spaces and the first episode.
        reader: Turns one observation into a `Seen`; None: by the observation space, as for
            `HindsightRecorder`.
        seed: Of a new buffer's generator.

    Returns:
        The buffer. How an episode ended is what `default_outcome` says of its last step and info.

    Raises:
        ArgumentError: For a data set without episodes; where no reader is given, for spaces that say nothing
            of goals; where no buffer is given, for one that they do not determine.
        VhsError: What the buffer says of an episode that does not fit; those before it are recorded.
    """
    if isinstance(dataset, str):
        dataset = minari.load_dataset(dataset)
    if not dataset.total_episodes:
        raise ArgumentError("`dataset`: expected one with episodes, found none")
    note = dataset.storage.metadata.get(_NOTE) if reader is None else None
    if reader is None:
        reader = reader_of(dataset.observation_space) if note is None else _own_reader(note)
    if buffer is None:
        buffer = _made(dataset, reader, note, seed)
    for episode in _read(dataset, reader, list(buffer.fields)):
        record(buffer, _fitting(buffer, episode))
    return buffer


def _read(dataset: Any, reader: GoalReader, fields: list[str]) -> Iterator[Episode]:
    every = range(dataset.total_episodes)
    noted = dataset.storage.get_episode_metadata(every)
    for part, metadata in zip(dataset.iterate_episodes(every), noted, strict=True):
        infos = part.infos or {}
        seen = [reader(_at(part.observations, t)) for t in range(len(part) + 1)]
        last = {name: entry[-1] for name, entry in infos.items() if not isinstance(entry, dict)}
        if "outcome" in metadata:
            last["outcome"] = str(metadata["outcome"])
        terminated, truncated = bool(part.terminations[-1]), bool(part.truncations[-1])
        shown = {name: np.stack([each.fields[name] for each in seen]) for name in seen[0].fields}
        yield Episode(
            frames=np.stack([np.atleast_1d(each.frame) for each in seen]),
            actions=np.stack([stored_action(action, dataset.action_space) for action in part.actions]),
            rewards=np.asarray(part.rewards),
            values=infos["value"][1:] if "value" in infos else None,
            outcome=default_outcome(float(part.rewards[-1]), terminated, truncated, last),
            terminated=terminated,
            label=seen[0].label,
            interaction=seen[0].interaction,
            desired_goal=seen[0].desired_goal,
            achieved_goals=_stacked([each.achieved_goal for each in seen]),
            fields=shown | {name: infos[name][1:] for name in fields if name in infos},
        )


def _at(observations: Any, t: int) -> Any:
    """One observation of an episode's, nested alike."""
    if isinstance(observations, dict):
        return {name: _at(part, t) for name, part in observations.items()}
    if isinstance(observations, tuple):
        return tuple(_at(part, t) for part in observations)
    return observations[t]


def _stacked(goals: list[NDArray[Any] | None]) -> NDArray[Any] | None:
    return None if goals[0] is None else np.stack([np.atleast_1d(goal) for goal in goals if goal is not None])


def _own_reader(note: dict[str, Any]) -> GoalReader:
    """The reader of what `_told` wrote."""
    names = [name for name, (_, _, per, _) in note["fields"].items() if per == "observation"]

    def read(observation: Any) -> Seen:
        is_vector, is_class = note["goals"] == "vectors", note["goals"] == "labels"
        return Seen(
            frame=observation["observation" if is_vector else "image"],
            label=int(observation["goal"] if is_class else observation.get("label", 0)),
            interaction=int(observation.get("interaction", 0)),
            desired_goal=None if is_class else observation["desired_goal" if is_vector else "goal"],
            achieved_goal=observation["achieved_goal"] if is_vector else None,
            fields={name: observation[name] for name in names},
        )

    return read


def _made(dataset: Any, reader: GoalReader, note: dict[str, Any] | None, seed: int) -> EpisodeBuffer:
    """A buffer that fits: as the note says, or as the first episode shows."""
    room = int(dataset.total_steps)
    if note is not None:
        return buffer_from(note, capacity_steps=room, seed=seed)
    first, space = next(_read(dataset, reader, [])), dataset.action_space
    every = dataset.storage.get_episode_metadata(range(dataset.total_episodes))
    vectors = first.achieved_goals is not None
    recipe: dict[str, Any] = {
        "frame_shape": first.frames.shape[1:],
        "dtype": first.frames.dtype,
        "max_episode_steps": max(int(metadata["total_steps"]) for metadata in every),
        "frame_stack": 1,
        "goals": "vectors" if vectors else "labels" if first.desired_goal is None else "observations",
        "interactions": [],
        "fields": {name: (part.shape[1:], part.dtype) for name, part in first.fields.items()},
    }
    if vectors:
        assert first.achieved_goals is not None
        recipe |= {"goal_shape": first.achieved_goals.shape[1:], "goal_dtype": first.achieved_goals.dtype}
    if isinstance(space, spaces.Discrete):
        recipe |= {"num_actions": int(space.n), "first_action": int(space.start)}
    else:
        recipe["action_dim"] = first.actions.shape[-1]
    goal = entries_of(dataset.observation_space).get("goal")
    if recipe["goals"] == "labels":
        if not isinstance(goal, spaces.Discrete) or "interaction" in entries_of(dataset.observation_space):
            raise ArgumentError(
                "`buffer`: expected one that says how many goals there are and which action does which "
                "interaction, got None for spaces that do not"
            )
        recipe["num_goals"] = int(goal.n)
    return buffer_from(recipe, capacity_steps=room, seed=seed)


def _fitting(buffer: EpisodeBuffer, episode: Episode) -> Episode:
    """The episode with actions as the buffer counts them, and a goal that is a picture as it stacks them."""
    actions = episode.actions if buffer.action_dim else episode.actions + buffer.first_action
    goal = episode.desired_goal
    goal = None if goal is None else as_goal(buffer, np.atleast_1d(goal))
    return dataclasses.replace(episode, actions=actions, desired_goal=goal)
