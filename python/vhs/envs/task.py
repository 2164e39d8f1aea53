"""The three rooms said as tasks.

What the trainer, evaluation, films and reports know of the rooms they know from here. MuJoCo comes with the
first environment.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import gymnasium

from vhs.envs.config import (
    FIRST_INTERACTION,
    INTERACTIVE_OBJECT_NAV,
    MOVE_FORWARD,
    MULTI_INTERACTION_OBJECT_NAV,
    OBJECT_NAMES,
    OBJECT_NAV,
    TURN_LEFT,
    TURN_RIGHT,
    RoomConfig,
    RoomTask,
)
from vhs.errors import ConfigError
from vhs.task import Move, Task, Turn, last_actions

ROOMS = {"task1": OBJECT_NAV, "task2": INTERACTIVE_OBJECT_NAV, "task3": MULTI_INTERACTION_OBJECT_NAV}
"""Name of a task -> what sets it apart."""


def load_room(name: str, *, room: Mapping[str, Any] | None = None, renderer: str = "raster") -> Task:
    """The task of a room.

    Args:
        name: A key of `ROOMS`.
        room: Overrides of `RoomConfig`, the `env.room` of a configuration.
        renderer: What draws observations, a key of `vhs.envs.rendering.RENDERERS`.

    Raises:
        ConfigError: An unknown task or renderer; an unknown or wrong entry of `env.room`.
    """
    if name not in ROOMS:
        raise ConfigError(f"task: expected one of {sorted(ROOMS)}, found {name!r}")
    from vhs.envs.rendering import check_renderer

    try:
        check_renderer(renderer)
    except ValueError as error:
        raise ConfigError(f"env.{error}") from error
    return _room_task(name, ROOMS[name], _room_config(room or {}), renderer)


def reached_object(info: Mapping[str, Any]) -> int:
    """Label of the object that ended an episode, -1 for none; the agent does not know it."""
    return int(info["reached_object"])


def shortest_way(env: gymnasium.Env[Any, Any]) -> int | None:
    """Fewest steps to success from the episode's start, by the oracle; None where the time is too short."""
    from vhs.envs.oracle import NoPlanError, optimal_steps

    try:
        return optimal_steps(env)
    except NoPlanError:
        return None


def _room_task(name: str, kind: RoomTask, config: RoomConfig, renderer: str) -> Task:
    numbers = range(1, kind.interactions + 1)
    interact = [f"Interact {number}" for number in numbers] if kind.interactions > 1 else ["Interact"]
    keys = {"Up": MOVE_FORWARD, "Left": TURN_LEFT, "Right": TURN_RIGHT}
    keys |= {str(number): FIRST_INTERACTION + number - 1 for number in numbers}
    if kind.interactions:
        keys["space"] = FIRST_INTERACTION
    return Task(
        name=name,
        title=kind.title,
        make=kind.env_id,
        kwargs={"config": config, "renderer": renderer},
        max_steps=config.horizon_steps,
        max_steps_keyword="horizon_steps",
        interactions=last_actions(kind.num_actions, kind.interactions),
        success_reward=config.reward_success + config.reward_step,
        goals=OBJECT_NAMES,
        limit_ends=True,
        actions=("MoveForward", "TurnLeft", "TurnRight", *interact[: kind.interactions]),
        keys=keys,
        reached=reached_object,
        shortest=shortest_way,
        moves={
            MOVE_FORWARD: Move(forward_m=config.stride_m),
            TURN_LEFT: Turn(deg=config.turn_deg),
            TURN_RIGHT: Turn(deg=-config.turn_deg),
        },
    )


def _room_config(room: Mapping[str, Any]) -> RoomConfig:
    known = [field.name for field in fields(RoomConfig)]
    for key in room:
        if key not in known:
            nearest = difflib.get_close_matches(key, known, n=1)
            hint = f"; did you mean `env.room.{nearest[0]}`?" if nearest else ""
            raise ConfigError(f"unknown key `env.room.{key}`{hint}")
    try:
        return RoomConfig(**room)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"env.room.{error}") from error
