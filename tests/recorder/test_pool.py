"""What a pool's workers step arrives in a buffer whole, as `examples/rollout_to_buffer.py` has it."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import vhs

from .examples import load


class Ledger(gymnasium.Env[dict[str, Any], np.int64]):
    """Shows a number of its episode and the step, and pays the action; one process dies in a step, once."""

    observation_space = spaces.Dict(image=spaces.Box(0, 255, (2,), np.uint8), goal=spaces.Discrete(3))
    action_space = spaces.Discrete(4)

    def __init__(self, death: Path) -> None:
        self.death = death

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.number, self.time = int(self.np_random.integers(200)), 0
        return self._seen(), {}

    def step(self, action: Any) -> Any:
        self.time += 1
        if self.time == 2 and self.number % 4 == 3 and not self.death.exists():
            self.death.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        is_end = self.time == 1 + self.number % 4
        return self._seen(), float(action), is_end, False, {"is_success": self.number % 2 == 0}

    def _seen(self) -> dict[str, Any]:
        return {"image": np.array([self.number, self.time], np.uint8), "goal": self.number % 3}


def test_what_workers_step_is_recorded_whole(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="the example plays in the rooms, which need vhs[env]")
    example, death = load("rollout_to_buffer"), tmp_path / "death"
    buffer = example.collect(lambda: Ledger(death), 60, capacity_steps=1000, max_episode_steps=4)
    assert death.exists()
    assert len(buffer) >= 60
    for id in buffer.ids.tolist():
        batch = buffer.gather([id])
        number, length = int(batch.observations[0, 0, 0]), int(batch.lengths[0])
        assert batch.observations[:, 0].tolist() == [[number, time] for time in range(length + 1)]
        assert length == 1 + number % 4
        assert batch.rewards.tolist() == batch.actions.tolist()
        assert (batch.goals[0], batch.terminated[0]) == (number % 3, True)
        assert batch.outcomes[0] == (vhs.Outcome.FAILURE if number % 2 else vhs.Outcome.SUCCESS)
