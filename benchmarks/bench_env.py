"""Time of one environment step in one process, split into physics, drawing and the rest.

    python benchmarks/bench_env.py [--renderer raster] [--steps 2000] [--json FILE]

Checks its subject first: the oracle must solve episodes with images on, and the same seed must give the same
bytes. Each number is the median over rounds, in microseconds of wall time; run it on an idle machine.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from vhs.envs import RoomEnv, plan
from vhs.envs.config import INTERACTIVE_OBJECT_NAV
from vhs.envs.rendering import first_person_source

TARGETS_US = {"physics": 100.0, "step": 250.0}
"""What the design asks for."""
ROUNDS = 7


def check(env: RoomEnv) -> None:
    """Refuse to time an environment that is wrong."""
    for seed in range(20):
        first, _ = env.reset(seed=seed)
        assert first["image"].std() > 5, "expected a picture, found one flat colour"
        info: dict[str, Any] = {}
        for action in plan(env):
            *_, info = env.step(action)
        assert info["outcome"] == "success", f"seed {seed}: expected the oracle to succeed, found {info}"
        again, _ = env.reset(seed=seed)
        assert first["image"].tobytes() == again["image"].tobytes(), f"seed {seed}: expected the same image"


def run_episodes(env: RoomEnv, actions: list[int]) -> float:
    """Seconds spent in `step` alone, episodes restarted untimed."""
    spent_s = 0.0
    env.reset()
    for action in actions:
        started_s = time.perf_counter()
        *_, terminated, truncated, _ = env.step(action)
        spent_s += time.perf_counter() - started_s
        if terminated or truncated:
            env.reset()
    return spent_s


def timed(work: Callable[[], object], times: int) -> float:
    """Seconds for calling `work` so often."""
    started_s = time.perf_counter()
    for _ in range(times):
        work()
    return time.perf_counter() - started_s


def measure(env: RoomEnv, steps: int, seed: int) -> dict[str, float]:
    """Microseconds by part: the median over rounds."""
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    source = first_person_source(env.renderer, env.world.model, env.config.image_px)
    image = np.empty((env.config.image_px, env.config.image_px, 3), np.uint8)
    rounds: dict[str, list[float]] = {"physics": [], "draw": [], "step": [], "reset": []}
    for _ in range(ROUNDS):
        actions = rng.integers(env.task.num_actions, size=steps).tolist()
        moves = iter(actions)
        rounds["physics"].append(timed(lambda moves=moves: env.world.move(next(moves)), steps))
        rounds["draw"].append(timed(lambda: source.render(env.world.data, image), steps))
        rounds["step"].append(run_episodes(env, actions))
        rounds["reset"].append(timed(env.reset, max(1, steps // 10)) * steps / max(1, steps // 10))
    medians = {name: statistics.median(spent) / steps * 1e6 for name, spent in rounds.items()}
    return {**medians, "python": medians["step"] - medians["physics"] - medians["draw"]}


def commit() -> str:
    """The commit that was timed, or "unknown" outside of a checkout."""
    result = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    return result.stdout.strip() or "unknown"


def main() -> None:
    """Check, measure, print, and write JSON if asked to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--renderer", default="raster", help="what draws the observations")
    parser.add_argument("--steps", type=int, default=2000, help="steps a round")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="also write the numbers here")
    arguments = parser.parse_args()

    env = RoomEnv(INTERACTIVE_OBJECT_NAV, renderer=arguments.renderer)
    if arguments.renderer != "none":
        check(env)
    numbers = measure(env, arguments.steps, arguments.seed)

    print(f"{'part of a step':<28}{'us':>8}{'target':>9}")
    for name in ("physics", "draw", "python", "step", "reset"):
        target = f"{TARGETS_US[name]:.0f}" if name in TARGETS_US else "-"
        print(f"{name:<28}{numbers[name]:>8.1f}{target:>9}")
    print(f"{1e6 / numbers['step']:.0f} steps/s on one core, renderer {arguments.renderer}")
    if arguments.json is not None:
        record = {
            "benchmark": "env",
            "renderer": arguments.renderer,
            "microseconds": numbers,
            "steps": arguments.steps,
            "rounds": ROUNDS,
            "commit": commit(),
            "machine": {
                "processor": platform.machine(),
                "cores": os.cpu_count(),
                "python": platform.python_version(),
            },
        }
        arguments.json.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
