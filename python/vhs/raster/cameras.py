"""Where a camera is and what its lens sees, in f64; cameras are named as for `mujoco.Renderer`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vhs._core import ArgumentError, RasterCanvas, UnsupportedError

if TYPE_CHECKING:
    from collections.abc import Sequence

# Numbers of MuJoCo's enumeration `mjtCamera`.
_FREE, _TRACKING, _FIXED = 0, 1, 2


class Sight(NamedTuple):
    """A camera as `RasterCanvas.update` takes it."""

    fixed: int
    """Number of a fixed camera, or -1."""
    gaze: Sequence[Sequence[float]] | None
    """Position, gaze and up vector of any other camera."""
    lens: list[float]


class Cameras:
    """The cameras of a model, by name, by number, and as MuJoCo describes them."""

    def __init__(self, mujoco: Any, model: Any) -> None:
        """Looks names up once; lenses are read whenever they are used, from the model's own arrays."""
        self._model = model
        # MuJoCo before 3.5 has the second name.
        projection = getattr(model, "cam_projection", None)
        self._projection = model.cam_orthographic if projection is None else projection
        self._fovy, self._sensor_size = model.cam_fovy, model.cam_sensorsize
        self._intrinsic = model.cam_intrinsic
        self._numbers = {model.camera(i).name: i for i in range(model.ncam)}
        self._abstract = {i: _abstract(mujoco, model, i) for i in range(-1, model.ncam)}

    def find(self, camera: Any) -> Any:
        """The `mujoco.MjvCamera` for a name, a number or one of its own kind.

        Raises:
            ArgumentError: There is no such camera.
        """
        if isinstance(camera, str):
            if camera not in self._numbers:
                raise ArgumentError(f"camera: expected one of {sorted(self._numbers)}, got {camera!r}")
            camera = self._numbers[camera]
        if not isinstance(camera, int | np.integer):
            return camera
        if camera not in self._abstract:
            raise ArgumentError(f"camera: expected a number from -1 to {self._model.ncam - 1}, got {camera}")
        return self._abstract[int(camera)]

    def sight(self, data: Any, camera: Any) -> Sight:
        """What a `mujoco.MjvCamera` sees.

        Raises:
            ArgumentError: It points at a camera or body that the model lacks.
            UnsupportedError: It is of another kind.
        """
        model = self._model
        if camera.type == _FIXED:
            number = camera.fixedcamid
            if not 0 <= number < model.ncam:
                raise ArgumentError(f"camera: expected a number from 0 to {model.ncam - 1}, got {number}")
            return Sight(number, None, self._lens(number))
        if camera.type == _FREE:
            return self._orbit(camera.lookat, camera)
        if camera.type == _TRACKING:
            if not 0 <= camera.trackbodyid < model.nbody:
                raise ArgumentError(
                    f"camera: expected a body number below {model.nbody}, got {camera.trackbodyid}"
                )
            return self._orbit(data.subtree_com[camera.trackbodyid], camera)
        raise UnsupportedError(f"not drawn by this renderer: camera type {camera.type}")

    def _orbit(self, look_at: Any, camera: Any) -> Sight:
        gaze = RasterCanvas.orbit(list(look_at), camera.distance, camera.azimuth, camera.elevation)
        settings = self._model.vis.global_
        is_parallel = settings.orthographic or getattr(camera, "orthographic", 0)
        return Sight(-1, gaze, [settings.fovy, 0.0] if is_parallel else [settings.fovy])

    def _lens(self, camera: int) -> list[float]:
        fovy = self._fovy.item(camera)
        if self._projection.item(camera):
            return [fovy, 0.0]
        if not self._sensor_size.item(camera, 1):
            return [fovy]
        width, height = self._sensor_size[camera]
        focal_x, focal_y, centre_x, centre_y = map(float, self._intrinsic[camera])
        # MuJoCo counts the principal point from the middle of the sensor.
        top, bottom = (height / 2 - centre_y) / focal_y, (height / 2 + centre_y) / focal_y
        left, right = (width / 2 - centre_x) / focal_x, (width / 2 + centre_x) / focal_x
        return [float(bottom), float(top), float(left), float(right)]


def _abstract(mujoco: Any, model: Any, number: int) -> Any:
    """A `mujoco.MjvCamera` for a camera of the model, or its free camera for -1."""
    camera = mujoco.MjvCamera()
    camera.fixedcamid = number
    if number >= 0:
        camera.type = _FIXED
    else:
        mujoco.mjv_defaultFreeCamera(model, camera)
    return camera
