"""One line that gives programs written for OpenGL this renderer: `vhs.raster.install()`.

They all draw through three names of the `mujoco` module: `MjrContext`, `mjr_render` and `mjr_readPixels`; so
do `mujoco.Renderer`, gymnasium, dm_control, robosuite and OGBench. These are replaced, and contexts of OpenGL
by ones that do nothing.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
import types
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Self

from vhs.raster.context import SoftwareContext

if TYPE_CHECKING:
    from collections.abc import Iterator

_CONTEXTS = {
    "mujoco.egl": ("GLContext",),
    "mujoco.glfw": ("GLContext",),
    "mujoco.osmesa": ("GLContext",),
    "robosuite.renderers.context.egl_context": ("EGLGLContext",),
    "robosuite.renderers.context.osmesa_context": ("OSMesaGLContext",),
    "robosuite.renderers.context.glfw_context": ("GLFWGLContext",),
}
"""Modules that open contexts of OpenGL, with their classes."""

_ABSENT = object()


class _NoContext:
    """A context of OpenGL that opens nothing."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Takes what any context takes."""

    def make_current(self) -> None:
        """Does nothing."""

    @contextmanager
    def as_current(self) -> Iterator[None]:
        """Does nothing for a while."""
        yield

    def free(self) -> None:
        """Does nothing."""


class Installed:
    """What `install` has replaced; ends with its `with` block, or by `uninstall`."""

    def __init__(self) -> None:
        """Replaces MuJoCo's drawing."""
        self._attributes: list[tuple[Any, str, Any]] = []
        self._modules: dict[str, Any] = {}
        for owner, name, new in _replacements():
            self._attributes.append((owner, name, getattr(owner, name, _ABSENT)))
            setattr(owner, name, new)
        for name, classes in _CONTEXTS.items():
            module = types.ModuleType(name)
            for one in classes:
                setattr(module, one, _NoContext)
            self._modules[name] = sys.modules.get(name, _ABSENT)
            sys.modules[name] = module

    def uninstall(self) -> None:
        """Puts everything back; contexts made meanwhile go on drawing in software."""
        while self._attributes:
            owner, name, old = self._attributes.pop()
            if old is _ABSENT:
                delattr(owner, name)
            else:
                setattr(owner, name, old)
        for name, old in self._modules.items():
            if old is _ABSENT:
                sys.modules.pop(name, None)
            else:
                sys.modules[name] = old
        self._modules.clear()

    def __enter__(self) -> Self:
        """Returns itself."""
        return self

    def __exit__(self, *exc: object) -> None:
        """Puts everything back."""
        self.uninstall()


def install() -> Installed:
    """Gives every program in this process that draws with MuJoCo's OpenGL this renderer instead.

    Call it before environments are made: what has opened a context of OpenGL keeps it. Serves
    `mujoco.Renderer`, gymnasium's and gymnasium-robotics' `render_mode="rgb_array"`, dm_control's
    `Physics.render`, robosuite and OGBench, without OpenGL being there. Pictures are smoothed where the model
    asks for it (`offsamples`), as MuJoCo does by default. Windows (`render_mode="human"`) still need OpenGL.

    Returns:
        A context manager that puts everything back; or call its `uninstall`. Neither is needed.

    Raises:
        ImportError: MuJoCo is not installed.
    """
    return Installed()


def _replacements() -> Iterator[tuple[Any, str, Any]]:
    """Owner, name and new value of everything that is replaced."""
    import mujoco

    for name in ("mujoco.gl_context", "mujoco.rendering.classic.gl_context"):
        if name in sys.modules:
            yield sys.modules[name], "GLContext", _NoContext
    yield mujoco, "GLContext", _NoContext
    for owner in (mujoco, importlib.import_module("mujoco._render")):
        yield owner, "MjrContext", SoftwareContext
        yield owner, "mjr_render", _render
        yield owner, "mjr_readPixels", _read_pixels
        yield owner, "mjr_setBuffer", _nothing
        yield owner, "mjr_resizeOffscreen", _resize
        for name in ("mjr_uploadTexture", "mjr_uploadMesh", "mjr_uploadHField"):
            yield owner, name, _upload
    if importlib.util.find_spec("dm_control") is not None:
        base = importlib.import_module("dm_control._render.base").ContextBase
        yield importlib.import_module("dm_control._render"), "Renderer", _dm_control_context(base)


def _dm_control_context(base: type) -> type:
    """A context for dm_control, whose contexts have a base class of its own."""

    def nothing(self: Any, *args: Any) -> None:
        """Open, choose or free nothing."""

    steps = ("_platform_init", "_platform_make_current", "_platform_free")
    return type("SoftwareRenderer", (base,), dict.fromkeys(steps, nothing))


def _render(viewport: Any, scn: Any, con: SoftwareContext) -> None:
    con.render(viewport, scn)


def _read_pixels(rgb: Any, depth: Any, viewport: Any, con: SoftwareContext) -> None:
    con.read(rgb, depth, viewport)


def _nothing(framebuffer: Any, con: SoftwareContext) -> None:
    """There is one buffer."""


def _resize(width: int, height: int, con: SoftwareContext) -> None:
    con.offWidth, con.offHeight = width, height


def _upload(m: Any, con: SoftwareContext, number: int) -> None:
    con.upload()
