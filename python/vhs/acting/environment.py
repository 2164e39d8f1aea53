"""An environment in the words of its task: what steps it and what learns from it need no others.

Reading and judging happen where the environment is, in a worker where there are workers: what travels is a
frame, two numbers and, at the end of an episode, its outcome.
"""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from vhs.task import Task, TaskSpec


class TaskEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Observations are `frame`, `goal` and `interaction`; actions are numbered from 0.

    `info` is empty until an episode ends; then it holds `outcome`, an `Outcome`, and, for evaluation alone,
    `reached`, the goal class that was reached (-1: none), where the task says it.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], task: Task, spec: TaskSpec) -> None:
        """Wrap an environment of a task."""
        super().__init__(env)
        self._task = task
        self._read = task.reader(env)
        self._first_action = int(getattr(env.action_space, "start", 0))
        dtype = np.dtype(spec.frame_dtype)
        low, high = (0, 255) if dtype == np.uint8 else (-np.inf, np.inf)
        self.observation_space = spaces.Dict(
            {
                "frame": spaces.Box(low, high, spec.frame_shape, dtype.type),
                "goal": spaces.Discrete(spec.num_goals),
                "interaction": spaces.Discrete(max(1, spec.num_interactions)),
            }
        )
        self.action_space = spaces.Discrete(spec.num_actions)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode; the info is empty."""
        observation, _ = self.env.reset(seed=seed, options=options)
        return self._told(observation), {}

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Take a step, and judge it where it was the last."""
        taken = int(action) + self._first_action
        observation, reward, terminated, truncated, info = self.env.step(taken)
        end: dict[str, Any] = {}
        if terminated or truncated:
            end["outcome"] = self._task.judge(float(reward), terminated, truncated, info)
            if self._task.reached is not None:
                end["reached"] = self._task.reached(info)
        return self._told(observation), reward, terminated, truncated, end

    def _told(self, observation: Any) -> dict[str, Any]:
        seen = self._read(observation)
        frame: NDArray[Any] = np.asarray(seen.frame)
        return {
            "frame": frame[..., None] if frame.ndim == 2 else frame,
            "goal": np.int64(seen.label),
            "interaction": np.int64(seen.interaction),
        }
