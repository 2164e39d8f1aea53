"""An environment in the words of its task: what steps it and what learns from it need no others.

Reading and judging happen where the environment is, in a worker where there are workers: what travels is a
frame, two numbers and, at the end of an episode, its outcome.
"""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import DTypeLike, NDArray

from vhs.actions import doer, shown_space
from vhs.task import Task, TaskSpec


class TaskEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Observations are `frame`, `goal` and `interaction`; actions are numbered from 0, or lie in -1..1.

    Where goals are pictures or vectors there is a `desired_goal`, and with vectors an `achieved_goal`. `info`
    is empty until an episode ends; then it holds `outcome`, an `Outcome`, and, for evaluation alone,
    `reached`, the goal class that was reached (-1: none), where the task says it. An episode is truncated
    where a limit cut it off that is no part of the task (`Task.limit_ends`).
    """

    def __init__(self, env: gymnasium.Env[Any, Any], task: Task, spec: TaskSpec) -> None:
        """Wrap an environment of a task."""
        super().__init__(env)
        self._task = task
        self._spec = spec
        self._read = task.reader(env)
        self._doing = doer(env.action_space)
        entries: dict[str, spaces.Space[Any]] = {
            "frame": _box(spec.frame_shape, spec.frame_dtype),
            "goal": spaces.Discrete(spec.num_goals),
            "interaction": spaces.Discrete(max(1, spec.num_interactions)),
        }
        if spec.goals == "observations":
            entries["desired_goal"] = entries["frame"]
        elif spec.goals == "vectors":
            entries["desired_goal"] = entries["achieved_goal"] = _box(spec.goal_shape, spec.goal_dtype)
        self.observation_space = spaces.Dict(entries)
        self.action_space = shown_space(env.action_space)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode; the info is empty."""
        observation, _ = self.env.reset(seed=seed, options=options)
        return self._told(observation), {}

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Take a step, and judge it where it was the last."""
        observation, reward, terminated, truncated, info = self.env.step(self._doing(action))
        end: dict[str, Any] = {}
        if terminated or truncated:
            end["outcome"] = self._task.judge(float(reward), terminated, truncated, info)
            if self._task.reached is not None:
                end["reached"] = self._task.reached(info)
            terminated = terminated or self._task.limit_ends
        return self._told(observation), reward, terminated, truncated and not terminated, end

    def _told(self, observation: Any) -> dict[str, Any]:
        seen, kind = self._read(observation), self._spec.goals
        told = {
            "frame": _frame(seen.frame),
            "goal": np.int64(seen.label),
            "interaction": np.int64(seen.interaction),
        }
        if kind == "observations":
            told["desired_goal"] = _frame(seen.desired_goal)
        elif kind == "vectors":
            for entry in ("desired_goal", "achieved_goal"):
                told[entry] = np.atleast_1d(np.asarray(getattr(seen, entry), self._spec.goal_dtype))
        return told


def _box(shape: tuple[int, ...], dtype: DTypeLike) -> spaces.Box:
    kind = np.dtype(dtype)
    if kind.kind == "f":
        return spaces.Box(-np.inf, np.inf, shape, kind.type)
    limits = np.iinfo(kind)
    return spaces.Box(limits.min, limits.max, shape, kind.type)


def _frame(seen: Any) -> NDArray[Any]:
    """As the spec has it: a number has one axis, a grey picture a channel."""
    frame: NDArray[Any] = np.atleast_1d(np.asarray(seen))
    return frame[..., None] if frame.ndim == 2 else frame
