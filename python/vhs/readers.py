"""Readers: what an observation says of the frame, the goal that is told and the one that was reached."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vhs._core import ArgumentError

if TYPE_CHECKING:
    from gymnasium import spaces

__all__ = ["GoalDict", "GoalReader", "Instruction", "Seen", "entries_of", "reader_of"]


@dataclass(frozen=True, slots=True)
class Seen:
    """What an observation says, for the buffer."""

    frame: NDArray[Any]
    """What to store, of the buffer's `frame_shape`; a number is stored as [1]."""
    label: int = 0
    """Instructed goal class."""
    interaction: int = 0
    """Instructed interaction."""
    desired_goal: NDArray[Any] | None = None
    """The goal told, where goals are observations or vectors; one frame stands for a stack of it."""
    achieved_goal: NDArray[Any] | None = None
    """The goal reached, where goals are vectors."""
    fields: Mapping[str, Any] = field(default_factory=dict)
    """What else of the observation is to be stored, such as joint angles beside an image: by name arrays or
    numbers, of the buffer's `fields`."""


GoalReader = Callable[[Any], Seen]
"""Observation -> what it says."""


@dataclass(frozen=True, slots=True)
class GoalDict:
    """Reads the dictionaries of goal-conditioned environments (gymnasium-robotics `GoalEnv`)."""

    fields: tuple[str, ...] = ()
    """Further entries to be stored."""

    def __call__(self, observation: dict[str, Any]) -> Seen:
        """The observation's three entries, and the further ones."""
        return Seen(
            frame=np.asarray(observation["observation"]),
            desired_goal=np.asarray(observation["desired_goal"]),
            achieved_goal=np.asarray(observation["achieved_goal"]),
            fields={name: observation[name] for name in self.fields},
        )


@dataclass(frozen=True, slots=True)
class Instruction:
    """Reads an image and an instruction: each an entry's name, or a function of the observation."""

    image: str | Callable[[Any], NDArray[Any]] = "image"
    goal: str | Callable[[Any], int | NDArray[Any]] = "goal"
    """Goal class, or a picture of the goal, of the image's shape."""
    interaction: str | Callable[[Any], int] | None = None
    """Interaction; None where the task has none."""
    fields: tuple[str, ...] = ()
    """Further entries to be stored, such as a compass."""

    def __call__(self, observation: Any) -> Seen:
        """The image, the goal and the interaction.

        Raises:
            ArgumentError: For a goal that is neither an integer nor of the image's shape.
        """
        interaction = 0 if self.interaction is None else int(_entry(observation, self.interaction))
        image = np.asarray(_entry(observation, self.image))
        goal = np.asarray(_entry(observation, self.goal))
        fields = {name: observation[name] for name in self.fields}
        if goal.ndim == 0 and goal.dtype.kind in "biu":
            return Seen(image, int(goal), interaction, fields=fields)
        if goal.shape == image.shape:
            return Seen(image, interaction=interaction, desired_goal=goal, fields=fields)
        raise ArgumentError(
            f"`goal`: expected a class number or a picture of the image's shape {list(image.shape)}, "
            f"got {goal.dtype} {list(goal.shape)}"
        )


def reader_of(space: spaces.Space[Any], field: str = "reader") -> GoalReader:
    """The reader that fits an observation space; `field` is what an error says was not given.

    Raises:
        ArgumentError: For a space that says nothing of goals.
    """
    entries = set(entries_of(space))
    if {"observation", "achieved_goal", "desired_goal"} <= entries:
        return GoalDict()
    if {"image", "goal"} <= entries:
        return Instruction(interaction="interaction" if "interaction" in entries else None)
    raise ArgumentError(
        f"`{field}`: expected one for an observation space without achieved_goal and desired_goal, or image "
        f"and goal, got None for {space}"
    )


def entries_of(space: spaces.Space[Any]) -> Mapping[str, spaces.Space[Any]]:
    """The parts of a space of dictionaries; none of another."""
    from gymnasium import spaces

    return space.spaces if isinstance(space, spaces.Dict) else {}


def _entry(observation: Any, entry: str | Callable[[Any], Any]) -> Any:
    return observation[entry] if isinstance(entry, str) else entry(observation)
