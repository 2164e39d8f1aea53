"""Which models of the packages that people train on are drawn, and how near to OpenGL: one row a package.

Looks for MJCF files in installed packages and in folders, loads each, draws it with `RasterRenderer` and with
`mujoco.Renderer` (shadows and reflections off, 96x96, the free camera) and prints a table. Files that MuJoCo
does not load on their own (parts, templates) are not counted, missing packages are left out. Run with
`python benchmarks/raster_coverage.py [PACKAGE_OR_FOLDER ...]`.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np

from vhs import UnsupportedError
from vhs.raster import RasterRenderer

PACKAGES = (
    "gymnasium", "gymnasium_robotics", "dm_control", "metaworld", "robosuite", "myosuite", "ogbench",
    "mujoco",
)  # fmt: skip
SIZE = 96
"""Height and width of the pictures, in pixels."""


def model_files(package: str) -> Iterator[Path]:
    """MJCF files of a folder or of an installed package."""
    folders = [package] if "/" in package else []
    if not folders and (found := importlib.util.find_spec(package)):
        folders = list(found.submodule_search_locations or ())
    for folder in folders:
        for path in sorted(Path(folder).rglob("*.xml")):
            if b"<mujoco" in path.read_bytes()[:4000]:
                yield path


def load(path: Path) -> mujoco.MjModel | None:
    """The model, or None for a file that is only a part of one."""
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except Exception:  # MuJoCo raises ValueError, its plugins what they like.
        return None


def difference(model: mujoco.MjModel) -> float:
    """Mean difference of colours between the two renderers, in 255ths."""
    model.vis.quality.offsamples = 0
    model.vis.global_.offwidth = model.vis.global_.offheight = 480
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    actual = RasterRenderer(model, SIZE, SIZE)
    expected = mujoco.Renderer(model, SIZE, SIZE)
    try:
        for renderer in (expected, expected, actual):
            if hasattr(renderer, "scene"):
                for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
                    renderer.scene.flags[flag] = False
            renderer.update_scene(data)
        return float(np.abs(expected.render().astype(int) - actual.render()).mean())
    finally:
        expected.close()


def main() -> None:
    """Draws everything and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("packages", nargs="*", default=PACKAGES)
    parser.add_argument("--most", type=int, default=10_000, help="most models of a package")
    arguments = parser.parse_args()
    print(
        "| package | models | drawn | refused | mean difference: median | worst |\n|---|---|---|---|---|---|"
    )
    for package in arguments.packages:
        models = [(path, model) for path in model_files(package) if (model := load(path)) is not None]
        drawn: list[tuple[float, str]] = []
        refused: list[str] = []
        for path, model in models[: arguments.most]:
            try:
                drawn.append((difference(model), path.name))
            except UnsupportedError as error:
                refused.append(f"{path.name}: {error}")
        count = len(drawn) + len(refused)
        if not count:
            continue
        worst = f"{max(drawn)[0]:.2f} ({max(drawn)[1]})" if drawn else "-"
        median = f"{np.median([d for d, _ in drawn]):.2f}" if drawn else "-"
        print(f"| {package} | {count} | {len(drawn)} | {len(refused)} | {median} | {worst} |", flush=True)
        for line in refused:
            print(f"  {line}", flush=True)


if __name__ == "__main__":
    main()
