"""`SoftwareContext` stands where `mujoco.MjrContext` does: MuJoCo's low-level drawing, without OpenGL.

Owns the pictures between `mjr_render` and `mjr_readPixels`. Everything is taken from the abstract scene, the
camera as well, so any program that draws through these two functions is served.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vhs._core import ProtocolError, RasterCanvas, UnsupportedError
from vhs.raster.assets import Assets, source_of
from vhs.raster.softs import softs_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Numbers of MuJoCo's enumerations (mjvisualize.h, mjrender.h).
_FLAG_SEGMENT, _FLAG_IDCOLOR = 8, 9
_DEPTH_ZERO_IS_FAR = 1
_MOST_CANVASES = 4
"""Canvases that are kept; the one made first makes room."""


class SoftwareContext:
    """What `mujoco.MjrContext` is to OpenGL: a model's assets, ready to be drawn, and the last picture."""

    def __init__(self, model: Any = None, fontscale: Any = 150) -> None:
        """Reads a model's assets (`mujoco.MjModel`); the size of letters does not matter, none are drawn."""
        self._model = model
        self._assets: Assets | None = None
        self._canvases: dict[tuple[int, int, int], tuple[Any, RasterCanvas]] = {}
        self._last: tuple[RasterCanvas, tuple[float, float, bool], bool] | None = None
        self.readDepthMap = 0
        self.currentBuffer = 1
        self.offWidth = int(model.vis.global_.offwidth) if model is not None else 0
        self.offHeight = int(model.vis.global_.offheight) if model is not None else 0
        self.offSamples = int(model.vis.quality.offsamples) if model is not None else 0
        self.upload()

    def upload(self) -> None:
        """Reads textures, meshes and height fields again."""
        self._canvases.clear()
        if self._model is not None:
            self._assets = Assets.of(self._model, has_sky=True)

    def free(self) -> None:
        """Frees the memory."""
        self._canvases.clear()
        self._assets = self._last = None

    def render(self, viewport: Any, scene: Any) -> None:
        """Takes a scene, to be drawn by `read`.

        Raises:
            UnsupportedError: The scene asks for something that is not drawn; it is named.
            ProtocolError: The context is freed.
        """
        if self._assets is None:
            raise ProtocolError("context: expected one with a model, found it freed")
        if scene.stereo or scene.enabletransform:
            raise UnsupportedError("not drawn by this renderer: stereo and transformed scenes")
        is_numbered = bool(scene.flags[_FLAG_SEGMENT])
        if is_numbered and not scene.flags[_FLAG_IDCOLOR]:
            raise UnsupportedError("not drawn by this renderer: segmentation in random colours")
        canvas = self._canvas(viewport, scene)
        canvas.update(-1, *_sight(scene))
        if scene.nskin or scene.nflex:
            canvas.set_softs(*softs_of(self._model, scene))
        canvas.take(scene.ngeom, scene.nlight, is_numbered)
        camera = scene.camera[0]
        depths = camera.frustum_near, camera.frustum_far, bool(camera.orthographic)
        self._last = canvas, depths, is_numbered

    def read(self, rgb: NDArray[np.uint8] | None, depth: NDArray[np.float32] | None, viewport: Any) -> None:
        """Draws the last scene into arrays as OpenGL lays them out, the lowest row first.

        Args:
            rgb: Colours, uint8 of 3 * height * width; numbers for segmentation where the scene asks for it.
            depth: Values of a depth buffer, float32 of height * width.
            viewport: A `mujoco.MjrRect` of the size of the last `render`.

        Raises:
            ProtocolError: Nothing has been rendered.
        """
        if self._last is None:
            raise ProtocolError("read: expected a rendered scene, found none")
        canvas, depths, is_numbered = self._last
        height, width = viewport.height, viewport.width
        if rgb is not None:
            picture = np.empty((height, width, 3), np.uint8)
            if is_numbered:
                tags = np.empty((height, width, 2), np.int32)
                canvas.draw_tags(tags)
                for channel in range(3):
                    picture[..., channel] = (tags[..., 0] + 1) >> 8 * channel & 255
            else:
                canvas.draw(picture, False)
            rgb.reshape(height, width, 3)[:] = picture[::-1]
        if depth is not None:
            distance = np.empty((height, width), np.float32)
            canvas.draw_depth(distance)
            depth.reshape(height, width)[:] = self._buffered(distance[::-1].astype(np.float64), *depths)

    def _buffered(
        self, distance: NDArray[np.float64], near: float, far: float, is_parallel: bool
    ) -> NDArray[np.float64]:
        """Distances in metres as values of a depth buffer."""
        if is_parallel:
            nearness = (far - distance) / (far - near)
        else:
            nearness = near * (far - distance) / (distance * (far - near))
        return nearness if self.readDepthMap == _DEPTH_ZERO_IS_FAR else 1 - nearness

    def _canvas(self, viewport: Any, scene: Any) -> RasterCanvas:
        """The canvas of a scene and a size."""
        assert self._assets is not None, "checked by the caller"
        key = (id(scene), viewport.height, viewport.width)
        if key not in self._canvases:
            while len(self._canvases) >= _MOST_CANVASES:
                del self._canvases[next(iter(self._canvases))]
            import mujoco

            source = source_of(mujoco, self._model, scene, self._assets)
            antialias = 1 if self._model.vis.quality.offsamples else 0
            canvas = RasterCanvas(self._assets.scene, source, viewport.height, viewport.width, antialias)
            # The scene is kept with its canvas, so that its number stays its own.
            self._canvases[key] = (scene, canvas)
        return self._canvases[key][1]


def _sight(scene: Any) -> tuple[list[list[float]], list[float], float, float]:
    """Gaze, lens, near and far plane of the scene's camera, the mean of its two eyes."""
    left, right = scene.camera
    position = ((left.pos.astype(float) + right.pos) / 2).tolist()
    gaze = [position, left.forward.astype(float).tolist(), left.up.astype(float).tolist()]
    near, bottom, top = left.frustum_near, left.frustum_bottom, left.frustum_top
    if left.orthographic:
        return gaze, [top - bottom, 0.0], near, left.frustum_far
    if not left.frustum_width and bottom == -top:
        angle = 2 * float(np.degrees(np.arctan(top / near)))
        return gaze, [angle], near, left.frustum_far
    half, centre = left.frustum_width, left.frustum_center
    lens = [-bottom / near, top / near, (half - centre) / near, (half + centre) / near]
    return gaze, lens, near, left.frustum_far
