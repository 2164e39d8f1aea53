"""Images of a room: the seam between the environment and whatever draws.

Owns the protocol `ImageSource`, its implementation on `mujoco.Renderer`, and the choice between renderers by
name.

Invariants: a GL context belongs to one process and one thread, so sources are shared only within a thread of
a process (sixteen contexts are slower than one); shadows and reflections are off, since they cost more than
all else.
"""

from __future__ import annotations

import copy
import os
import threading
from collections.abc import Callable
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from vhs.envs.robot import CAMERA, COLLISION_GROUP, ROBOT_GROUP
from vhs.envs.scene import NEAR_WALL_GROUP, ONLOOKER

Image = NDArray[np.uint8]

_GROUPS = 6
"""Number of geom groups in MuJoCo's drawing options."""


class NoOpenGLError(RuntimeError):
    """No OpenGL context can be had on this machine."""


class ImageSource(Protocol):
    """Draws what the robot sees."""

    def render(self, data: mujoco.MjData, out: Image) -> None:
        """Draw the first-person view of `data` into `out`, uint8 [H, W, 3], row 0 at the top."""
        ...


class MujocoImageSource:
    """`mujoco.Renderer` on OpenGL, with the view's groups and flags set once."""

    def __init__(self, model: mujoco.MjModel, height: int, width: int, *, is_onlooker: bool = False) -> None:
        """Open a GL context for one model and one image size.

        Args:
            model: the compiled room.
            height: pixels.
            width: pixels.
            is_onlooker: draw the third-person view, with the robot and without the near walls.

        Raises:
            NoOpenGLError: MuJoCo found no OpenGL that works.
        """
        if is_onlooker:
            # Smooth edges for people; an agent's images do without, at half the cost. The model is shared, so
            # it is copied.
            model = copy.copy(model)
            model.vis.quality.offsamples = 4
        try:
            self._renderer = mujoco.Renderer(model, height, width)
        except Exception as error:  # MuJoCo and its GL bindings raise what their platform happens to raise.
            raise NoOpenGLError(_no_opengl_text(error)) from error
        self._camera = ONLOOKER if is_onlooker else CAMERA
        self._option = mujoco.MjvOption()
        hidden = (COLLISION_GROUP, NEAR_WALL_GROUP) if is_onlooker else (COLLISION_GROUP, ROBOT_GROUP)
        self._option.geomgroup[:] = [group not in hidden for group in range(_GROUPS)]
        flags = self._renderer.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = is_onlooker

    def render(self, data: mujoco.MjData, out: Image) -> None:
        """Draw `data` into `out`, uint8 [H, W, 3]."""
        self._renderer.update_scene(data, self._camera, self._option)
        self._renderer.render(out=out)


class BlankImageSource:
    """Black images, for planners and tests that look at the true state: needs no OpenGL and no time."""

    def __init__(self, model: mujoco.MjModel, height: int, width: int) -> None:
        """Take what every source takes; nothing of it matters."""

    def render(self, data: mujoco.MjData, out: Image) -> None:
        """Blacken `out`."""
        out.fill(0)


SourceMaker = Callable[[mujoco.MjModel, int, int], ImageSource]
"""Makes an image source from (model, height, width)."""

RENDERERS: dict[str, SourceMaker] = {"mujoco": MujocoImageSource, "none": BlankImageSource}
"""Names that the environment's `renderer` argument takes."""


_Key = tuple[int, str, int, int]
"""What tells sources apart: process id, renderer, id of the model, image size in pixels."""

_OPEN_SOURCES = 8
"""Most sources a thread keeps open; the one opened first is closed for the next."""


class _ThreadSources(threading.local):
    """Open sources of this thread, each with its model so that the model's id stays its own."""

    def __init__(self) -> None:
        self.by_key: dict[_Key, tuple[mujoco.MjModel, ImageSource]] = {}


_sources = _ThreadSources()


def first_person_source(renderer: str, model: mujoco.MjModel, size_px: int) -> ImageSource:
    """The thread's image source for a model; opened on first use and shared afterwards."""
    return _shared(renderer, model, size_px, RENDERERS[renderer])


def onlooker_source(model: mujoco.MjModel, size_px: int) -> ImageSource:
    """The thread's third-person source for a model; always MuJoCo's own renderer, as it is for people."""

    def make(model: mujoco.MjModel, height: int, width: int) -> ImageSource:
        return MujocoImageSource(model, height, width, is_onlooker=True)

    return _shared("onlooker", model, size_px, make)


def check_renderer(renderer: str) -> None:
    """Refuse a renderer that does not exist."""
    if renderer not in RENDERERS:
        raise ValueError(f"renderer: expected one of {sorted(RENDERERS)}, found {renderer!r}")


def _shared(name: str, model: mujoco.MjModel, size_px: int, make: SourceMaker) -> ImageSource:
    """Look a source up, or open it."""
    # The process is part of the key because a GL context inherited by a fork is not usable in the child.
    key = (os.getpid(), name, id(model), size_px)
    entry = _sources.by_key.get(key)
    if entry is None:
        entry = (model, make(model, size_px, size_px))
        while len(_sources.by_key) >= _OPEN_SOURCES:
            del _sources.by_key[next(iter(_sources.by_key))]
        _sources.by_key[key] = entry
    return entry[1]


def _no_opengl_text(error: Exception) -> str:
    """Say what was tried and what to install."""
    backend = os.environ.get("MUJOCO_GL", "not set")
    return (
        f"expected a working OpenGL to draw the room, found none (MUJOCO_GL is {backend}; "
        f"{type(error).__name__}: {error}). On Debian or Ubuntu: apt-get install libegl1 "
        "libgl1-mesa-dri; and set MUJOCO_GL=egl before anything imports mujoco"
    )
