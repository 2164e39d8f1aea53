"""Environments whose every byte can be checked, and some that misbehave. Importable by spawned processes."""

import gc
import os
import signal
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

SIZE = 20_000
"""Large enough that a torn observation would show."""


def open_descriptors() -> int:
    """How many descriptors this process has open, without those of garbage that earlier tests left."""
    gc.collect()
    return len(os.listdir("/proc/self/fd"))


def length_of(seed: int) -> int:
    """How many steps the episode of a seed has."""
    return 2 + seed % 5


def mark_of(seed: int, step: int) -> int:
    """The byte that fills an observation."""
    return (seed * 31 + step * 7 + 1) % 256


class Ledger(gym.Env):
    """Observations tell their episode's seed and step, and are filled with a byte that follows from both."""

    observation_space = gym.spaces.Dict(
        {
            "seed": gym.spaces.Box(0, 2**63 - 1, (), np.int64),
            "step": gym.spaces.Discrete(1000),
            "bytes": gym.spaces.Box(0, 255, (SIZE,), np.uint8),
        }
    )
    action_space = gym.spaces.Discrete(1000)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        super().reset(seed=seed)
        self.seed = int(self.np_random.integers(2**40)) if seed is None else seed
        self.steps = 0
        return self.observe(), {"options": options} if options else {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        done = self.steps >= length_of(self.seed)
        info = {"last": self.seed} if done else {}
        return self.observe(), float(action), done and self.seed % 2 == 0, done and self.seed % 2 == 1, info

    def observe(self) -> dict[str, Any]:
        mark = mark_of(self.seed, self.steps)
        return {
            "seed": np.int64(self.seed),
            "step": np.int64(self.steps),
            "bytes": np.full(SIZE, mark, np.uint8),
        }

    def double(self, number: int) -> int:
        return 2 * number


class Mortal(Ledger):
    """Answers a question, or dies of it."""

    def answer(self, *, dies: bool) -> str:
        if dies:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.05)
        return "alive"


class OddError(Exception):
    """Pickles but does not unpickle: its constructor wants two arguments."""

    def __init__(self, one: str, two: str) -> None:
        super().__init__(one + two)


class Misbehaved(Ledger):
    """Misbehaves at the second step of every `every`th episode, each environment counting its own.

    The count lies in a file, so that it survives the process.
    """

    def __init__(self, deed: str, folder: Path, every: int = 2) -> None:
        self.deed, self.every = deed, every
        self.file = folder / "episodes"

    def reset(self, **kwargs: Any) -> tuple[Any, Any]:
        with self.file.open("a") as file:
            file.write(".")
        self.is_bad = self.file.stat().st_size % self.every == 0
        return super().reset(**kwargs)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        result = super().step(action)
        if not (self.is_bad and self.steps == 2):
            return result
        if self.deed == "raise":
            raise ZeroDivisionError("a deed")
        if self.deed == "odd":
            raise OddError("a", "b")
        if self.deed == "hang":
            self.hang_for_good()
        if self.deed == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.deed == "nan":
            return result[0], float("nan"), *result[2:]
        return result

    def hang_for_good(self) -> None:
        while True:
            time.sleep(60)


class Floats(gym.Env):
    """Shows a NaN in a float field at the third step of an episode with an odd seed."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (4,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        self.seed, self.steps = seed or 0, 0
        return np.full(4, np.inf, np.float32), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        observation = np.full(4, self.steps, np.float32)
        if self.steps == 3 and self.seed % 2:
            observation[2] = np.nan
        return observation, float(action.sum()), self.steps == 5, False, {}
