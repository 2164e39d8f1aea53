"""Steps Memory Maze and OGBench with pictures, without OpenGL and with Mesa's, and lays them side by side.

Each environment is stepped with the same seed and actions in processes of their own: one calls
`vhs.raster.install()` and must load no OpenGL, one draws with MuJoCo's renderer on EGL, one thread of
llvmpipe. Writes docs/images/elsewhere.png (for each environment ours, Mesa's, and four times their
difference) and beside it elsewhere.json: versions, differences, processor time of a step and of its picture.
Run with `python benchmarks/raster_elsewhere.py` in an environment of its own: `pip install dm_control ogbench
gym pillow 'numpy<2'`, the MuJoCo that dm_control asks for, and `pip install --no-deps memory-maze`.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

STEPS = 80
SHOWN = (0, 20, 40, 79)
MOST_DIFFERENCE = 4.0
KINDS = ("raster", "mesa", "none")
"""What draws the pictures; nothing, to know what a step takes without them."""
TARGET = Path(__file__).parents[1] / "docs/images/elsewhere.png"


def memory_maze() -> Iterator[np.ndarray]:
    """Pictures of Memory Maze 9x9 under random actions, uint8 [64, 64, 3]."""
    from memory_maze import tasks

    env, rng = tasks.memory_maze_9x9(seed=0), np.random.default_rng(0)
    env.reset()
    while True:
        seen = env.step(int(rng.integers(env.action_spec().num_values))).observation
        yield seen["image"] if isinstance(seen, dict) else seen


def ogbench(name: str) -> Callable[[], Iterator[np.ndarray]]:
    """The same for an environment of OGBench."""

    def pictures() -> Iterator[np.ndarray]:
        import gymnasium
        import ogbench  # noqa: F401  registers its environments

        env, rng = gymnasium.make(name), np.random.default_rng(0)
        np.random.seed(0)  # noqa: NPY002  OGBench draws from it, whatever seed it is given
        env.reset(seed=0)
        while True:
            yield env.step(rng.uniform(-1, 1, env.action_space.shape))[0]

    return pictures


ENVIRONMENTS = {
    "Memory Maze 9x9": memory_maze,
    "visual-cube-single-v0": ogbench("visual-cube-single-v0"),
    "visual-antmaze-medium-v0": ogbench("visual-antmaze-medium-v0"),
}


def step(name: str, kind: str, out: Path) -> None:
    """Steps one environment in this process; writes pictures and the median processor time of a step."""
    if kind != "mesa":
        import vhs.raster
        from vhs.raster.context import SoftwareContext

        vhs.raster.install()
    if kind == "none":
        SoftwareContext.render = SoftwareContext.read = lambda *arguments: None
    pictures, seen, times = ENVIRONMENTS[name](), [], []
    for _ in range(STEPS):
        start = time.process_time()
        picture = next(pictures)
        times.append(time.process_time() - start)
        seen.append(picture.copy())
    maps = Path("/proc/self/maps")
    loaded = maps.read_text() if kind != "mesa" and maps.exists() else ""
    if any(library in loaded for library in ("libEGL", "libOSMesa", "libGLX")):
        raise SystemExit(f"{name}: OpenGL was loaded")
    np.savez(out, pictures=np.stack([seen[i] for i in SHOWN]), seconds=np.median(times[1:]))


def run(name: str, kind: str) -> tuple[np.ndarray, float]:
    """Pictures and seconds a step, from a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.npz"
        environment = {**os.environ, "LP_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        environment.pop("MUJOCO_GL", None)
        if kind == "mesa":
            environment["MUJOCO_GL"] = "egl"
        options = ["--step", name, "--out", str(out), "--kind", kind]
        subprocess.run([sys.executable, __file__, *options], env=environment, check=True)
        with np.load(out) as found:
            return found["pictures"], float(found["seconds"])


def compare(name: str, rounds: int) -> tuple[np.ndarray, dict[str, object]]:
    """One row of the picture, and its numbers."""
    runs = [[run(name, kind) for kind in KINDS] for _ in range(rounds)]
    (ours, _), (theirs, _), _ = runs[0]
    difference = np.abs(ours.astype(int) - theirs)
    if difference.mean() > MOST_DIFFERENCE:
        raise SystemExit(f"{name}: the pictures differ by {difference.mean():.2f}/255")
    ours_s, theirs_s, rest_s = (min(found[i][1] for found in runs) for i in range(3))
    rows = [ours, theirs, np.minimum(4 * difference, 255).astype(np.uint8)]
    numbers = {
        "environment": name,
        "size": list(ours.shape[1:3]),
        "mean_difference": round(float(difference.mean()), 3),
        "step_without_picture_ms": round(1e3 * rest_s, 3),
        "raster_picture_ms": round(1e3 * (ours_s - rest_s), 3),
        "mesa_picture_ms": round(1e3 * (theirs_s - rest_s), 3),
        "raster_steps_per_s": round(1 / ours_s),
        "mesa_steps_per_s": round(1 / theirs_s),
    }
    return np.concatenate([np.concatenate(row, axis=1) for row in rows]), numbers


def main() -> None:
    """Compares all environments and writes the picture and its numbers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--rounds", type=int, default=3, help="runs with each renderer, in turns; the fastest counts"
    )
    parser.add_argument("--step", help="environment to step in this process")
    parser.add_argument("--kind", choices=KINDS, help="what draws there")
    parser.add_argument("--out", type=Path, help="where that process writes")
    arguments = parser.parse_args()
    if arguments.step:
        step(arguments.step, arguments.kind, arguments.out)
        return
    from PIL import Image

    rows, panels = [], []
    for name in ENVIRONMENTS:
        panel, numbers = compare(name, arguments.rounds)
        print(numbers, flush=True)
        rows.append(numbers)
        panels.append(panel)
    Image.fromarray(np.concatenate(panels, axis=1)).save(TARGET, optimize=True)
    packages = ("mujoco", "dm_control", "memory-maze", "ogbench", "numpy")
    provenance = {
        "made_by": "benchmarks/raster_elsewhere.py",
        "rows_of_the_picture": ["RasterRenderer", "mujoco.Renderer on EGL", "4 times their difference"],
        "steps_shown": list(SHOWN),
        "rounds": arguments.rounds,
        "machine": f"{platform.machine()}, {os.cpu_count()} processors",
        "python": platform.python_version(),
        "packages": {name: importlib.metadata.version(name) for name in packages},
        "environments": rows,
    }
    TARGET.with_suffix(".json").write_text(json.dumps(provenance, indent=2) + "\n")


if __name__ == "__main__":
    main()
