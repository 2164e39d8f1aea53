"""Shortest plans from the true state: proof that the tasks are fair, and the optimum that SPL divides by.

Owns a breadth-first search over strides and turns with the kinematics of `vhs.envs.kinematics`; reads no
images. A plan ends on the instructed object, never on another one (in Task 1, being near another would end
the episode).
"""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import Any

import gymnasium

from vhs.envs.config import FIRST_INTERACTION, MOVE_FORWARD, TURN_LEFT, TURN_RIGHT, RoomConfig
from vhs.envs.kinematics import HEADING_COS, HEADING_SIN, Pose, nearest_in_reach, strided, turned
from vhs.envs.room import RoomEnv

_SLACK_M = 0.002
"""The simulation may end this far from the commanded pose; plans stay clear of borders by as much."""
_SLACK_DEG = 0.1
"""The same for headings and the reach angle."""


class NoPlanError(RuntimeError):
    """The instructed object cannot be reached within the horizon."""


def plan(env: gymnasium.Env[Any, Any]) -> list[int]:
    """Shortest actions from the present state to success.

    Args:
        env: a `RoomEnv`, wrapped or not, that has been reset.

    Raises:
        NoPlanError: there is none within the steps that are left.
    """
    room = _room(env)
    return _search(room, room.world.commanded_pose, room.config.horizon_steps - room.steps)


def optimal_steps(env: gymnasium.Env[Any, Any]) -> int:
    """Length of the shortest plan from the episode's start, whatever has happened since.

    Args:
        env: a `RoomEnv`, wrapped or not, that has been reset.

    Raises:
        NoPlanError: there is none within the horizon.
    """
    room = _room(env)
    return len(_search(room, room.world.start_pose, room.config.horizon_steps))


class _Sight:
    """What is in reach from a pose, once for sure and once at most."""

    def __init__(self, room: RoomEnv) -> None:
        """Take the objects' places and the reach with slack in both directions."""
        self._centres = [(pose.x_m, pose.y_m) for pose in room.world.object_poses]
        self._sure = _with_slack(room.config, -1.0)
        self._at_most = _with_slack(room.config, 1.0)

    def reached(self, pose: Pose) -> int | None:
        """Label of the object in reach, -1 for none, None where the simulation might see it either way."""
        cos, sin = HEADING_COS[pose.heading], HEADING_SIN[pose.heading]
        sure = nearest_in_reach(pose.x_m, pose.y_m, cos, sin, self._centres, self._sure)
        at_most = nearest_in_reach(pose.x_m, pose.y_m, cos, sin, self._centres, self._at_most)
        return sure if sure == at_most else None


def _search(room: RoomEnv, start: Pose, steps_left: int) -> list[int]:
    """Breadth-first search for the shortest plan."""
    sight = _Sight(room)
    ends_by_itself = room.task.interactions == 0
    last = [] if ends_by_itself else [FIRST_INTERACTION + room.interaction]
    # A pose is visited once: the first visit is the shortest.
    seen = {_key(start)}
    queue: deque[tuple[Pose, tuple[int, ...]]] = deque([(start, ())])
    while queue:
        pose, actions = queue.popleft()
        reached = sight.reached(pose)
        if reached == room.goal and len(actions) + len(last) <= steps_left and (actions or last):
            return [*actions, *last]
        if ends_by_itself and reached != -1 and actions:
            continue
        if len(actions) + len(last) >= steps_left:
            continue
        for action, following in _moves(room, pose):
            key = _key(following)
            if key not in seen:
                seen.add(key)
                queue.append((following, (*actions, action)))
    raise NoPlanError(
        f"expected a plan to object {room.goal} within {steps_left} steps from {tuple(start)}, found none "
        f"among {len(seen)} poses"
    )


def _moves(room: RoomEnv, pose: Pose) -> tuple[tuple[int, Pose], ...]:
    """The poses that one movement leads to."""
    return (
        (MOVE_FORWARD, strided(pose, room.world.footprints, room.config)),
        (TURN_LEFT, turned(pose, 1)),
        (TURN_RIGHT, turned(pose, -1)),
    )


def _key(pose: Pose) -> tuple[int, int, int]:
    """A pose to the nearest 0.1 mm, for telling visited poses apart from new ones."""
    return round(pose.x_m * 1e4), round(pose.y_m * 1e4), pose.heading


def _with_slack(config: RoomConfig, sign: float) -> RoomConfig:
    """The config with a reach that is a little shorter (-1) or longer (+1)."""
    return dataclasses.replace(
        config,
        reach_m=config.reach_m + sign * _SLACK_M,
        reach_half_angle_deg=min(180.0, config.reach_half_angle_deg + sign * _SLACK_DEG),
    )


def _room(env: gymnasium.Env[Any, Any]) -> RoomEnv:
    """The room under the wrappers."""
    room = env.unwrapped
    if not isinstance(room, RoomEnv):
        raise TypeError(f"env: expected a RoomEnv, wrapped or not, found {type(room).__name__}")
    if not room.world.object_poses:
        raise gymnasium.error.ResetNeeded(
            "oracle: expected an environment that has been reset, found a new one"
        )
    return room
