"""Draws docs/images/raster.png: MuJoCo's renderer, ours, and four times their difference, side by side.

Run with `python benchmarks/raster_contact_sheet.py`; needs Pillow, and OpenGL (EGL unless MUJOCO_GL differs).
"""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from bench_raster import room
from vhs.raster import RasterRenderer

SIZE = 168
TARGET = Path(__file__).parents[1] / "docs/images/raster.png"
MODELS = ("ant", "humanoid", "half_cheetah", "reacher", "pusher_v5")


def row(
    model: mujoco.MjModel, data: mujoco.MjData, camera: object, option: mujoco.MjvOption | None
) -> NDArray[np.uint8]:
    """One state: expected, found, and four times the difference."""
    expected = mujoco.Renderer(model, SIZE, SIZE)
    for _ in range(2):
        expected.update_scene(data, camera, option)
    actual = RasterRenderer(model, SIZE, SIZE, antialias="multisample")
    actual.update_scene(data, camera, option)
    left, right = expected.render(), actual.render()
    expected.close()
    difference = np.abs(left.astype(int) - right)
    return np.concatenate([left, right, np.minimum(4 * difference, 255).astype(np.uint8)], axis=1)


def main() -> None:
    """Draws four states of the room and five models."""
    model, datas, camera, option = room(4)
    model.vis.global_.offwidth = model.vis.global_.offheight = SIZE
    rows = [row(model, data, camera, option) for data in datas[:5]]
    assets = Path(gymnasium.__file__).parent / "envs/mujoco/assets"
    for name in MODELS:
        other = mujoco.MjModel.from_xml_path(str(assets / f"{name}.xml"))
        data = mujoco.MjData(other)
        mujoco.mj_forward(other, data)
        rows.append(row(other, data, -1, None))
    half = len(rows) // 2
    columns = [np.concatenate(part) for part in (rows[:half], rows[half:])]
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(columns, axis=1)).save(TARGET, optimize=True)


if __name__ == "__main__":
    main()
