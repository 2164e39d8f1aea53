"""What an algorithm tells a replay buffer, checked, and as an `EpisodeBuffer` wants it."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.her.goal_selection_strategy import GoalSelectionStrategy

from vhs._core import ArgumentError, Field

__all__ = ["KEYS", "check_algorithm", "recipe_of", "shapes_of", "strategy_of"]

KEYS = ("observation", "achieved_goal", "desired_goal")
"""The entries of a goal-conditioned observation."""


def check_algorithm(others: dict[str, Any], optimize_memory_usage: bool) -> None:
    """Refuse, with an `ArgumentError`, what an algorithm asks for that the buffer cannot do."""
    if others:
        raise ArgumentError(
            "HindsightBuffer: expected to be the `replay_buffer_class` of an algorithm that learns "
            f"off-policy from single steps (DQN, SAC, TD3, DDPG), got {', '.join(sorted(others))}, "
            "which belongs to others"
        )
    if optimize_memory_usage:
        raise ArgumentError(
            "`optimize_memory_usage`: expected False, got True: observations are stored once in any case"
        )


def shapes_of(
    observation_space: spaces.Space[Any], action_space: spaces.Space[Any]
) -> dict[str, tuple[int, ...]]:
    """Shape of each entry of an observation in the buffer, the three of a goal first; a number is [1].

    Raises:
        ArgumentError: For spaces of another kind.
    """
    entries = observation_space.spaces if isinstance(observation_space, spaces.Dict) else {}
    if not set(KEYS) <= set(entries) or any(entry.shape is None for entry in entries.values()):
        raise ArgumentError(
            f"`observation_space`: expected a dictionary of {', '.join(KEYS)}, each an array, as "
            f"goal-conditioned environments have it, got {observation_space}"
        )
    if not isinstance(action_space, spaces.Discrete | spaces.Box):
        raise ArgumentError(f"`action_space`: expected numbers or one vector, got {action_space}")
    reached, asked = entries["achieved_goal"], entries["desired_goal"]
    if (reached.shape, reached.dtype) != (asked.shape, asked.dtype):
        raise ArgumentError(f"`desired_goal`: expected the shape and type of {reached}, got {asked}")
    return {key: entries[key].shape or (1,) for key in (*KEYS, *sorted(set(entries) - set(KEYS)))}


def strategy_of(told: GoalSelectionStrategy | str) -> Any:
    """The strategy's name; an `ArgumentError` for one that is not known."""
    word = told.name.lower() if isinstance(told, GoalSelectionStrategy) else told
    known = ("final", "future", "episode", "random")
    if word not in known:
        raise ArgumentError(f"`goal_selection_strategy`: expected one of {', '.join(known)}, got {word!r}")
    return word


def recipe_of(
    observation_space: Any,
    action_space: Any,
    shapes: dict[str, tuple[int, ...]],
    goals: str,
) -> dict[str, Any]:
    """Arguments of an `EpisodeBuffer` that follow from spaces.

    Raises:
        ArgumentError: For observations as goals that are no observations.
    """
    recipe: dict[str, Any] = {
        "frame_shape": shapes["observation"],
        "dtype": observation_space["observation"].dtype,
        "frame_stack": 1,
        "goals": goals,
        "fields": {
            key: Field(shape, observation_space[key].dtype)
            for key, shape in shapes.items()
            if key not in KEYS
        },
    }
    if goals == "vectors":
        recipe |= {
            "goal_shape": shapes["achieved_goal"],
            "goal_dtype": observation_space["achieved_goal"].dtype,
        }
    elif observation_space["observation"] != observation_space["achieved_goal"]:
        raise ArgumentError(
            "`goals`: expected 'vectors' where an achieved goal is of another kind than an observation, got "
            f"{goals!r}"
        )
    if isinstance(action_space, spaces.Discrete):
        return recipe | {"num_actions": int(action_space.n), "first_action": int(action_space.start)}
    return recipe | {"action_dim": int(np.prod(action_space.shape))}
