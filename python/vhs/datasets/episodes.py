"""One finished episode as plain arrays, out of a buffer and into one: what every data set is made from.

Frames stand alone here, each once, however a buffer stacks them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhs._core import EpisodeBatch, EpisodeBuffer, Field
from vhs.task import Outcome

__all__ = ["Episode", "buffer_from", "episodes_of", "recipe_of", "record"]


@dataclass(frozen=True)
class Episode:
    """T steps and T + 1 frames."""

    frames: NDArray[Any]
    """[T + 1, *frame_shape]."""
    actions: NDArray[Any]
    """int64 [T], or float32 [T, action_dim]."""
    rewards: NDArray[np.float32]
    """[T]."""
    outcome: Outcome
    terminated: bool
    """Whether the last step ended the task, rather than a limit."""
    label: int = 0
    interaction: int = 0
    values: NDArray[np.float32] | None = None
    """[T]; None: zeros."""
    desired_goal: NDArray[Any] | None = None
    """[*goal_shape]."""
    achieved_goals: NDArray[Any] | None = None
    """[T + 1, *goal_shape]; None where frames are what is reached."""
    fields: dict[str, NDArray[Any]] = field(default_factory=dict)
    """Each [T + 1, *shape], of observations, or [T, *shape], of steps."""


def episodes_of(buffer: EpisodeBuffer, ids: Iterable[int] | None = None) -> Iterator[Episode]:
    """Finished episodes, one at a time.

    Args:
        buffer: Holds them.
        ids: Which; None: all, oldest first.

    Raises:
        EpisodeError: For an id that was evicted or never existed.
    """
    for number in buffer.ids.tolist() if ids is None else ids:
        yield _episode(buffer, buffer.gather([number]))


def _episode(buffer: EpisodeBuffer, batch: EpisodeBatch) -> Episode:
    desired, achieved = batch.desired_goals, batch.achieved_goals
    return Episode(
        frames=_newest(batch.observations, buffer, buffer.frame_shape),
        actions=batch.actions[0],
        rewards=batch.rewards[0],
        values=batch.values[0],
        outcome=Outcome(int(batch.outcomes[0])),
        terminated=bool(batch.terminated[0]),
        label=int(batch.goals[0]),
        interaction=int(batch.interactions[0]),
        desired_goal=None if desired is None else desired[0],
        achieved_goals=achieved,
        fields={
            name: _field(batch.fields[name], buffer, declared) for name, declared in buffer.fields.items()
        },
    )


def _field(array: Any, buffer: EpisodeBuffer, declared: Field) -> Any:
    if declared.per == "step":
        return array[0]
    return _newest(array, buffer, declared.shape) if declared.stacked else array


def _newest(stacks: Any, buffer: EpisodeBuffer, shape: tuple[int, ...]) -> Any:
    """The newest frame of each stack, [T + 1, *shape]."""
    return stacks[:, -1] if buffer.stacking == "frames" else stacks[..., -shape[-1] :]


def record(buffer: EpisodeBuffer, episode: Episode, stream: int = 0) -> int:
    """Store an episode in a buffer whose stream has none open; its id.

    Raises:
        VhsError: What the buffer says of an episode that does not fit; nothing of it is then stored.
    """
    of_steps = {name for name, declared in buffer.fields.items() if declared.per == "step"}
    shown = {name: part for name, part in episode.fields.items() if name not in of_steps}
    achieved, values = episode.achieved_goals, episode.values
    buffer.begin(
        stream,
        episode.frames[0],
        episode.label,
        episode.interaction,
        desired_goal=episode.desired_goal,
        achieved_goal=None if achieved is None else achieved[0],
        fields={name: part[0] for name, part in shown.items()},
    )
    try:
        for t, action in enumerate(episode.actions):
            after = {name: part[t + 1] for name, part in shown.items()}
            buffer.append(
                stream,
                action if buffer.action_dim else int(action),
                float(episode.rewards[t]),
                None if values is None else float(values[t]),
                episode.frames[t + 1],
                achieved_goal=None if achieved is None else achieved[t + 1],
                fields=after | {name: episode.fields[name][t] for name in of_steps & episode.fields.keys()},
            )
        return buffer.finish(stream, episode.outcome, episode.terminated)
    except BaseException:
        buffer.abort(stream)
        raise


def recipe_of(buffer: EpisodeBuffer) -> dict[str, Any]:
    """What a buffer was made with, as JSON has it, but for its size and seed."""
    recipe: dict[str, Any] = {
        "frame_shape": list(buffer.frame_shape),
        "dtype": buffer.dtype.name,
        "max_episode_steps": buffer.max_episode_steps,
        "frame_stack": buffer.frame_stack,
        "stacking": buffer.stacking,
        "num_goals": buffer.num_goals,
        "num_actions": buffer.num_actions,
        "first_action": buffer.first_action,
        "interactions": [[action, done] for action, done in buffer.interactions.items()],
        "num_interactions": buffer.num_interactions,
        "goals": buffer.goals,
        "action_dim": buffer.action_dim,
        "fields": {
            name: [list(part.shape), part.dtype.name, part.per, part.stacked]
            for name, part in buffer.fields.items()
        },
    }
    if buffer.goals == "vectors":
        recipe |= {"goal_shape": list(buffer.goal_shape), "goal_dtype": buffer.goal_dtype.name}
    return recipe


def buffer_from(recipe: dict[str, Any], *, capacity_steps: int, seed: int = 0) -> EpisodeBuffer:
    """An empty buffer of one stream, from what `recipe_of` told.

    Args:
        recipe: Of a buffer.
        capacity_steps: Steps to make room for; an episode of the longest kind always has it.
        seed: Of the new buffer's generator.
    """
    made = dict(recipe)
    made["fields"] = {name: Field(*parts) for name, parts in recipe["fields"].items()}
    made["interactions"] = dict(recipe["interactions"])
    room = max(capacity_steps, recipe["max_episode_steps"])
    return EpisodeBuffer(**made, num_streams=1, capacity_steps=room, seed=seed)
