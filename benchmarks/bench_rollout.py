"""Time of one environment step through the rollout pool, beside gymnasium, SB3 and the bare minimum.

    python benchmarks/bench_rollout.py [--rounds 5] [--seconds 0.4] [--quick] [--json FILE]

Checks its subject first: every step of every environment must arrive once, in order and whole. The
environment burns CPU time (not wall time: a preempted one burns on) and shows a uint8 (6, 84, 84)
observation. Contenders take turns within a round; each number is the median over rounds, in microseconds of
wall time a step over all environments. The pool runs first-ready (`recv(1)`) where nothing else is said.
Stable-Baselines3 is measured where it is installed.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv

from rollout_floor import RawLoop
from vhs.rollout import RolloutPool

SHAPE = (6, 84, 84)
CORES = len(os.sched_getaffinity(0))

Contender = Callable[[float], float]
"""Seconds to run for -> microseconds a step."""


class Spin(gymnasium.Env[Any, Any]):
    """Burns CPU time and shows the number of its step in every byte."""

    observation_space = gymnasium.spaces.Box(0, 255, SHAPE, np.uint8)
    action_space = gymnasium.spaces.Discrete(4)

    def __init__(self, burn_s: float = 0.0) -> None:
        """Burn this many seconds a step."""
        self.burn_s, self.steps = burn_s, 0
        self.shown = [np.full(SHAPE, mark, np.uint8) for mark in range(4)]

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begin to count."""
        self.steps = 0
        return self.shown[0], {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Burn, count, show."""
        if self.burn_s:
            until = time.thread_time() + self.burn_s
            while time.thread_time() < until:
                pass
        self.steps += 1
        return self.shown[self.steps % 4], 0.0, False, False, {}


def check() -> None:
    """Refuse to time a pool that loses, doubles or tears a step."""
    with RolloutPool(Spin, 3, 2, autoreset="Disabled") as pool:
        pool.reset()
        batch, steps = pool.recv(), np.zeros(6, np.int64)
        pool.send(np.zeros(6, np.int64))
        for _ in range(2000):
            batch = pool.recv(1)
            steps[batch.env_ids] += 1
            assert np.array_equal(batch.steps, steps[batch.env_ids]), "expected every step once, in order"
            shown = batch.observation.reshape(len(batch), -1)
            assert (shown == (batch.steps % 4)[:, None]).all(), "expected whole observations"
            pool.send(np.zeros(len(batch), np.int64), batch.env_ids)


def pool_first_ready(
    workers: int, each: int, burn_s: float, seconds: float, pin: bool | None = None, wanted: int | None = 1
) -> float:
    """The pool, `wanted` answers at a time; None is lock-step."""
    actions = np.zeros(workers * each, np.int64)
    with RolloutPool(partial(Spin, burn_s), workers, each, autoreset="Disabled", pin=pin) as pool:
        pool.reset()
        pool.recv()
        pool.send(actions)

        def step() -> int:
            batch = pool.recv(wanted)
            pool.send(actions[: len(batch)], batch.env_ids)
            return len(batch)

        return measured(step, seconds)


def raw_loop(workers: int, each: int, burn_s: float, seconds: float) -> float:
    """The bare minimum."""
    loop = RawLoop(partial(Spin, burn_s), workers, each, SHAPE)
    try:
        return measured(lambda: loop.run(1), seconds)
    finally:
        loop.close()


def gymnasium_async(workers: int, burn_s: float, seconds: float) -> float:
    """`AsyncVectorEnv` with shared memory."""
    env = AsyncVectorEnv([partial(Spin, burn_s)] * workers)
    actions = np.zeros(workers, np.int64)
    env.reset()
    try:
        return measured(lambda: len(env.step(actions)[1]), seconds)
    finally:
        env.close()


def sb3_subproc(workers: int, burn_s: float, seconds: float) -> float:
    """`SubprocVecEnv`."""
    from stable_baselines3.common.vec_env import SubprocVecEnv

    env = SubprocVecEnv([partial(Spin, burn_s)] * workers, start_method="fork")
    actions = np.zeros(workers, np.int64)
    env.reset()
    try:
        return measured(lambda: len(env.step(actions)[1]), seconds)
    finally:
        env.close()


def measured(step: Callable[[], int], seconds: float) -> float:
    """Microseconds a step: a tenth of the time to warm up, the rest to measure."""
    for share in (0.1, 0.9):
        taken, began_s = 0, time.perf_counter()
        until_s = began_s + share * seconds
        while (now_s := time.perf_counter()) < until_s:
            taken += step()
    return (now_s - began_s) / taken * 1e6


def burn_for_ever() -> None:
    """A foreign process that computes."""
    while True:
        pass


def with_neighbour(contender: Contender, seconds: float) -> float:
    """A contender while a foreign process keeps a core busy."""
    neighbour = multiprocessing.get_context("fork").Process(target=burn_for_ever, daemon=True)
    neighbour.start()
    try:
        return contender(seconds)
    finally:
        neighbour.kill()
        neighbour.join()


def has_sb3() -> bool:
    """Whether Stable-Baselines3 can be imported."""
    try:
        import stable_baselines3  # noqa: F401
    except ImportError:
        return False
    return True


def make_cases() -> dict[str, dict[str, Contender]]:
    """What is measured: rows and their contenders."""
    sb3 = has_sb3()
    cases: dict[str, dict[str, Contender]] = {}
    for workers in (2, 5, 8, 16):
        cases[f"0 us, {workers} workers"] = {
            "pool": partial(pool_first_ready, workers, 1, 0.0),
            "pool lock-step": partial(pool_first_ready, workers, 1, 0.0, wanted=None),
            "raw loop": partial(raw_loop, workers, 1, 0.0),
            "gymnasium": partial(gymnasium_async, workers, 0.0),
        } | ({"sb3": partial(sb3_subproc, workers, 0.0)} if sb3 else {})
    for workers, each in ((2, 8), (2, 32)):
        cases[f"0 us, {workers} workers x {each}"] = {
            "pool": partial(pool_first_ready, workers, each, 0.0),
            "pool lock-step": partial(pool_first_ready, workers, each, 0.0, wanted=None),
            "raw loop": partial(raw_loop, workers, each, 0.0),
        }
    for workers in (2, 5):
        cases[f"0 us, {workers} workers, busy neighbour"] = {
            "pool": partial(with_neighbour, partial(pool_first_ready, workers, 1, 0.0)),
            "pool lock-step": partial(
                with_neighbour, partial(pool_first_ready, workers, 1, 0.0, wanted=None)
            ),
            "raw loop": partial(with_neighbour, partial(raw_loop, workers, 1, 0.0)),
            "gymnasium": partial(with_neighbour, partial(gymnasium_async, workers, 0.0)),
        }
    for burn_us, workers in ((100, 5), (1000, 5), (1000, 2)):
        burn_s = burn_us * 1e-6
        cases[f"{burn_us} us, {workers} workers"] = {
            "pool": partial(pool_first_ready, workers, 1, burn_s),
            "pool unpinned": partial(pool_first_ready, workers, 1, burn_s, pin=False),
            "raw loop": partial(raw_loop, workers, 1, burn_s),
            "gymnasium": partial(gymnasium_async, workers, burn_s),
        } | ({"sb3": partial(sb3_subproc, workers, burn_s)} if sb3 else {})
    return cases


def measure(
    cases: dict[str, dict[str, Contender]], rounds: int, seconds: float
) -> dict[str, dict[str, float]]:
    """Medians over rounds; contenders take turns."""
    samples: dict[str, dict[str, list[float]]] = {case: {} for case in cases}
    for case, contenders in cases.items():
        for _ in range(rounds):
            for name, contender in contenders.items():
                samples[case].setdefault(name, []).append(contender(seconds))
        print(".", end="", flush=True)
    print()
    return {
        case: {name: statistics.median(times) for name, times in row.items()} for case, row in samples.items()
    }


def print_table(table: dict[str, dict[str, float]]) -> None:
    """One row a case; what burns also says how much of the cores' time reached the environments."""
    names = list(dict.fromkeys(name for row in table.values() for name in row))
    print("| us a step | " + " | ".join(names) + " |")
    print("|---" * (len(names) + 1) + "|")
    for case, row in table.items():
        print(f"| {case} | " + " | ".join(_cell(case, row.get(name)) for name in names) + " |")


def _cell(case: str, us: float | None) -> str:
    if us is None:
        return "-"
    burn_us, workers = float(case.split()[0]), int(case.split()[2])
    if burn_us == 0.0:
        return f"{us:.2f}"
    share = burn_us / min(workers, CORES) / us
    return f"{us:.1f} ({100 * share:.0f} %)"


def main() -> None:
    """Check, measure, print, and write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=0.4, help="a contender and round")
    parser.add_argument("--quick", action="store_true", help="one short round, to see that everything runs")
    parser.add_argument("--only", default="", help="cases whose name has this in it")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.rounds, arguments.seconds = 1, 0.02
    check()
    cases = {case: row for case, row in make_cases().items() if arguments.only in case}
    load_before = os.getloadavg()[0]
    table = measure(cases, arguments.rounds, arguments.seconds)
    print_table(table)
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    ).stdout.strip()
    about = {
        "commit": commit,
        "machine": platform.machine(),
        "cores": CORES,
        "python": platform.python_version(),
        "rounds": arguments.rounds,
        "seconds": arguments.seconds,
        "load_before": load_before,
    }
    print(about)
    if arguments.json:
        arguments.json.write_text(json.dumps({"about": about, "us_per_step": table}, indent=1) + "\n")


if __name__ == "__main__":
    main()
