from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vhs.envs import OBJECT_NAMES, RoomConfig, RoomEnv
from vhs.envs.config import OBJECT_NAV
from vhs.envs.kinematics import Pose
from vhs.envs.objects import ObjectAssetError, builtin_objects, load_objects
from vhs.envs.scene import ObjectPose
from vhs.envs.shapes import Mesh, bottle, carton
from vhs.png import png_bytes

CUBE = """
v 0 0 0\nv 0.1 0 0\nv 0.1 0.2 0\nv 0 0.2 0\nv 0 0 0.3\nv 0.1 0 0.3\nv 0.1 0.2 0.3\nv 0 0.2 0.3
vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1
f 4/1 3/2 2/3 1/4\nf 5/1 6/2 7/3 8/4
f 1/1 2/2 6/3 5/4\nf 2/1 3/2 7/3 6/4\nf 3/1 4/2 8/3 7/4\nf 4/1 1/2 5/3 8/4
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for label, name in enumerate(OBJECT_NAMES):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mesh.obj").write_text(CUBE)
        picture = np.full((8, 8, 3), 40 * label, np.uint8)
        (tmp_path / name / "texture.png").write_bytes(png_bytes(picture))
    return tmp_path


def edges(mesh: Mesh) -> dict[tuple[tuple[float, ...], tuple[float, ...]], int]:
    """Directed edges by position, so that doubled vertices count as one."""
    counts: dict[tuple[tuple[float, ...], tuple[float, ...]], int] = {}
    spots = [tuple(row) for row in np.round(mesh.vertices_m, 9).tolist()]
    for face in mesh.faces.tolist():
        corners = [spots[index] for index in face]
        if len(set(corners)) < 3:
            continue
        for i in range(3):
            edge = (corners[i], corners[(i + 1) % 3])
            counts[edge] = counts.get(edge, 0) + 1
    return counts


@pytest.mark.parametrize(
    "mesh",
    [
        bottle([(0.9, 0.0), (1.0, 0.5), (0.3, 1.0)], 0.2, 0.08, 0.06),
        carton(0.2, 0.09, 0.07, gable=0.0),
        carton(0.2, 0.08, 0.08, gable=0.2),
    ],
    ids=["bottle", "box", "gable"],
)
def test_meshes_are_centred_and_face_outwards(mesh: Mesh) -> None:
    assert np.allclose(mesh.vertices_m.min(axis=0), -mesh.vertices_m.max(axis=0))
    assert mesh.texcoords.min() >= 0.0
    assert mesh.texcoords.max() <= 1.0
    a, b, c = (mesh.vertices_m[mesh.faces[:, i]] for i in range(3))
    # Divergence theorem: the signed volume of an outward surface is positive and less than its box.
    volume_m3 = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)
    box_m3 = 8 * math.prod(mesh.half_extents_m)
    assert 0.3 * box_m3 < volume_m3 <= box_m3 * (1 + 1e-9)
    # No outward normal of these star-shaped bodies points to the axis.
    normals, centres = np.cross(b - a, c - a), (a + b + c) / 3
    assert (np.einsum("ij,ij->i", normals[:, :2], centres[:, :2]) >= -1e-12).all()


def test_a_bottle_is_closed() -> None:
    counts = edges(bottle([(0.9, 0.0), (1.0, 0.5), (0.3, 1.0)], 0.2, 0.08, 0.06))
    assert all(counts.get((b, a), 0) == count for (a, b), count in counts.items())


def test_builtin_objects_come_in_label_order_with_distinct_sizes() -> None:
    assets = builtin_objects()
    assert tuple(asset.name for asset in assets) == OBJECT_NAMES
    sizes = np.array([asset.half_extents_m for asset in assets])
    assert (sizes > 0.03).all()
    assert (sizes < 0.12).all()
    assert len({tuple(row) for row in sizes.tolist()}) == 5


def test_png_round_trip_by_hand() -> None:
    picture = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    content = png_bytes(picture)
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    start = content.index(b"IDAT") + 4
    length = int.from_bytes(content[start - 8 : start - 4], "big")
    rows = np.frombuffer(zlib.decompress(content[start : start + length]), np.uint8).reshape(2, 1 + 9)
    assert (rows[:, 0] == 0).all()
    assert np.array_equal(rows[:, 1:].reshape(2, 3, 3), picture)


def test_png_refuses_other_pictures() -> None:
    with pytest.raises(ValueError, match=r"picture: expected uint8 \[H, W, 3\], found float64 \[2, 2, 3\]"):
        png_bytes(np.zeros((2, 2, 3)))  # type: ignore[arg-type]


def test_own_meshes_are_placed_by_their_bounding_box(folder: Path, arrange: Callable[..., None]) -> None:
    env = RoomEnv(OBJECT_NAV, objects_dir=folder, renderer="none")
    env.reset(seed=0)
    model, data = env.world.model, env.world.data
    scale = RoomConfig().object_scale
    arrange(env, Pose(0.0, 0.0, 0), {1: ObjectPose(0.8, 0.3, 0.0, False)})
    geom = int(model.body(OBJECT_NAMES[1]).geomadr[0])
    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    spots = (
        data.geom_xpos[geom] + model.mesh_vert[first : first + count] @ data.geom_xmat[geom].reshape(3, 3).T
    )
    half = np.array([0.05, 0.1, 0.15]) * scale
    assert spots.min(axis=0) == pytest.approx(np.array([0.8, 0.3, half[2]]) - half, abs=1e-5)
    assert spots.max(axis=0) == pytest.approx(np.array([0.8, 0.3, half[2]]) + half, abs=1e-5)


@pytest.mark.usefixtures("opengl")
def test_own_textures_are_drawn(folder: Path, arrange: Callable[..., None]) -> None:
    env = RoomEnv(OBJECT_NAV, objects_dir=folder)
    env.reset(seed=0)
    reds = []
    for label in range(5):
        arrange(env, Pose(0.0, 0.0, 0), {label: ObjectPose(0.5, 0.0, 0.0, False)})
        reds.append(int(env.step(1)[0]["image"].min()))
        arrange(env, Pose(0.0, 0.0, 0), {label: ObjectPose(0.8, 0.0, 0.0, False)})
        reds[-1] = int(env.step(2)[0]["image"].astype(int).sum())
    assert len(set(reds)) == 5


def test_missing_files_are_all_named(folder: Path) -> None:
    (folder / "milk" / "mesh.obj").unlink()
    (folder / "mustard" / "texture.png").unlink()
    with pytest.raises(
        ObjectAssetError,
        match=r"expected mesh\.obj and texture\.png in each.*missing: mustard/texture\.png, milk/mesh\.obj",
    ):
        load_objects(folder)


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(ObjectAssetError, match="nowhere: expected mesh"):
        RoomEnv(OBJECT_NAV, objects_dir=tmp_path / "nowhere", renderer="none")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", r"expected finite `v x y z` lines, found 0 usable vertices"),
        ("v 0 0 nan\nvt 0 0\n", r"expected finite `v x y z` lines"),
        ("v 0 0 one\nvt 0 0\n", r"expected three numbers after each `v`"),
        ("v 0 0\nvt 0 0\n", r"expected finite `v x y z` lines"),
        ("v 0 0 0\nv 1 1 1\n", r"expected texture coordinates \(`vt` lines\), found none"),
        ("v 0 0 0\nv 1 1 0\nvt 0 0\n", r"expected a solid, found extents \[1\.0, 1\.0, 0\.0\] m"),
    ],
)
def test_damaged_meshes_are_refused(folder: Path, content: str, message: str) -> None:
    (folder / "milk" / "mesh.obj").write_text(content)
    with pytest.raises(ObjectAssetError, match=message):
        load_objects(folder)
