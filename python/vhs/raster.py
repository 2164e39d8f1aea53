"""A renderer for MuJoCo models that needs no OpenGL: `RasterRenderer` has the methods of `mujoco.Renderer`.

Owns the translation from a MuJoCo model to plain numbers; the drawing is Rust (`rust/vhs-raster`). MuJoCo
itself is never imported: models, data, cameras and options are read by attribute; `import vhs` stays light.

Drawn as MuJoCo's OpenGL renderer draws it with shadows and reflections off. What is not drawn (height fields,
skins, flexible bodies, spatial tendons, ...) is refused at construction by name, not left out in silence.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from vhs._core import (
    ArgumentError,
    ProtocolError,
    RasterCanvas,
    RasterScene,
    ShapeError,
    UnsupportedError,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

Antialias = Literal["off", "multisample", "supersample"]

# Numbers of MuJoCo's enumerations (mjmodel.h, mjvisualize.h); part of its file format, so they do not change.
_GEOM_HFIELD = 1
_GEOM_MESHES = (7, 8)  # mesh, signed distance field
_OBJ_GEOM, _OBJ_SITE = 5, 6
_TEXTURE_2D, _TEXTURE_SKYBOX = 0, 2
_TEXTURE_ROLE_RGB = 1
_COLOURSPACE_SRGB = 2
_LIGHT_SPOT, _LIGHT_DIRECTIONAL = 0, 1
_SENSOR_RANGEFINDER = 7
_TRANSMISSION_SLIDERCRANK = 2
_WRAP_JOINT = 1
_CAMERA_FREE, _CAMERA_TRACKING, _CAMERA_FIXED = 0, 1, 2
_VIS_TEXTURE, _VIS_STATIC = 1, 22
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)
_DEFAULT_GROUPS = np.array([1, 1, 1, 0, 0, 0], dtype=bool)
# Flags of MjvOption that change nothing here: they belong to things that the constructor refuses, or say how
# to draw things that other flags switch on.
_SILENT_FLAGS = frozenset({_VIS_TEXTURE, 7, 8, 11, 13, 17, _VIS_STATIC, 23, 24, 25, 26, 27})


class RasterRenderer:
    """Renders MuJoCo scenes in software, without OpenGL; the picture is the same on every machine.

    Use it like `mujoco.Renderer`: `update_scene(data, camera)`, then `render()`. Geometry, materials and
    cameras are read from the model at construction; call `refresh()` after changing them.
    """

    def __init__(
        self,
        model: Any,
        height: int = 240,
        width: int = 320,
        *,
        antialias: Antialias = "off",
        has_sky: bool = True,
    ) -> None:
        """Prepares the model's meshes, textures and materials.

        Args:
            model: A `mujoco.MjModel`.
            height: Picture height in pixels.
            width: Picture width in pixels.
            antialias: "off" takes one sample a pixel. "multisample" smooths edges with four samples a pixel,
                as OpenGL does. "supersample" draws at twice the size and averages: textures are smoothed too.
            has_sky: Whether to draw the model's sky and haze; without them the background is black.

        Raises:
            UnsupportedError: The model shows something that is not drawn here; the message names it.
            ArgumentError, ShapeError, NonFiniteError: A size or a number in the model makes no picture.
        """
        modes = {"off": 0, "multisample": 1, "supersample": 2}
        if antialias not in modes:
            raise ArgumentError(f"antialias: expected one of {sorted(modes)}, got {antialias!r}")
        self._model = model
        self._height, self._width = height, width
        self._antialias = modes[antialias]
        self._has_sky = has_sky
        self._mode: Literal["colour", "depth", "segmentation"] = "colour"
        self._canvas: RasterCanvas | None = None
        self.refresh()

    def refresh(self) -> None:
        """Reads the model again, after its geometry, materials, textures, lights or cameras were changed."""
        model = self._model
        _refuse_what_is_not_drawn(model)
        scene = _scene_of(model, self._has_sky)
        lights = _lights_of(model, scene)
        canvas = RasterCanvas(scene, model.ngeom, lights, self._height, self._width, self._antialias)
        extent = model.stat.extent
        self._near, self._far = model.vis.map.znear * extent, model.vis.map.zfar * extent
        self._lenses = [_lens_of(model, i) for i in range(model.ncam)]
        self._camera_numbers = {model.camera(i).name: i for i in range(model.ncam)}
        self._visibility_key: bytes | None = None
        self._bound: Any = None
        self._canvas = canvas

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
            scene_option: A `mujoco.MjvOption`; its groups and static flag choose what is drawn.

        Raises:
            ArgumentError: There is no such camera; the last scene stays.
            NonFiniteError: A pose is NaN or infinite; the last scene stays.
            ProtocolError: The renderer is closed.
            UnsupportedError: `scene_option` asks for decorations that are not drawn here.
        """
        canvas = self._open_canvas()
        if data is not self._bound:
            canvas.bind(
                data.geom_xpos, data.geom_xmat, data.site_xpos, data.site_xmat,
                data.light_xpos, data.light_xdir, data.cam_xpos, data.cam_xmat,
            )  # fmt: skip
            self._bound = data
        if scene_option is not None or self._visibility_key != b"":
            self._set_visible(canvas, scene_option)
        fixed, gaze, lens = self._view_of(data, camera)
        canvas.update(fixed, gaze, lens, self._near, self._far)

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
        """
        canvas = self._open_canvas()
        shape, dtype = self._expected()
        if out is None:
            out = np.empty(shape, dtype)
        is_planar = self._mode == "colour" and out.shape == (3, self._height, self._width) != shape
        if out.shape != shape and not is_planar:
            raise ShapeError(f"`out`: expected shape {shape} when rendering {self._mode}, got {out.shape}")
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
    ) -> NDArray[Any]:
        """Draws many states of the model.

        Args:
            datas: N `mujoco.MjData` of this model.
            camera: As in `update_scene`, for all of them.
            scene_option: As in `update_scene`.
            out: Array for the result, shape [N, ...] with the rest as in `render`.

        Returns:
            `out`, or a new array of N pictures.
        """
        shape, dtype = self._expected()
        if out is None:
            out = np.empty((len(datas), *shape), dtype)
        if len(out) != len(datas):
            raise ShapeError(f"`out`: expected {len(datas)} pictures, got {len(out)}")
        for data, picture in zip(datas, out, strict=True):
            self.update_scene(data, camera, scene_option)
            self.render(out=picture)
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

    def _set_visible(self, canvas: RasterCanvas, option: Any) -> None:
        """Passes on which geoms and sites are drawn, if that has changed."""
        if option is None:
            key, geom_groups, site_groups, shows_static = b"", _DEFAULT_GROUPS, _DEFAULT_GROUPS, True
        else:
            key = bytes(option.geomgroup) + bytes(option.sitegroup) + bytes(option.flags)
            if key == self._visibility_key:
                return
            _refuse_decorations(option)
            geom_groups, site_groups = option.geomgroup.astype(bool), option.sitegroup.astype(bool)
            shows_static = bool(option.flags[_VIS_STATIC])
        model = self._model
        geoms = geom_groups[np.clip(model.geom_group, 0, 5)]
        sites = site_groups[np.clip(model.site_group, 0, 5)]
        if not shows_static:
            geoms &= model.body_weldid[model.geom_bodyid] != 0
            sites &= model.body_weldid[model.site_bodyid] != 0
        if np.any(geoms & (model.geom_type == _GEOM_HFIELD)):
            raise UnsupportedError("not drawn by this renderer: height field")
        canvas.set_visible(np.concatenate([geoms, sites]))
        self._visibility_key = key

    def _view_of(self, data: Any, camera: Any) -> tuple[int, Any, list[float]]:
        """Number of a fixed camera or -1, gaze of any other camera, and lens."""
        if isinstance(camera, str):
            if camera not in self._camera_numbers:
                raise ArgumentError(f"camera: expected one of {sorted(self._camera_numbers)}, got {camera!r}")
            camera = self._camera_numbers[camera]
        if isinstance(camera, int | np.integer):
            if not -1 <= camera < len(self._lenses):
                raise ArgumentError(
                    f"camera: expected a number from -1 to {len(self._lenses) - 1}, got {camera}"
                )
            if camera >= 0:
                return int(camera), None, self._lenses[camera]
            return self._orbit(
                self._model.stat.center, 1.5 * self._model.stat.extent, self._model.vis.global_
            )
        if camera.type == _CAMERA_FIXED:
            return self._view_of(data, camera.fixedcamid)
        if camera.type == _CAMERA_FREE:
            return self._orbit(camera.lookat, camera.distance, camera)
        if camera.type == _CAMERA_TRACKING:
            if not 0 <= camera.trackbodyid < self._model.nbody:
                raise ArgumentError(
                    f"camera: expected a body number below {self._model.nbody}, got {camera.trackbodyid}"
                )
            return self._orbit(data.subtree_com[camera.trackbodyid], camera.distance, camera)
        raise UnsupportedError(f"not drawn by this renderer: camera type {camera.type}")

    def _orbit(self, look_at: Any, distance: float, angles: Any) -> tuple[int, Any, list[float]]:
        gaze = RasterCanvas.orbit(list(look_at), distance, angles.azimuth, angles.elevation)
        settings = self._model.vis.global_
        return -1, gaze, [settings.fovy, 0.0] if settings.orthographic else [settings.fovy]


def _refuse_what_is_not_drawn(model: Any) -> None:
    """Raises for the first thing that MuJoCo would show by default and this renderer would not."""
    shown = _DEFAULT_GROUPS[np.clip(model.geom_group, 0, 5)]
    tendons = _DEFAULT_GROUPS[np.clip(model.tendon_group, 0, 5)] if model.ntendon else np.zeros(0, bool)
    is_spatial = [bool(model.wrap_type[model.tendon_adr[i]] != _WRAP_JOINT) for i in range(model.ntendon)]
    found = {
        "height field": np.any(shown & (model.geom_type == _GEOM_HFIELD)),
        "skin": model.nskin,
        "flexible body": model.nflex,
        "spatial tendon": np.any(tendons & np.array(is_spatial, dtype=bool)),
        "slider-crank actuator": np.any(model.actuator_trntype == _TRANSMISSION_SLIDERCRANK),
        "range finder": np.any(model.sensor_type == _SENSOR_RANGEFINDER),
    }
    for name, is_there in found.items():
        if is_there:
            raise UnsupportedError(f"not drawn by this renderer: {name}")


def _refuse_decorations(option: Any) -> None:
    """Raises for options that change the picture in ways that are not drawn here."""
    if option.label or option.frame:
        raise UnsupportedError("not drawn by this renderer: labels and frames")
    if not option.flags[_VIS_TEXTURE]:
        raise UnsupportedError("not drawn by this renderer: a scene without its textures")
    unusual = {i for i, flag in enumerate(option.flags) if flag} - _SILENT_FLAGS
    if unusual:
        raise UnsupportedError(f"not drawn by this renderer: visualization flags {sorted(unusual)}")


def _scene_of(model: Any, has_sky: bool) -> RasterScene:
    """The model's textures, meshes, geoms and sites."""
    quality = model.vis.quality
    far = model.vis.map.zfar * model.stat.extent
    scene = RasterScene(quality.numslices, quality.numstacks, quality.numquads, far)
    textures = [_add_texture(scene, model, i) for i in range(model.ntex)]
    meshes = [_add_mesh(scene, model, i) for i in range(model.nmesh)]
    for i in range(model.ngeom):
        kind = int(model.geom_type[i])
        mesh = meshes[model.geom_dataid[i]] if kind in _GEOM_MESHES else -1
        surface = _surface_of(model, model.geom_matid[i], model.geom_rgba[i], textures)
        if kind == _GEOM_HFIELD:
            # Hidden by its group, or it would have been refused; a ball of radius 0 keeps its number.
            kind = 2
            scene.add_geom(kind=kind, size=[0.0] * 3, mesh=-1, tag=[i, _OBJ_GEOM], **surface)
            continue
        scene.add_geom(kind=kind, size=list(model.geom_size[i]), mesh=mesh, tag=[i, _OBJ_GEOM], **surface)
    for i in range(model.nsite):
        surface = _surface_of(model, model.site_matid[i], model.site_rgba[i], textures)
        size, tag = list(model.site_size[i]), [i, _OBJ_SITE]
        scene.add_geom(kind=int(model.site_type[i]), size=size, mesh=-1, tag=tag, **surface)
    skies = [i for i in range(model.ntex) if model.tex_type[i] == _TEXTURE_SKYBOX]
    if skies and has_sky:
        scene.set_sky(textures[skies[0]], list(model.vis.rgba.haze[:3]), model.vis.map.haze)
    return scene


def _add_texture(scene: RasterScene, model: Any, index: int) -> int:
    """Adds a texture and returns its number in the scene."""
    start, channels = model.tex_adr[index], model.tex_nchannel[index]
    shape = (model.tex_height[index], model.tex_width[index], channels)
    if channels not in (3, 4):
        raise UnsupportedError(f"not drawn by this renderer: texture {index} with {channels} channels")
    data = model.tex_data[start : start + np.prod(shape)].reshape(shape)
    if model.tex_colorspace[index] == _COLOURSPACE_SRGB and model.tex_type[index] == _TEXTURE_2D:
        # OpenGL decodes such textures when they are read and writes the result as it is.
        level = np.arange(256) / 255
        linear = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
        decoded = np.rint(255 * linear).astype(np.uint8)[data]
        data = np.concatenate([decoded[..., :3], data[..., 3:]], axis=-1)
    return scene.add_texture(bool(model.tex_type[index] != _TEXTURE_2D), np.ascontiguousarray(data))


def _add_mesh(scene: RasterScene, model: Any, index: int) -> int:
    """Adds a mesh and returns its number in the scene."""

    def rows(values: Any, start: Any, count: Any) -> NDArray[Any]:
        return np.ascontiguousarray(values[start[index] : start[index] + count[index]])

    has_uv = model.mesh_texcoordadr[index] >= 0
    no_uv, no_faces = np.zeros((0, 2), np.float32), np.zeros((0, 3), np.int32)
    faces = (model.mesh_faceadr, model.mesh_facenum)
    return scene.add_mesh(
        rows(model.mesh_vert, model.mesh_vertadr, model.mesh_vertnum),
        rows(model.mesh_normal, model.mesh_normaladr, model.mesh_normalnum),
        rows(model.mesh_texcoord, model.mesh_texcoordadr, model.mesh_texcoordnum) if has_uv else no_uv,
        rows(model.mesh_face, *faces),
        rows(model.mesh_facenormal, *faces),
        rows(model.mesh_facetexcoord, *faces) if has_uv else no_faces,
    )


def _surface_of(model: Any, material: int, rgba: NDArray[np.float32], textures: list[int]) -> dict[str, Any]:
    """Keywords of `RasterScene.add_geom` for a material and a colour (MuJoCo's `setMaterial`)."""
    surface: dict[str, Any] = {
        "rgba": list(rgba), "gloss": [0.0, 0.5, 0.5], "is_mirror": False, "texture": -1,
        "repeat": [1.0, 1.0], "is_uniform": False,
    }  # fmt: skip
    if material < 0:
        return surface
    if np.array_equal(rgba, _DEFAULT_RGBA):
        surface["rgba"] = list(model.mat_rgba[material])
    texture = model.mat_texid[material, _TEXTURE_ROLE_RGB]
    return surface | {
        "gloss": [model.mat_emission[material], model.mat_specular[material], model.mat_shininess[material]],
        "is_mirror": bool(model.mat_reflectance[material] > 0),
        "texture": textures[texture] if texture >= 0 else -1,
        "repeat": list(model.mat_texrepeat[material]),
        "is_uniform": bool(model.mat_texuniform[material]),
    }


def _lights_of(model: Any, scene: RasterScene) -> list[int]:
    """Adds the lights that are on; returns for each its number in the model, -1 for the headlight."""
    lights = []
    head = model.vis.headlight
    if head.active:
        scene.add_light([list(head.ambient), list(head.diffuse), list(head.specular)], None, True)
        lights.append(-1)
    for i in range(model.nlight):
        # Point and image lights are ignored by MuJoCo's OpenGL renderer as well.
        if not model.light_active[i] or model.light_type[i] not in (_LIGHT_SPOT, _LIGHT_DIRECTIONAL):
            continue
        colours = [list(model.light_ambient[i]), list(model.light_diffuse[i]), list(model.light_specular[i])]
        spot = [*model.light_attenuation[i], model.light_exponent[i], model.light_cutoff[i]]
        scene.add_light(colours, spot if model.light_type[i] == _LIGHT_SPOT else None, False)
        lights.append(i)
    return lights


def _lens_of(model: Any, camera: int) -> list[float]:
    """Lens of a camera in the model, as `RasterCanvas.update` takes it."""
    fovy = float(model.cam_fovy[camera])
    if model.cam_projection[camera] == 1:
        return [fovy, 0.0]
    width, height = model.cam_sensorsize[camera]
    if not height:
        return [fovy]
    focal_x, focal_y, centre_x, centre_y = map(float, model.cam_intrinsic[camera])
    # MuJoCo counts the principal point from the middle of the sensor.
    top, bottom = (height / 2 - centre_y) / focal_y, (height / 2 + centre_y) / focal_y
    left, right = (width / 2 - centre_x) / focal_x, (width / 2 + centre_x) / focal_x
    return [float(bottom), float(top), float(left), float(right)]
