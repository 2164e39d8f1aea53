"""The five objects: our own bottles and cartons, or the user's meshes.

Owns `ObjectAsset` (what the scene needs of one object), the built-in catalogue and the loader of
`objects_dir`. Sizes are those of life; the scene multiplies them by `RoomConfig.object_scale`.

Layout of an `objects_dir`: one folder per object, named as in `OBJECT_NAMES`, holding `mesh.obj` (metres, z
up, front to -x, any origin) and `texture.png`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from vhs.envs.config import OBJECT_NAMES
from vhs.envs.shapes import Mesh, bottle, carton
from vhs.envs.textures import label_wrap
from vhs.png import png_bytes

MESH_FILE = "mesh.obj"
TEXTURE_FILE = "texture.png"


class ObjectAssetError(ValueError):
    """An `objects_dir` does not hold what is needed."""


@dataclass(frozen=True, slots=True)
class ObjectAsset:
    """One object as MuJoCo assets, at life size."""

    name: str
    mesh_xml: str
    """Attributes of its `<mesh>` element, name, class and scale apart."""
    texture_png: bytes
    half_extents_m: tuple[float, float, float]
    """Half of the upright bounding box along x, y and z; its centre is the object's origin."""
    files: tuple[tuple[str, bytes], ...] = ()
    """Further files that `mesh_xml` names: (name, content)."""


@cache
def builtin_objects() -> tuple[ObjectAsset, ...]:
    """The five procedural objects, in order of their class labels."""
    meshes = _builtin_meshes()
    return tuple(
        ObjectAsset(name, _inline_mesh_xml(meshes[name]), png_bytes(picture), meshes[name].half_extents_m)
        for name, picture in zip(OBJECT_NAMES, _builtin_pictures(), strict=True)
    )


def load_objects(objects_dir: str | Path | None) -> tuple[ObjectAsset, ...]:
    """The built-in objects, or one mesh and texture per object from a folder.

    Args:
        objects_dir: folder laid out as the module's header says; None gives the built-in objects.

    Raises:
        ObjectAssetError: a folder or file is missing, or a mesh has no vertices or no texture coordinates.
    """
    if objects_dir is None:
        return builtin_objects()
    root = Path(objects_dir)
    needed = [root / name / file for name in OBJECT_NAMES for file in (MESH_FILE, TEXTURE_FILE)]
    missing = [str(path.relative_to(root)) for path in needed if not path.is_file()]
    if missing:
        raise ObjectAssetError(
            f"objects_dir {root}: expected {MESH_FILE} and {TEXTURE_FILE} in each of the folders "
            f"{', '.join(OBJECT_NAMES)}; missing: {', '.join(missing)}"
        )
    return tuple(_load_object(root, name) for name in OBJECT_NAMES)


def _load_object(root: Path, name: str) -> ObjectAsset:
    """Read one object's files and centre its bounding box."""
    path = root / name / MESH_FILE
    content = path.read_bytes()
    lines = [line.split() for line in content.decode("utf-8", errors="replace").splitlines()]
    try:
        vertices = np.array([[float(x) for x in line[1:4]] for line in lines if line[:1] == ["v"]], float)
    except ValueError as error:
        raise ObjectAssetError(f"{path}: expected three numbers after each `v`, found {error}") from error
    if vertices.size == 0 or vertices.shape[1:] != (3,) or not np.isfinite(vertices).all():
        raise ObjectAssetError(
            f"{path}: expected finite `v x y z` lines, found {len(vertices)} usable vertices"
        )
    if not any(line[:1] == ["vt"] for line in lines):
        raise ObjectAssetError(f"{path}: expected texture coordinates (`vt` lines), found none")
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    half = (high - low) / 2
    if (half <= 0).any():
        raise ObjectAssetError(f"{path}: expected a solid, found extents {(2 * half).tolist()} m")
    middle = (low + high) / 2
    file = f"{name}.obj"
    return ObjectAsset(
        name,
        f'file="{file}" refpos="{_numbers(middle)}"',
        (root / name / TEXTURE_FILE).read_bytes(),
        (float(half[0]), float(half[1]), float(half[2])),
        ((file, content),),
    )


def _builtin_meshes() -> dict[str, Mesh]:
    """Silhouettes that differ: flat with a nozzle, squat, long-necked, plain box, gabled."""
    squeeze = [(0.92, 0.0), (1.0, 0.06), (0.94, 0.45), (1.0, 0.68), (0.6, 0.78), (0.42, 0.8), (0.14, 1.0)]
    squat = [(0.9, 0.0), (1.0, 0.04), (1.0, 0.55), (0.78, 0.7), (0.46, 0.78), (0.46, 1.0)]
    necked = [
        (0.85, 0.0),
        (0.95, 0.05),
        (1.0, 0.42),
        (0.85, 0.56),
        (0.4, 0.7),
        (0.36, 0.86),
        (0.46, 0.87),
        (0.46, 1.0),
    ]
    return {
        "mustard": bottle(squeeze, height_m=0.2, width_m=0.092, depth_m=0.072),
        "barbecue_sauce": bottle(squat, height_m=0.18, width_m=0.088, depth_m=0.088),
        "salad_dressing": bottle(necked, height_m=0.21, width_m=0.088, depth_m=0.088),
        "orange_juice": carton(height_m=0.18, width_m=0.095, depth_m=0.075, gable=0.0),
        "milk": carton(height_m=0.205, width_m=0.085, depth_m=0.085, gable=0.2),
    }


def _builtin_pictures() -> list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
    """Labels in order of `OBJECT_NAMES`: yellow, dark red, green, orange, white and blue."""
    return [
        label_wrap(
            [(0.76, (255, 208, 12)), (1.0, (255, 222, 60))],
            (0.24, 0.5, (255, 246, 190)),
            patch=(190, 110, 10),
        ),
        label_wrap(
            [(0.76, (84, 14, 12)), (1.0, (22, 18, 18))], (0.16, 0.46, (138, 18, 22)), patch=(214, 170, 120)
        ),
        label_wrap(
            [(0.84, (38, 150, 52)), (1.0, (14, 78, 28))], (0.14, 0.4, (178, 222, 150)), patch=(20, 104, 36)
        ),
        label_wrap(
            [(0.86, (255, 112, 4)), (1.0, (255, 140, 20))], (0.3, 0.62, (255, 150, 40)), patch=(255, 236, 200)
        ),
        label_wrap(
            [(0.22, (24, 76, 214)), (0.86, (250, 251, 255)), (1.0, (40, 100, 228))],
            (0.42, 0.66, (250, 251, 255)),
            patch=(24, 76, 214),
        ),
    ]


def _inline_mesh_xml(mesh: Mesh) -> str:
    """Attributes that carry the whole mesh in the XML text."""
    # MuJoCo's texture coordinates run from the top of the picture, ours from the bottom.
    texcoords = np.stack([mesh.texcoords[:, 0], 1.0 - mesh.texcoords[:, 1]], axis=1)
    return (
        f'vertex="{_numbers(mesh.vertices_m)}" texcoord="{_numbers(texcoords)}" '
        f'face="{" ".join(map(str, mesh.faces.ravel().tolist()))}"'
    )


def _numbers(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    """Numbers as MJCF wants them; micrometres are fine enough."""
    return " ".join(f"{value:.6g}" for value in values.ravel().tolist())
