"""An episode moment by moment: what was seen, from where, and what was done about it.

A moment is what the agent sees, with the action that it then chooses; the last moment of an episode has the
outcome instead. An episode of n steps therefore has n + 1 moments.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhs import Outcome
from vhs.acting.actor import Actor
from vhs.acting.policy import Policy
from vhs.envs import OBJECT_NAMES, RoomEnv
from vhs.envs.config import FIRST_INTERACTION
from vhs.train.build import make_buffer, make_spec

MOVEMENTS = ("MoveForward", "TurnLeft", "TurnRight")
STREAM = np.zeros(1, dtype=np.int64)
"""The only stream of an episode that is played alone."""


class Pose(NamedTuple):
    """Measured pose of the robot in the world."""

    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class Moment:
    """One picture of an episode."""

    step: int
    """Steps taken before it."""
    instruction: str
    view: NDArray[np.uint8]
    """What the robot sees, uint8 [84, 84, 3]."""
    onlooker: NDArray[np.uint8] | None
    """Third-person view, uint8 [480, 480, 3], where the room draws one."""
    pose: Pose
    action: str | None = None
    """What is done now; None at the end of the episode, and before a person has chosen."""
    value: float | None = None
    """The critic's estimate of what is still to come, in units of the scaled reward."""
    outcome: Outcome | None = None
    """At the end of the episode alone."""
    reached: int = -1
    """Label of the object that ended the episode; -1 for none."""


def instruction_of(room: RoomEnv) -> str:
    """The instruction in words, such as "milk, interaction 2"."""
    goal = object_title(room.goal)
    return f"{goal}, interaction {room.interaction + 1}" if room.task.interactions > 1 else goal


def object_title(label: int) -> str:
    """The name of a class for people."""
    return OBJECT_NAMES[label].replace("_", " ")


def action_name(room: RoomEnv, action: int) -> str:
    """The name of an action, such as "TurnLeft" or "Interact 2"."""
    if action < FIRST_INTERACTION:
        return MOVEMENTS[action]
    return f"Interact {action - FIRST_INTERACTION + 1}" if room.task.interactions > 1 else "Interact"


def snapshot(room: RoomEnv, view: NDArray[np.uint8], **known: Any) -> Moment:
    """The present moment of a room.

    Args:
        room: after a reset or a step.
        view: the image of that reset or step.
        known: further fields of `Moment`.
    """
    pose = Pose(*room.world.measured_pose)
    return Moment(room.steps, instruction_of(room), view, room.render(), pose, **known)


def ending(room: RoomEnv, view: NDArray[np.uint8], info: dict[str, Any]) -> Moment:
    """The last moment of an episode, from the `info` of its last step."""
    outcome = Outcome.from_name(info["outcome"])
    return snapshot(room, view, outcome=outcome, reached=int(info["reached_object"]))


def run_episode(agent: Policy, actor: Actor, room: RoomEnv, seed: int) -> Iterator[Moment]:
    """Let an agent play one episode.

    Args:
        agent: gives goal embeddings.
        actor: chooses the actions; of one stream.
        room: a room of the agent's task.
        seed: of the episode.

    Yields:
        Its moments, from the reset to the outcome.
    """
    buffer = make_buffer(agent.config, make_spec(agent.config, room), 1, 1)
    observation, _ = room.reset(seed=seed)
    buffer.begin(0, observation["image"], room.goal, room.interaction)
    actor.begin(0, agent.goals.begin(room.goal), room.interaction)
    while True:
        actions, values = actor.act(STREAM, buffer.observe(STREAM))
        action, value = int(actions[0]), float(values[0])
        yield snapshot(room, observation["image"], action=action_name(room, action), value=value)
        observation, reward, terminated, truncated, info = room.step(action)
        buffer.append(0, action, reward=float(reward), value=value, frame=observation["image"])
        if terminated or truncated:
            yield ending(room, observation["image"], info)
            return
