"""Fixtures of the tests that step rooms."""

import pytest

from vhs.envs import NoOpenGLError, RoomEnv


@pytest.fixture(scope="session")
def needs_opengl() -> None:
    """Skip where no OpenGL can draw a room."""
    try:
        RoomEnv("ObjectNav").reset(seed=0)
    except NoOpenGLError as error:
        pytest.skip(f"no OpenGL: {error}")
