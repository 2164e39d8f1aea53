"""Shared fixtures: rooms without images, and a skip where no OpenGL can be had."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from vhs.envs import TASKS, NoOpenGLError, RoomEnv, RoomTask
from vhs.envs.config import INTERACTIVE_OBJECT_NAV
from vhs.envs.kinematics import Pose
from vhs.envs.scene import ObjectPose

FAR_M = 40.0
"""Where tests put objects that shall not matter: outside of the room, beyond all reach."""


@pytest.fixture(params=TASKS, ids=lambda task: task.name)
def task(request: pytest.FixtureRequest) -> RoomTask:
    found: RoomTask = request.param
    return found


@pytest.fixture
def blind_room() -> RoomEnv:
    """Task 2 with black images: the dynamics alone."""
    env = RoomEnv(INTERACTIVE_OBJECT_NAV, renderer="none")
    env.reset(seed=0)
    return env


@pytest.fixture(scope="session")
def opengl() -> None:
    """Skip where MuJoCo's own renderer cannot draw."""
    try:
        RoomEnv(INTERACTIVE_OBJECT_NAV, renderer="mujoco").reset(seed=0)
    except NoOpenGLError as error:
        pytest.skip(f"needs OpenGL: {error}")


@pytest.fixture
def arrange() -> Callable[..., None]:
    """Put the robot and some objects where a test wants them, the other objects far away."""

    def place(env: RoomEnv, pose: Pose, objects: dict[int, ObjectPose] | None = None) -> None:
        given = {} if objects is None else objects
        poses = tuple(given.get(label, ObjectPose(FAR_M + label, FAR_M, 0.0, False)) for label in range(5))
        env.arrange(pose, poses)

    return place
