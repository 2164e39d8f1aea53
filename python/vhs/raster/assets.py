"""What a canvas is made of: textures, meshes and height fields of a model, and where the rest is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vhs._core import RasterScene, RasterSource
from vhs.raster.records import layouts

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Numbers of MuJoCo's enumerations (mjmodel.h); part of its file format, so they do not change.
_TEXTURE_2D, _TEXTURE_SKYBOX = 0, 2
_COLOURSPACE_SRGB = 2


@dataclass(frozen=True)
class Assets:
    """A model's assets in the renderer's scene."""

    scene: RasterScene
    textures: list[int | None]
    """For each texture of the model its number in the scene; None where MuJoCo shows none either."""
    meshes: list[list[int]]
    """For each mesh of the model its number in the scene, and that of its convex hull."""

    @classmethod
    def of(cls, model: Any, has_sky: bool) -> Assets:
        """Reads a model (`mujoco.MjModel`)."""
        quality = model.vis.quality
        far = model.vis.map.zfar * model.stat.extent
        scene = RasterScene(quality.numslices, quality.numstacks, quality.numquads, far)
        limits = model.vis.map
        scene.set_shadows(quality.shadowsize, limits.shadowclip * model.stat.extent, limits.shadowscale)
        ends = (limits.fogstart * model.stat.extent, limits.fogend * model.stat.extent)
        scene.set_fog(list(model.vis.rgba.fog[:3]), *ends)
        textures = [_add_texture(scene, model, i) for i in range(model.ntex)]
        meshes = [_add_mesh(scene, model, i) for i in range(model.nmesh)]
        for i in range(model.nhfield):
            _add_height_field(scene, model, i)
        skies = [i for i in range(model.ntex) if model.tex_type[i] == _TEXTURE_SKYBOX]
        sky = textures[skies[0]] if skies and has_sky else None
        if sky is not None:
            scene.set_sky(sky, list(model.vis.rgba.haze[:3]), model.vis.map.haze)
        return cls(scene, textures, meshes)


def source_of(mujoco: Any, model: Any, scene: Any, assets: Assets) -> RasterSource:
    """What is drawn of a model and a scene (`mujoco.MjvScene`), read anew at every frame."""
    geoms, lights = layouts()
    # Some packages show less of a scene than it has; the lists are asked for past them.
    lists = [getattr(mujoco.MjvScene, name).__get__(scene) for name in ("geoms", "lights")]
    return RasterSource(
        geoms=geoms.records(lists[0]), geom_places=geoms.places, lights=lights.records(lists[1]),
        light_places=lights.places, flags=scene.flags, geom_size=model.geom_size, mat_texid=model.mat_texid,
        mat_texuniform=model.mat_texuniform.view(np.uint8), mat_texrepeat=model.mat_texrepeat,
        textures=assets.textures, meshes=assets.meshes, line_width=model.vis.global_.linewidth,
    )  # fmt: skip


def _add_texture(scene: RasterScene, model: Any, index: int) -> int | None:
    """Adds a texture and returns its number in the scene."""
    start, channels = model.tex_adr[index], model.tex_nchannel[index]
    shape = (model.tex_height[index], model.tex_width[index], channels)
    if channels not in (3, 4):
        return None
    data = model.tex_data[start : start + np.prod(shape)].reshape(shape)
    # MuJoCo 3.3.0 knows no colour spaces.
    spaces = getattr(model, "tex_colorspace", None)
    is_srgb = spaces is not None and spaces[index] == _COLOURSPACE_SRGB
    if is_srgb and model.tex_type[index] == _TEXTURE_2D:
        # OpenGL decodes such textures when they are read and writes the result as it is.
        level = np.arange(256) / 255
        linear = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
        decoded = np.rint(255 * linear).astype(np.uint8)[data]
        data = np.concatenate([decoded[..., :3], data[..., 3:]], axis=-1)
    return scene.add_texture(bool(model.tex_type[index] != _TEXTURE_2D), np.ascontiguousarray(data))


def _add_mesh(scene: RasterScene, model: Any, index: int) -> list[int]:
    """Adds a mesh and its convex hull, if it has one, and returns the numbers of both."""

    def rows(values: Any, start: Any, count: Any) -> NDArray[Any]:
        return np.ascontiguousarray(values[start[index] : start[index] + count[index]])

    has_uv = model.mesh_texcoordadr[index] >= 0
    no_uv, no_faces = np.zeros((0, 2), np.float32), np.zeros((0, 3), np.int32)
    faces = (model.mesh_faceadr, model.mesh_facenum)
    vertices = rows(model.mesh_vert, model.mesh_vertadr, model.mesh_vertnum)
    mesh = scene.add_mesh(
        vertices,
        rows(model.mesh_normal, model.mesh_normaladr, model.mesh_normalnum),
        rows(model.mesh_texcoord, model.mesh_texcoordadr, model.mesh_texcoordnum) if has_uv else no_uv,
        rows(model.mesh_face, *faces),
        rows(model.mesh_facenormal, *faces),
        rows(model.mesh_facetexcoord, *faces) if has_uv else no_faces,
    )
    if model.mesh_graphadr[index] < 0:
        return [mesh, mesh]
    graph = model.mesh_graph[model.mesh_graphadr[index] :]
    start = 2 + 3 * graph[0] + 3 * graph[1]
    hull = np.ascontiguousarray(graph[start : start + 3 * graph[1]].reshape(-1, 3))
    a, b, c = (vertices[hull[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    flat = np.repeat(np.arange(len(hull), dtype=np.int32)[:, None], 3, axis=1)
    return [mesh, scene.add_mesh(vertices, normals.astype(np.float32), no_uv, hull, flat, no_faces)]


def _add_height_field(scene: RasterScene, model: Any, index: int) -> None:
    shape = (model.hfield_nrow[index], model.hfield_ncol[index])
    start = model.hfield_adr[index]
    heights = model.hfield_data[start : start + np.prod(shape)].reshape(shape)
    scene.add_height_field(list(model.hfield_size[index]), np.ascontiguousarray(heights))
