"""An environment in the words of its task: what steps it and what learns from it need no others.

Reading and judging happen where the environment is, in a worker where there are workers: what travels is a
frame, two numbers and, at the end of an episode, its outcome. Whatever a task answers is checked here, so
that an error names the field of the `Task` that it comes from.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from vhs._core import ArgumentError
from vhs.asking import asking
from vhs.task import Outcome, Seen, Task, TaskSpec, default_outcome


class TaskEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Observations are `frame`, `goal` and `interaction`; actions are numbered from 0.

    `info` is empty until an episode ends; then it holds `outcome`, an `Outcome`, and, for evaluation alone,
    `reached`, the goal class that was reached (-1: none), and `metrics`, numbers by name, where the task says
    them. The reward is the task's own where it has one. An episode is truncated at the task's longest.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], task: Task, spec: TaskSpec) -> None:
        """Wrap an environment of a task."""
        super().__init__(env)
        self._task, self._spec = task, spec
        self._steps = 0
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
        self._steps = 0
        return self._told(observation), {}

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Take a step, and judge it where it was the last."""
        taken = int(action) + self._first_action
        observation, reward, terminated, truncated, info = self.env.step(taken)
        self._steps += 1
        truncated = truncated or (self._steps >= self._spec.max_episode_steps and not terminated)
        is_over = terminated or truncated
        end = self._end(float(reward), bool(terminated), bool(truncated), info) if is_over else {}
        if self._task.reward is not None:
            reward = self._task.reward.of(end.get("outcome"))
        return self._told(observation), reward, terminated, truncated, end

    def _end(self, reward: float, terminated: bool, truncated: bool, info: dict[str, Any]) -> dict[str, Any]:
        """What is said of an episode by its last step."""
        task = self._task
        with asking(self._task.name, "judge"):
            outcome = task.judge(reward, terminated, truncated, info)
            if outcome is None:
                outcome = default_outcome(reward, terminated, truncated, info)
            if not isinstance(outcome, Outcome):
                raise ArgumentError(f"expected an Outcome, got {outcome!r}")
        end: dict[str, Any] = {"outcome": outcome}
        if task.reached is not None:
            with asking(self._task.name, "reached"):
                end["reached"] = _within(task.reached(info), -1, self._spec.num_goals)
        if task.metrics:
            with asking(self._task.name, "metrics"):
                end["metrics"] = {name: _number(info, name) for name in task.metrics}
        return end

    def _told(self, observation: Any) -> dict[str, Any]:
        spec = self._spec
        with asking(self._task.name, "read"):
            seen = self._read(observation)
            if not isinstance(seen, Seen):
                raise ArgumentError(f"expected a vhs.Seen, got {type(seen).__name__}")
            frame = _frame(seen.frame)
            if frame.shape != spec.frame_shape or frame.dtype != spec.frame_dtype:
                raise ArgumentError(
                    f"expected frames {np.dtype(spec.frame_dtype)} {list(spec.frame_shape)} as the first, "
                    f"got {frame.dtype} {list(frame.shape)}"
                )
        with asking(self._task.name, "goals"):
            label = _within(seen.label, 0, spec.num_goals)
        with asking(self._task.name, "interactions"):
            interaction = _within(seen.interaction, 0, max(1, spec.num_interactions))
        return {"frame": frame, "goal": np.int64(label), "interaction": np.int64(interaction)}


def _frame(seen: Any) -> NDArray[Any]:
    """As the spec has it: a grey picture has a channel, and truth is a number."""
    frame: NDArray[Any] = np.atleast_1d(np.asarray(seen))
    frame = frame[..., None] if frame.ndim == 2 else frame
    return frame.view(np.uint8) if frame.dtype == np.bool_ else frame


def _within(number: Any, low: int, limit: int) -> int:
    if not low <= int(number) < limit:
        raise ArgumentError(f"expected a number in {low}..{limit - 1}, got {number}")
    return int(number)


def _number(info: Mapping[str, Any], name: str) -> float:
    if name not in info:
        raise ArgumentError(f"expected {name} in the last info, got {', '.join(info) or 'none'}")
    return float(info[name])
