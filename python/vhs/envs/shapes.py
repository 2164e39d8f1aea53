"""Meshes made in code: turned bottles and gabled cartons.

Owns `Mesh` and its two makers. A mesh is centred on its bounding box, stands along z, and shows its front to
-x, so that laying it on its back (z to x) turns the front up. Texture coordinates: u runs once around, v from
bottom (0) to top (1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles with one texture coordinate a vertex."""

    vertices_m: FloatArray
    """Positions, float64 [V, 3]."""
    texcoords: FloatArray
    """u and v in 0..1, float64 [V, 2]."""
    faces: NDArray[np.int64]
    """Vertex indices, counter-clockwise from outside, int64 [F, 3]."""

    def centred(self) -> Mesh:
        """The same mesh with its bounding box around the origin."""
        middle = (self.vertices_m.min(axis=0) + self.vertices_m.max(axis=0)) / 2
        return Mesh(self.vertices_m - middle, self.texcoords, self.faces)

    @property
    def half_extents_m(self) -> tuple[float, float, float]:
        """Half of the bounding box, along x, y and z."""
        half = (self.vertices_m.max(axis=0) - self.vertices_m.min(axis=0)) / 2
        return float(half[0]), float(half[1]), float(half[2])


def bottle(
    profile: Sequence[tuple[float, float]],
    height_m: float,
    width_m: float,
    depth_m: float,
    segments: int = 14,
) -> Mesh:
    """Turn a profile around z.

    Args:
        profile: (radius, height) pairs from bottom to top, as fractions of the half width and of the height.
        height_m: full height.
        width_m: full width, along y.
        depth_m: full depth, along x; differs from the width for a flattened bottle.
        segments: sides of the turned polygon.
    """
    # One vertex column is doubled where u wraps from 1 to 0.
    turn = np.linspace(0.0, 1.0, segments + 1)
    angle = math.tau * turn
    rows = [(0.0, profile[0][1]), *profile, (0.0, profile[-1][1])]
    vertices, texcoords = [], []
    for radius, level in rows:
        x, y = radius * depth_m / 2 * np.cos(angle), radius * width_m / 2 * np.sin(angle)
        vertices.append(np.stack([x, y, np.full_like(x, level * height_m)], axis=1))
        texcoords.append(np.stack([turn, np.full_like(turn, level)], axis=1))
    columns = segments + 1
    faces = []
    for row in range(len(rows) - 1):
        for column in range(segments):
            a, b = row * columns + column, row * columns + column + 1
            c, d = a + columns, b + columns
            if rows[row][0] > 0:
                faces.append((a, b, d))
            if rows[row + 1][0] > 0:
                faces.append((a, d, c))
    return Mesh(np.concatenate(vertices), np.concatenate(texcoords), np.array(faces, np.int64)).centred()


def carton(height_m: float, width_m: float, depth_m: float, gable: float) -> Mesh:
    """A box with a gabled top whose ridge runs along y.

    Args:
        height_m: full height, gable included.
        width_m: full width, along y.
        depth_m: full depth, along x.
        gable: share of the height taken by the gable; 0 gives a plain box.
    """
    hx, hy, shoulder = depth_m / 2, width_m / 2, height_m * (1.0 - gable)
    ridge = 0.12 * hx if gable > 0 else hx
    corners = [(-hx, -hy), (hx, -hy), (hx, hy), (-hx, hy)]
    tops = [(-ridge, -hy), (ridge, -hy), (ridge, hy), (-ridge, hy)]
    vertices: list[tuple[float, float, float]] = []
    texcoords: list[tuple[float, float]] = []
    faces: list[tuple[int, int, int]] = []

    def add_quad(points: Sequence[tuple[float, float, float]], uvs: Sequence[tuple[float, float]]) -> None:
        start = len(vertices)
        vertices.extend(points)
        texcoords.extend(uvs)
        faces.extend([(start, start + 1, start + 2), (start, start + 2, start + 3)])

    v_shoulder = 1.0 - gable
    for side in range(4):
        (x0, y0), (x1, y1) = corners[side], corners[(side + 1) % 4]
        (tx0, ty0), (tx1, ty1) = tops[side], tops[(side + 1) % 4]
        u0, u1 = side / 4, (side + 1) / 4
        add_quad(
            [(x0, y0, 0.0), (x1, y1, 0.0), (x1, y1, shoulder), (x0, y0, shoulder)],
            [(u0, 0.0), (u1, 0.0), (u1, v_shoulder), (u0, v_shoulder)],
        )
        if gable > 0:
            add_quad(
                [(x0, y0, shoulder), (x1, y1, shoulder), (tx1, ty1, height_m), (tx0, ty0, height_m)],
                [(u0, v_shoulder), (u1, v_shoulder), (u1, 1.0), (u0, 1.0)],
            )
    add_quad([(x, y, height_m) for x, y in tops], [(0.0, 1.0), (1.0, 1.0), (1.0, 1.0), (0.0, 1.0)])
    add_quad([(x, y, 0.0) for x, y in reversed(corners)], [(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (0.0, 0.0)])
    return Mesh(np.array(vertices), np.array(texcoords), np.array(faces, np.int64)).centred()
