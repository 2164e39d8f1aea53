"""Surfaces that bend, skins and flexible bodies: read from the abstract scene at every frame that has any."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Surface = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]
    Flex = tuple[int | None, NDArray[np.float32], NDArray[np.float32]]

_SKIN = 106
"""`mjGEOM_SKIN`: the type of a listed geom that stands for a skin."""
_NO_UV = np.zeros((0, 2), np.float32)
_NO_BALLS, _NO_EDGES = np.zeros((0, 3), np.float32), np.zeros((0, 6), np.float32)
_NO_SURFACE = _NO_BALLS, _NO_BALLS, _NO_UV, np.zeros((0, 3), np.int32)


def softs_of(model: Any, scene: Any) -> tuple[list[Surface], list[int], list[Flex]]:
    """Surfaces, the skins among them, and flexes of a `mujoco.MjvScene`, as `set_softs` takes them."""
    # What is not listed was not written this time, and may never have been: its memory holds anything.
    listed = {geom.objid for geom in scene.geoms[: scene.ngeom] if geom.type == _SKIN} if scene.nskin else ()
    surfaces = [_skin(model, scene, i) if i in listed else _NO_SURFACE for i in range(scene.nskin)]
    skins, flexes = list(range(scene.nskin)), []
    for i in range(scene.nflex):
        surface = None
        if scene.flexfaceused[i]:
            surface = len(surfaces)
            surfaces.append(_flex_surface(model, scene, i))
        is_covered = scene.flexskinopt and scene.flexfaceused[i]
        first, count = scene.flexvertadr[i], scene.flexvertnum[i]
        vertices = scene.flexvert.reshape(-1, 3)[first : first + count]
        balls = vertices if scene.flexvertopt and not is_covered else _NO_BALLS
        edges = _NO_EDGES
        if scene.flexedgeopt and not is_covered:
            first, count = scene.flexedgeadr[i], scene.flexedgenum[i]
            edges = vertices[scene.flexedge.reshape(-1, 2)[first : first + count]].reshape(-1, 6)
        flexes.append((surface, np.ascontiguousarray(balls), np.ascontiguousarray(edges)))
    return surfaces, skins, flexes


def _skin(model: Any, scene: Any, index: int) -> Surface:
    first, count = scene.skinvertadr[index], scene.skinvertnum[index]

    def rows(values: Any) -> NDArray[np.float32]:
        return np.ascontiguousarray(values.reshape(-1, 3)[first : first + count])

    uv, start = _NO_UV, model.skin_texcoordadr[index]
    if start >= 0:
        uv = np.ascontiguousarray(model.skin_texcoord[start : start + count])
    start = model.skin_faceadr[index]
    faces = np.ascontiguousarray(model.skin_face[start : start + model.skin_facenum[index]])
    return rows(scene.skinvert), rows(scene.skinnormal), uv, faces


def _flex_surface(model: Any, scene: Any, index: int) -> Surface:
    corners = 3 * scene.flexfaceused[index]
    first = 3 * scene.flexfaceadr[index]

    def rows(values: Any, width: int) -> NDArray[np.float32]:
        return np.ascontiguousarray(values.reshape(-1, width)[first : first + corners])

    uv = rows(scene.flextexcoord, 2) if model.flex_texcoordadr[index] >= 0 else _NO_UV
    faces = np.arange(corners, dtype=np.int32).reshape(-1, 3)
    return rows(scene.flexface, 3), rows(scene.flexnormal, 3), uv, faces
