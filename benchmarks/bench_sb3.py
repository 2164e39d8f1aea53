"""Our replay buffer beside `HerReplayBuffer` under stable-baselines3: image goals, as its algorithms use it.

    python benchmarks/bench_sb3.py [--steps 2000] [--rounds 15] [--quick] [--json FILE]

Both get the same steps of 3x84x84 pictures through `add`, and draw batches of 256 through `sample`, four of
five rows relabelled and rewarded by the environment's `compute_reward`. Checks first that either's rewards
follow its goals. They take turns; numbers are medians, in microseconds a step and milliseconds a batch, and
megabytes of observations.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.vec_env import DummyVecEnv

from vhs.adapters.sb3 import HindsightBuffer

SHAPE, LENGTH, BATCH = (3, 84, 84), 50, 256


class Pictures(gymnasium.Env[Any, Any]):
    """What the buffers ask of an environment: its spaces and its reward."""

    picture = spaces.Box(0, 255, SHAPE, np.uint8)
    observation_space = spaces.Dict(observation=picture, achieved_goal=picture, desired_goal=picture)
    action_space = spaces.Discrete(4)

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
        """0 where both are equal, -1 elsewhere."""
        return (achieved == desired).all((-1, -2, -3)).astype(np.float32) - 1


def fill(buffers: list[Any], steps: int) -> list[float]:
    """Microseconds a step of each, which get the same steps."""
    rng, times = np.random.default_rng(0), [[] for _ in buffers]

    def picture() -> Any:
        return rng.integers(0, 256, (1, *SHAPE)).astype(np.uint8)

    goal, here = picture(), picture()
    for step in range(steps):
        there, done = picture(), np.array([step % LENGTH == LENGTH - 1])
        before, after = (
            {"observation": shown, "achieved_goal": shown, "desired_goal": goal} for shown in (here, there)
        )
        for buffer, taken in zip(buffers, times, strict=True):
            start = time.perf_counter()
            buffer.add(
                before, after, np.zeros(1, int), np.full(1, -1.0), done, [{"TimeLimit.truncated": True}]
            )
            taken.append(time.perf_counter() - start)
        here = picture() if done[0] else there
    return [1e6 * statistics.median(taken) for taken in times]


def check(buffer: Any) -> None:
    """Rewards are 0 exactly where the goal of the row is reached; there are such rows."""
    data = buffer.sample(BATCH)
    reached = (data.next_observations["achieved_goal"] == data.observations["desired_goal"]).flatten(1).all(1)
    assert torch.equal(data.rewards[:, 0], reached.float() - 1)
    assert reached.any()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    steps, rounds = (200, 2) if given.quick else (given.steps, given.rounds)
    torch.set_num_threads(1)
    env = DummyVecEnv([Pictures])
    arguments = (steps, env.observation_space, env.action_space, env)
    ours = HindsightBuffer(*arguments, device="cpu", max_episode_steps=LENGTH, goals="observations", seed=0)
    theirs = HerReplayBuffer(*arguments, device="cpu")
    names, buffers = ("HindsightBuffer", "HerReplayBuffer"), [ours, theirs]
    added = fill(buffers, steps)
    drawn: list[list[float]] = [[], []]
    for buffer in buffers:
        check(buffer)
    for _ in range(rounds):
        for buffer, taken in zip(buffers, drawn, strict=True):
            start = time.perf_counter()
            buffer.sample(BATCH)
            taken.append(time.perf_counter() - start)
    arrays = [*theirs.observations.values(), *theirs.next_observations.values()]
    stored = [ours.episodes.nbytes / 1e6, sum(array.nbytes for array in arrays) / 1e6]
    rows = {
        name: {
            "add_us": added[place],
            "sample_ms": 1e3 * statistics.median(drawn[place]),
            "mb": stored[place],
        }
        for place, name in enumerate(names)
    }
    for name, row in rows.items():
        print(
            f"{name:16} add {row['add_us']:6.0f} us  sample {row['sample_ms']:6.1f} ms  {row['mb']:6.0f} MB"
        )
    if given.json:
        given.json.write_text(json.dumps(rows))


if __name__ == "__main__":
    main()
