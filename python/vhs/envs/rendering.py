"""Images of a room: the seam between the environment and whatever draws.

Owns the protocol `ImageSource`, its implementations on `vhs.RasterRenderer` and on `mujoco.Renderer`, and the
choice between renderers by name.

Invariants: a GL context belongs to one process and one thread, so sources are shared only within a thread of
a process (sixteen contexts are slower than one); shadows and reflections are off, since they cost more than
all else, and so both renderers draw the same picture.
"""

from __future__ import annotations

import copy
import os
import threading
from typing import Literal, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from vhs import RasterRenderer, VhsError
from vhs.envs.opengl import load_triton_first
from vhs.envs.robot import CAMERA, COLLISION_GROUP, ROBOT_GROUP
from vhs.envs.scene import NEAR_WALL_GROUP, ONLOOKER

Image = NDArray[np.uint8]

_GROUPS = 6
"""Number of geom groups in MuJoCo's drawing options."""


class NoOpenGLError(VhsError, RuntimeError):
    """No OpenGL context can be had on this machine."""


class ImageSource(Protocol):
    """Draws one view of a room: what the robot sees, or an onlooker."""

    def render(self, data: mujoco.MjData, out: Image) -> None:
        """Draw the view of `data` into `out`, uint8 [H, W, 3], row 0 at the top."""
        ...


class RasterImageSource:
    """`vhs.RasterRenderer`: software, no OpenGL, the same picture on every machine."""

    def __init__(self, model: mujoco.MjModel, height: int, width: int, *, is_onlooker: bool) -> None:
        """Prepare the meshes and textures of one model; the arguments are those of `MujocoImageSource`."""
        # Smooth edges and textures for people; an agent's images do without.
        antialias: Literal["off", "supersample"] = "supersample" if is_onlooker else "off"
        self._renderer = RasterRenderer(model, height, width, antialias=antialias, has_sky=is_onlooker)
        _show_no_shadows(self._renderer.scene.flags)
        self._camera = model.camera(_camera_name(is_onlooker)).id
        self._option = _option(is_onlooker)

    def render(self, data: mujoco.MjData, out: Image) -> None:
        """Draw `data` into `out`, uint8 [H, W, 3]."""
        self._renderer.update_scene(data, self._camera, self._option)
        self._renderer.render(out=out)


class MujocoImageSource:
    """`mujoco.Renderer` on OpenGL, with the view's groups and flags set once."""

    def __init__(self, model: mujoco.MjModel, height: int, width: int, *, is_onlooker: bool) -> None:
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
            load_triton_first()
            self._renderer = mujoco.Renderer(model, height, width)
        except Exception as error:  # MuJoCo and its GL bindings raise what their platform happens to raise.
            raise NoOpenGLError(_no_opengl_text(error)) from error
        self._camera = _camera_name(is_onlooker)
        self._option = _option(is_onlooker)
        flags = self._renderer.scene.flags
        _show_no_shadows(flags)
        flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = is_onlooker

    def render(self, data: mujoco.MjData, out: Image) -> None:
        """Draw `data` into `out`, uint8 [H, W, 3]."""
        self._renderer.update_scene(data, self._camera, self._option)
        self._renderer.render(out=out)


class BlankImageSource:
    """Black images, for planners and tests that look at the true state: needs no OpenGL and no time."""

    def __init__(self, model: mujoco.MjModel, height: int, width: int, *, is_onlooker: bool) -> None:
        """Take what every source takes; nothing of it matters."""

    def render(self, data: mujoco.MjData, out: Image) -> None:
        """Blacken `out`."""
        out.fill(0)


class SourceMaker(Protocol):
    """Makes an image source of a model; a class such as `RasterImageSource` is one."""

    def __call__(self, model: mujoco.MjModel, height: int, width: int, *, is_onlooker: bool) -> ImageSource:
        """Prepare to draw `model` at a size in pixels, as the robot sees it or as an onlooker."""
        ...


RENDERERS: dict[str, SourceMaker] = {
    "raster": RasterImageSource,
    "mujoco": MujocoImageSource,
    "none": BlankImageSource,
}
"""Names that the environment's `renderer` argument takes."""


_Key = tuple[int, str, int, int, bool]
"""What tells sources apart: process id, renderer, id of the model, image size in pixels, whose view."""

_OPEN_SOURCES = 8
"""Most sources a thread keeps open; the one opened first is closed for the next."""


class _ThreadSources(threading.local):
    """Open sources of this thread, each with its model so that the model's id stays its own."""

    def __init__(self) -> None:
        self.by_key: dict[_Key, tuple[mujoco.MjModel, ImageSource]] = {}


_sources = _ThreadSources()


def first_person_source(renderer: str, model: mujoco.MjModel, size_px: int) -> ImageSource:
    """The thread's source of what the robot sees; opened on first use and shared afterwards."""
    return _shared(renderer, model, size_px, is_onlooker=False)


def onlooker_source(renderer: str, model: mujoco.MjModel, size_px: int) -> ImageSource:
    """The thread's source of third-person views; a room without images has them drawn all the same."""
    return _shared("raster" if renderer == "none" else renderer, model, size_px, is_onlooker=True)


def check_renderer(renderer: str) -> None:
    """Refuse a renderer that does not exist."""
    if renderer not in RENDERERS:
        raise ValueError(f"renderer: expected one of {sorted(RENDERERS)}, found {renderer!r}")


def _shared(renderer: str, model: mujoco.MjModel, size_px: int, *, is_onlooker: bool) -> ImageSource:
    """Look a source up, or open it."""
    # The process is part of the key because a GL context inherited by a fork is not usable in the child.
    key = (os.getpid(), renderer, id(model), size_px, is_onlooker)
    entry = _sources.by_key.get(key)
    if entry is None:
        entry = (model, RENDERERS[renderer](model, size_px, size_px, is_onlooker=is_onlooker))
        while len(_sources.by_key) >= _OPEN_SOURCES:
            del _sources.by_key[next(iter(_sources.by_key))]
        _sources.by_key[key] = entry
    return entry[1]


def _camera_name(is_onlooker: bool) -> str:
    return ONLOOKER if is_onlooker else CAMERA


def _option(is_onlooker: bool) -> mujoco.MjvOption:
    """What is drawn: the onlooker sees the robot and looks through the near walls, the robot does neither."""
    option = mujoco.MjvOption()
    hidden = (COLLISION_GROUP, NEAR_WALL_GROUP) if is_onlooker else (COLLISION_GROUP, ROBOT_GROUP)
    option.geomgroup[:] = [group not in hidden for group in range(_GROUPS)]
    return option


def _show_no_shadows(flags: NDArray[np.uint8]) -> None:
    """Switch shadows and reflections off, by the flags of a `mujoco.MjvScene`."""
    flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
    flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False


def _no_opengl_text(error: Exception) -> str:
    """Say what was tried and what to install."""
    backend = os.environ.get("MUJOCO_GL", "not set")
    return (
        f"expected a working OpenGL to draw the room, found none (MUJOCO_GL is {backend}; "
        f"{type(error).__name__}: {error}). On Debian or Ubuntu: apt-get install libegl1 "
        "libgl1-mesa-dri; and set MUJOCO_GL=egl before anything imports mujoco"
    )
