"""Frames per second of `RasterRenderer` beside `mujoco.Renderer`, one at a time and many at once.

Both draw the same states with shadows and reflections off, in turns, in one process and one thread; the
pictures are compared before anything is timed. `render_batch` draws the same pictures on one thread and on
several; they have to be equal. OpenGL is EGL unless MUJOCO_GL says otherwise. Run with
`python benchmarks/bench_raster.py [--json FILE] [--quick]`.
"""

from __future__ import annotations

import argparse
import copy
import json
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

import gymnasium
import mujoco
import numpy as np

import vhs.envs
from vhs.envs.robot import CAMERA, COLLISION_GROUP, ROBOT_GROUP
from vhs.raster import RasterRenderer

STATES = 24
"""Different states drawn in turn, so that neither renderer profits from a warm one."""
MOST_DIFFERENCE = 4.0
"""Mean difference of colours, in 255ths, above which timing means nothing."""
SIZES = (64, 84, 128, 256)

Scene = tuple[mujoco.MjModel, list[mujoco.MjData], object, mujoco.MjvOption]


def room(samples: int) -> Scene:
    """The room as the robot sees it, with as many samples a pixel for OpenGL."""
    vhs.envs.register_envs()
    env = gymnasium.make("vhs/MultiInteractionObjNav-v0", renderer="none").unwrapped
    rng, datas = np.random.default_rng(0), []
    for seed in range(STATES):
        env.reset(seed=seed)
        for _ in range(rng.integers(0, 6)):
            env.step(int(rng.integers(0, 3)))
        datas.append(copy.copy(env.world.data))
    option = mujoco.MjvOption()
    option.geomgroup[:] = [group not in (COLLISION_GROUP, ROBOT_GROUP) for group in range(6)]
    model = copy.copy(env.world.model)
    model.vis.quality.offsamples = samples
    return model, datas, CAMERA, option


def humanoid() -> Scene:
    """Gymnasium's humanoid in random postures."""
    path = Path(gymnasium.__file__).parent / "envs/mujoco/assets/humanoid.xml"
    model = mujoco.MjModel.from_xml_path(str(path))
    rng, datas = np.random.default_rng(0), []
    for _ in range(STATES):
        data = mujoco.MjData(model)
        data.qpos += rng.normal(0, 0.1, model.nq)
        mujoco.mj_forward(model, data)
        datas.append(data)
    return model, datas, "track", mujoco.MjvOption()


SCENES: dict[str, tuple[Callable[[], Scene], str]] = {
    "room": (lambda: room(0), "off"),
    "room, smooth edges": (lambda: room(4), "multisample"),
    "room, 2x2 samples": (lambda: room(4), "supersample"),
    "humanoid, smooth edges": (humanoid, "multisample"),
}
"""Maker of each scene, and how `RasterRenderer` smooths edges to match it."""


def frame_times(renderer: object, scene: Scene, out: np.ndarray, rounds: int) -> np.ndarray:
    """Seconds of each update and picture."""
    _, datas, camera, option = scene
    times = []
    for _ in range(rounds):
        for data in datas:
            start = time.perf_counter()
            renderer.update_scene(data, camera, option)
            renderer.render(out=out)
            times.append(time.perf_counter() - start)
    return np.array(times)


def difference(expected: object, actual: object, scene: Scene) -> float:
    """Worst mean difference of colours over the states, in 255ths."""
    _, datas, camera, option = scene
    worst = 0.0
    for data in datas:
        # MuJoCo places endless planes by the camera of the update before.
        for _ in range(2):
            expected.update_scene(data, camera, option)
        actual.update_scene(data, camera, option)
        worst = max(worst, float(np.abs(expected.render().astype(int) - actual.render()).mean()))
    return worst


def measure(name: str, size: int, rounds: int) -> dict[str, object]:
    """Times one scene at one size, the two renderers in turns."""
    maker, antialias = SCENES[name]
    scene = maker()
    scene[0].vis.global_.offwidth = scene[0].vis.global_.offheight = max(size, 480)
    expected = mujoco.Renderer(scene[0], size, size)
    actual = RasterRenderer(scene[0], size, size, antialias=antialias)
    for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        expected.scene.flags[flag] = actual.scene.flags[flag] = False
    worst = difference(expected, actual, scene)
    # Supersampling smooths textures on purpose; all else has to be the same picture.
    if antialias != "supersample" and worst > MOST_DIFFERENCE:
        raise SystemExit(
            f"{name} at {size}: the pictures differ by {worst:.2f}/255, more than {MOST_DIFFERENCE}"
        )
    out = np.empty((size, size, 3), np.uint8)
    ours, theirs = [], []
    for _ in range(rounds):
        ours.append(frame_times(actual, scene, out, 4))
        theirs.append(frame_times(expected, scene, out, 1))
    expected.close()
    median_us, reference_us = (1e6 * float(np.median(np.concatenate(t))) for t in (ours, theirs))
    return {
        "scene": name,
        "size": size,
        "raster_us": round(median_us, 1),
        "raster_fastest_us": round(1e6 * float(np.min(ours)), 1),
        "raster_frames_per_s": round(1e6 / median_us),
        "mujoco_us": round(reference_us, 1),
        "mujoco_fastest_us": round(1e6 * float(np.min(theirs)), 1),
        "ratio": round(reference_us / median_us, 2),
        "difference": round(worst, 2),
    }


def batch(name: str, size: int, rounds: int) -> dict[str, object]:
    """Times `render_batch` on one thread and on one for each processor, in turns.

    The batches are short, and the fastest count: where other processes keep the processors busy, a batch now
    and then has them for itself. `cpu_factor` is how much more processor time the pictures take on several
    threads, which no load changes.
    """
    (model, datas, camera, option), antialias = SCENES[name][0](), SCENES[name][1]
    renderer = RasterRenderer(model, size, size, antialias=antialias)
    for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        renderer.scene.flags[flag] = False
    datas, counts = 2 * datas, (1, len(os.sched_getaffinity(0)))
    pictures = [renderer.render_batch(datas, camera, option, threads=count) for count in counts]
    if not np.array_equal(*pictures):
        raise SystemExit(f"{name} at {size}: pictures depend on the number of threads")
    wall: list[list[float]] = [[], []]
    cpu: list[list[float]] = [[], []]
    for _ in range(rounds):
        for i, count in enumerate(counts):
            start, used = time.perf_counter(), time.process_time()
            renderer.render_batch(datas, camera, option, pictures[i], threads=count)
            wall[i].append((time.perf_counter() - start) / len(datas))
            cpu[i].append((time.process_time() - used) / len(datas))
    return {
        "scene": name,
        "size": size,
        "threads": counts[1],
        "one_us": round(1e6 * min(wall[0]), 1),
        "all_us": round(1e6 * min(wall[1]), 1),
        "speed_up": round(min(wall[0]) / min(wall[1]), 2),
        "cpu_factor": round(float(np.median(cpu[1]) / np.median(cpu[0])), 2),
    }


def print_row(row: dict[str, object]) -> None:
    """Prints numbers in columns under their names."""
    print(f"{row['scene']:22}", *(f"{row[column]:>17}" for column in list(row)[1:]), flush=True)


def main() -> None:
    """Measures, prints a table and writes JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="where to write the numbers")
    parser.add_argument(
        "--quick", action="store_true", help="one size and few frames: checks that this still runs"
    )
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    for kind, sizes in ((measure, SIZES), (batch, (84, 256))):
        for name in SCENES:
            for size in (84,) if arguments.quick else sizes:
                rounds = {measure: 6, batch: 200}[kind]
                row = kind(name, size, rounds=1 if arguments.quick else rounds)
                if not rows or list(row) != list(rows[-1]):
                    print_row({column: column for column in row})
                print_row(row)
                rows.append(row)
    if arguments.json:
        arguments.json.write_text(
            json.dumps({"machine": platform.processor(), "rows": rows}, indent=2) + "\n"
        )


if __name__ == "__main__":
    main()
