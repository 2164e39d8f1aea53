"""What a prioritised draw costs, and new priorities, beside the same in other libraries.

Every buffer holds as many steps, in episodes of 20, of frames of 64 bytes, so that the way to a step counts
and not its copy; each draws 64 and gives them new priorities, in turns, so that all meet the same machine.
Ours draws with goals in hindsight and sums of three steps too, which the rivals do not.

    python benchmarks/bench_priorities.py                  # of 10^6 steps
    python benchmarks/bench_priorities.py --json out.json  # and the numbers as JSON
    python benchmarks/bench_priorities.py --quick          # a smoke test: of 10^4, few repeats
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

import vhs

FRAME, EPISODE, BATCH, ALPHA, BETA = (64,), 20, 64, 0.6, 0.4
RNG = np.random.default_rng(0)


class Case(NamedTuple):
    """A draw, which returns what its update needs, and that update."""

    name: str
    draw: Callable[[], object]
    update: Callable[[object], None]


def errors() -> np.ndarray:
    """Priorities of a batch, none of them 0."""
    return RNG.random(BATCH).astype(np.float32) + 0.01


def of_vhs(steps: int) -> list[Case]:
    """Our own, plain and with all that it can do in the same call."""
    buffer = vhs.EpisodeBuffer(
        FRAME,
        num_streams=1,
        max_episode_steps=EPISODE,
        capacity_steps=steps,
        frame_stack=1,
        priority_exponent=ALPHA,
    )
    frames = RNG.integers(0, 256, (997, *FRAME), dtype=np.uint8)
    for number in range(0, steps, EPISODE):
        buffer.begin(0, frames[number % 997])
        for step in range(EPISODE):
            buffer.append(0, 0, -1.0, None, frames[(number + step) % 997])
        buffer.finish(0, "failure")

    def update(batch: object) -> None:
        assert isinstance(batch, vhs.TransitionBatch)
        buffer.update_priorities(batch.ids, batch.steps, errors())

    def all_at_once() -> object:
        return buffer.sample_transitions(BATCH, "future", ratio=4, beta=BETA, n_step=3, gamma=0.99)

    last = buffer.ids[-1:]
    buffer.update_priorities(last, [3], [1e30])
    favourite = buffer.sample_transitions(BATCH, beta=BETA)
    assert (favourite.ids == last).all()
    assert (favourite.steps == 3).all()
    buffer.update_priorities(last, [3], [1.0])
    return [
        Case("vhs", lambda: buffer.sample_transitions(BATCH, beta=BETA), update),
        Case("vhs, hindsight and three steps", all_at_once, update),
        Case("vhs, all equally likely", lambda: buffer.sample_transitions(BATCH), lambda _: None),
    ]


def of_cpprb(steps: int) -> list[Case]:
    """`PrioritizedReplayBuffer`, which takes its priorities by index."""
    try:
        from cpprb import PrioritizedReplayBuffer
    except ImportError:
        return []
    seen = {"shape": FRAME, "dtype": np.uint8}
    buffer = PrioritizedReplayBuffer(
        steps, {"obs": seen, "act": {}, "rew": {}, "next_obs": seen, "done": {}}, alpha=ALPHA
    )
    frames = RNG.integers(0, 256, (1000, *FRAME), dtype=np.uint8)
    ones = np.ones(1000)
    for _ in range(0, steps, 1000):
        buffer.add(obs=frames, act=ones, rew=ones, next_obs=frames, done=ones)

    def update(batch: object) -> None:
        assert isinstance(batch, dict)
        buffer.update_priorities(batch["indexes"], errors())

    return [Case("cpprb", lambda: buffer.sample(BATCH, beta=BETA), update)]


def of_torchrl(steps: int) -> list[Case]:
    """`TensorDictPrioritizedReplayBuffer`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import torch
            from tensordict import TensorDict
            from torchrl.data import LazyTensorStorage, TensorDictPrioritizedReplayBuffer
    except ImportError:
        return []
    buffer = TensorDictPrioritizedReplayBuffer(
        alpha=ALPHA, beta=BETA, storage=LazyTensorStorage(steps), batch_size=BATCH
    )
    frames = torch.from_numpy(RNG.integers(0, 256, (1000, *FRAME), dtype=np.uint8))
    parts = {"observation": frames, "next": {"observation": frames}, "action": torch.zeros(1000)}
    for _ in range(0, steps, 1000):
        buffer.extend(TensorDict(parts, batch_size=[1000]))

    def update(batch: object) -> None:
        assert isinstance(batch, TensorDict)
        buffer.update_priority(batch["index"], torch.from_numpy(errors()))

    return [Case("TorchRL", buffer.sample, update)]


def measure(cases: list[Case], repeats: int) -> dict[str, tuple[float, float]]:
    """The best microseconds of a draw and an update of each, in turns."""
    best = {case.name: (float("inf"), float("inf")) for case in cases}
    for _ in range(repeats):
        for name, draw, update in cases:
            start = time.perf_counter()
            batch = draw()
            middle = time.perf_counter()
            update(batch)
            end = time.perf_counter()
            best[name] = min(best[name][0], middle - start), min(best[name][1], end - middle)
    return {name: (draw * 1e6, update * 1e6) for name, (draw, update) in best.items()}


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    steps, repeats = (10_000, 5) if options.quick else (1_000_000, 500)
    results = measure([*of_vhs(steps), *of_cpprb(steps), *of_torchrl(steps)], repeats)
    print(f"{steps} steps, batches of {BATCH}: best of {repeats}, microseconds")
    for name, (draw, update) in results.items():
        print(f"{name:<32} draw {draw:8.1f}  update {update:8.1f}")
    if options.json:
        options.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
