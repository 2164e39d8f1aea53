"""The one way from a task to an episode buffer: all that it knows of an environment is in the spec."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from vhs._core import EpisodeBuffer
from vhs.task import TaskSpec

__all__ = ["as_goal", "beside", "beside_dim", "make_buffer"]


def make_buffer(
    spec: TaskSpec,
    *,
    capacity_steps: int,
    num_streams: int = 1,
    frame_stack: int = 1,
    stacking: Literal["frames", "channels"] = "frames",
    first_action: int = 0,
    backing: str | PathLike[str] = "memory",
    seed: int = 0,
) -> EpisodeBuffer:
    """A buffer that fits a task.

    Args:
        spec: Sizes and types of the task.
        capacity_steps: Steps kept over all episodes.
        num_streams: Environments that will feed the buffer.
        frame_stack: Frames in one observation.
        stacking: How they lie in it, as for `EpisodeBuffer`.
        first_action: What the numbers of actions begin with in the buffer; a spec counts them from 0.
        backing: As for `EpisodeBuffer`.
        seed: Of the buffer's generator.

    Raises:
        ArgumentError: For several interactions and no word of which action does which, or for sizes that
            the buffer cannot hold.
    """
    vectors: dict[str, Any] = {"goal_shape": spec.goal_shape, "goal_dtype": spec.goal_dtype}
    return EpisodeBuffer(
        spec.frame_shape,
        num_streams=num_streams,
        max_episode_steps=spec.max_episode_steps,
        capacity_steps=capacity_steps,
        frame_stack=frame_stack,
        stacking=stacking,
        num_goals=spec.num_goals,
        num_interactions=spec.num_interactions,
        num_actions=None if spec.action_dim else spec.num_actions,
        first_action=first_action,
        interactions={action + first_action: done for action, done in spec.interactions.items()},
        dtype=spec.frame_dtype,
        action_dim=spec.action_dim,
        goals=spec.goals,
        fields=spec.fields,
        backing=backing,
        seed=seed,
        **(vectors if spec.goals == "vectors" else {}),
    )


def beside_dim(spec: TaskSpec) -> int:
    """Numbers that an observation of a task has beside its frame."""
    return sum(int(np.prod(field.shape)) for field in spec.fields.values())


def beside(fields: Mapping[str, NDArray[Any]]) -> NDArray[np.float32] | None:
    """What observations have beside their frames, for a network: fields in the order of their names.

    Args:
        fields: by name arrays [n, *shape], a row an observation.

    Returns:
        float32 [n, beside_dim]; None where there are none.
    """
    rows = [fields[name].reshape(len(fields[name]), -1).astype(np.float32) for name in sorted(fields)]
    return np.concatenate(rows, axis=1) if rows else None


def as_goal(buffer: EpisodeBuffer, goal: NDArray[Any]) -> NDArray[Any]:
    """A goal that was told, in the shape that a buffer holds: a frame is repeated to an observation."""
    if buffer.goals == "observations" and goal.shape == buffer.frame_shape:
        if buffer.stacking == "channels":
            return np.concatenate([goal] * buffer.frame_stack, axis=-1)
        return np.broadcast_to(goal, buffer.goal_shape)
    return goal
