"""`RasterRenderer`: the face of the software renderer, with the methods of `mujoco.Renderer`.

Owns the order of a frame: MuJoCo lists what is to be drawn (`mjv_updateScene`), the canvas reads that list
and draws it. What is not drawn is refused by name, not left out in silence.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from vhs._core import (
    ArgumentError,
    ProtocolError,
    RasterCanvas,
    ShapeError,
    UnsupportedError,
)
from vhs.raster.assets import Assets, source_of
from vhs.raster.cameras import Cameras
from vhs.raster.softs import softs_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

Antialias = Literal["off", "multisample", "supersample"]

# Numbers of MuJoCo's enumerations (mjvisualize.h); part of its file format, so they do not change.
_CATEGORIES_ALL = 7
_VIS_TEXTURE = 1
_SPARE_GEOMS = 1000
"""Room for geoms that are not in the model: contacts, frames, markers of the caller."""


class RasterRenderer:
    """Renders MuJoCo scenes in software, without OpenGL; the picture is the same on every machine.

    Use it like `mujoco.Renderer`: `update_scene(data, camera)`, then `render()`. Meshes, textures, height
    fields and the settings in `model.vis` are read at construction; call `refresh()` after changing them.
    Everything else (colours, sizes, materials, lights, lenses) is read at every update.
    """

    def __init__(
        self,
        model: Any,
        height: int = 240,
        width: int = 320,
        max_geom: int | None = None,
        *,
        antialias: Antialias = "off",
        has_sky: bool = True,
    ) -> None:
        """Prepares the model's meshes, textures and materials.

        Args:
            model: A `mujoco.MjModel`.
            height: Picture height in pixels.
            width: Picture width in pixels.
            max_geom: Most geoms that a scene can have, decorations and those of the caller included; by
                default as many as the model can show and a thousand more.
            antialias: "off" takes one sample a pixel. "multisample" smooths edges with four samples a pixel,
                as OpenGL does. "supersample" draws at twice the size and averages: textures are smoothed too.
            has_sky: Whether to draw the model's sky and haze; without them the background is black.

        Raises:
            UnsupportedError: The model shows something that is not drawn here; the message names it.
            ArgumentError, ShapeError, NonFiniteError: A size or a number in the model makes no picture.
        """
        import mujoco

        modes = {"off": 0, "multisample": 1, "supersample": 2}
        if antialias not in modes:
            raise ArgumentError(f"antialias: expected one of {sorted(modes)}, got {antialias!r}")
        if max_geom is None:
            max_geom = _SPARE_GEOMS + 2 * (model.ngeom + model.nsite + model.nwrap + model.nbody + model.njnt)
        self._mujoco = mujoco
        self._model = model
        self._height, self._width = height, width
        self._antialias = modes[antialias]
        self._has_sky = has_sky
        self._mode: Literal["colour", "depth", "segmentation"] = "colour"
        self._scene = mujoco.MjvScene(model, max(1, max_geom))
        self._option = mujoco.MjvOption()
        self._cameras = Cameras(mujoco, model)
        self._statistic, self._depths = model.stat, model.vis.map
        self._canvas: RasterCanvas | None = None
        self.refresh()

    def refresh(self) -> None:
        """Reads meshes, textures, height fields and settings again, after they were changed in the model."""
        model = self._model
        assets = Assets.of(model, self._has_sky)
        source = source_of(self._mujoco, model, self._scene, assets)
        self._canvas = RasterCanvas(assets.scene, source, self._height, self._width, self._antialias)
        self._has_softs = bool(model.nskin or model.nflex)
        self._bound: Any = None

    @property
    def scene(self) -> Any:
        """The abstract scene, a `mujoco.MjvScene`: its flags are obeyed, and geoms added to it are drawn."""
        return self._scene

    @property
    def model(self) -> Any:
        """The model given to the constructor."""
        return self._model

    @property
    def height(self) -> int:
        """Picture height in pixels."""
        return self._height

    @property
    def width(self) -> int:
        """Picture width in pixels."""
        return self._width

    def enable_depth_rendering(self) -> None:
        """Makes `render` return distances in metres, float32 [height, width]."""
        self._mode = "depth"

    def disable_depth_rendering(self) -> None:
        """Makes `render` return colours again, unless segmentation is on."""
        if self._mode == "depth":
            self._mode = "colour"

    def enable_segmentation_rendering(self) -> None:
        """Makes `render` return object number and object type, int32 [height, width, 2]; -1 is background."""
        self._mode = "segmentation"

    def disable_segmentation_rendering(self) -> None:
        """Makes `render` return colours again, unless depth is on."""
        if self._mode == "segmentation":
            self._mode = "colour"

    def update_scene(self, data: Any, camera: Any = -1, scene_option: Any = None) -> None:
        """Takes the poses of bodies, lights and camera from `data`.

        Args:
            data: A `mujoco.MjData` of this model, after `mj_forward` or `mj_step`.
            camera: Name or number of a camera in the model, -1 for the model's free camera, or a
                `mujoco.MjvCamera`.
            scene_option: A `mujoco.MjvOption`: what is shown, decorations included.

        Raises:
            ArgumentError: There is no such camera; the last scene stays.
            NonFiniteError: A pose is NaN or infinite; the last scene stays.
            ProtocolError: The renderer is closed.
            UnsupportedError: `scene_option` asks for text, or for a scene without its textures.
        """
        self._look(self._open_canvas(), data, camera, scene_option)

    def render(self, *, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """Draws the scene of the last `update_scene`.

        Args:
            out: Array for the result; made anew if absent. Colours uint8 [height, width, 3], distances
                float32 [height, width], segmentation int32 [height, width, 2]; another dtype is cast to. An
                array of shape [3, height, width] gets the colours channel by channel.

        Returns:
            `out`, or the new array.

        Raises:
            ShapeError: `out` has another shape.
            ProtocolError: The renderer is closed.
            UnsupportedError: A flag of the scene asks for something that is not drawn here.
        """
        canvas = self._open_canvas()
        shape, dtype = self._expected()
        if out is None:
            out = np.empty(shape, dtype)
        is_planar = self._is_planar(out.shape, shape)
        if out.shape != shape and not is_planar:
            raise ShapeError(f"`out`: expected shape {shape} when rendering {self._mode}, got {out.shape}")
        canvas.take(self._scene.ngeom, self._scene.nlight)
        target = out if out.dtype == dtype and out.flags.c_contiguous else np.empty(out.shape, dtype)
        if self._mode == "depth":
            canvas.draw_depth(target)
        elif self._mode == "segmentation":
            canvas.draw_tags(target)
        else:
            canvas.draw(target, is_planar)
        if target is not out:
            np.copyto(out, target, casting="unsafe")
        return out

    def render_batch(
        self,
        datas: Sequence[Any],
        camera: Any = -1,
        scene_option: Any = None,
        out: NDArray[Any] | None = None,
        *,
        threads: int | None = None,
    ) -> NDArray[Any]:
        """Draws many states of the model, each through one camera or several, on several threads.

        The pictures are those of `update_scene` and `render`, whatever the number of threads. Threads draw
        without the interpreter lock, the first pictures while this thread prepares the others.

        Args:
            datas: N `mujoco.MjData` of this model.
            camera: As in `update_scene`, for all of them; or a list of M of them.
            scene_option: As in `update_scene`.
            out: Array for the result, shape [N, ...] or, for a list of cameras, [N, M, ...] with the rest as
                in `render`.
            threads: How many threads draw; by default one for each processor that this process may use.

        Returns:
            `out`, or a new array, for colours uint8 [N, height, width, 3] or [N, M, height, width, 3].

        Raises:
            ShapeError: `out` has another shape.
            ArgumentError, NonFiniteError, ProtocolError, UnsupportedError: As `update_scene` and `render`.
        """
        canvas = self._open_canvas()
        cameras = list(camera) if isinstance(camera, list | tuple) else [camera]
        lead = (len(datas), len(cameras)) if isinstance(camera, list | tuple) else (len(datas),)
        threads = threads or _processors()
        shape, dtype = self._expected()
        if out is None:
            out = np.empty((*lead, *shape), dtype)
        is_planar = self._is_planar(out.shape[len(lead) :], shape)
        if out.shape[: len(lead)] != lead or (out.shape[len(lead) :] != shape and not is_planar):
            raise ShapeError(f"`out`: expected shape {(*lead, *shape)}, got {out.shape}")
        is_direct = out.dtype == dtype and out.flags.c_contiguous
        target = out if is_direct else np.empty(out.shape, dtype)

        def prepare(picture: int) -> None:
            state, number = divmod(picture, len(cameras))
            self._look(canvas, datas[state], cameras[number], scene_option, is_same=number > 0)
            if number == 0:
                canvas.take(self._scene.ngeom, self._scene.nlight)

        count = len(datas) * len(cameras)
        if self._mode == "depth":
            canvas.draw_all_depth(count, prepare, target, threads)
        elif self._mode == "segmentation":
            canvas.draw_all_tags(count, prepare, target, threads)
        else:
            canvas.draw_all(count, prepare, target, is_planar, threads)
        if target is not out:
            np.copyto(out, target, casting="unsafe")
        return out

    def close(self) -> None:
        """Frees the renderer's memory; it cannot render afterwards."""
        self._canvas = None
        self._bound = None

    def __enter__(self) -> Self:
        """Returns itself."""
        return self

    def __exit__(self, *exc: object) -> None:
        """Closes the renderer."""
        self.close()

    def _look(
        self, canvas: RasterCanvas, data: Any, camera: Any, option: Any, *, is_same: bool = False
    ) -> None:
        """Takes poses and a camera; what is drawn as well, unless it is the same as at the last look."""
        option = self._option if option is None else option
        if option.label:
            raise UnsupportedError("not drawn by this renderer: text labels")
        model, abstract = self._model, self._cameras.find(camera)
        fixed, gaze, lens = self._cameras.sight(data, abstract)
        if data is not self._bound:
            canvas.bind(
                data.geom_xpos, data.geom_xmat, data.site_xpos, data.site_xmat, data.cam_xpos, data.cam_xmat
            )
            self._bound = data
        extent, depths = self._statistic.extent, self._depths
        canvas.update(fixed, gaze, lens, depths.znear * extent, depths.zfar * extent)
        if is_same:
            return
        self._mujoco.mjv_updateScene(model, data, option, None, abstract, _CATEGORIES_ALL, self._scene)
        if self._has_softs:
            canvas.set_softs(*softs_of(model, self._scene))

    def _is_planar(self, found: tuple[int, ...], expected: tuple[int, ...]) -> bool:
        """Whether a picture has its colours channel by channel."""
        return self._mode == "colour" and found == (3, self._height, self._width) != expected

    def _open_canvas(self) -> RasterCanvas:
        if self._canvas is None:
            raise ProtocolError("renderer: expected an open one, found it closed")
        return self._canvas

    def _expected(self) -> tuple[tuple[int, ...], type[np.generic]]:
        size = (self._height, self._width)
        if self._mode == "depth":
            return size, np.float32
        if self._mode == "segmentation":
            return (*size, 2), np.int32
        return (*size, 3), np.uint8


def _processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
