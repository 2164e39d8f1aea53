"""An environment in the words of its task: what steps it and what learns from it need no others.

Reading and judging happen where the environment is, in a worker where there are workers: what travels is a
frame, two numbers and, at the end of an episode, its outcome. Whatever a task answers is checked here, so
that an error names the field of the `Task` that it comes from.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import DTypeLike, NDArray

from vhs._core import ArgumentError
from vhs.actions import doer, shown_space
from vhs.asking import asking
from vhs.task import Outcome, Seen, Task, TaskSpec, default_outcome


class TaskEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Observations are `frame`, `goal` and `interaction`; actions are numbered from 0, or lie in -1..1.

    Where goals are pictures or vectors there is a `desired_goal`, and with vectors an `achieved_goal`; what a
    task reads beside the frame is in `fields`.

    `info` is empty until an episode ends. Then it holds `outcome`, an `Outcome`; where the task says it,
    `touched`, the number of steps until something was last reached (0: nothing was); and, for evaluation
    alone, `reached`, the goal class that was reached (-1: none), and `metrics`, numbers by name.

    The reward is the task's own where it has one. An episode ends at the task's longest; it is truncated
    where a limit cut it off that is no part of the task (`Task.limit_ends`).
    """

    def __init__(self, env: gymnasium.Env[Any, Any], task: Task, spec: TaskSpec) -> None:
        """Wrap an environment of a task."""
        super().__init__(env)
        self._task, self._spec = task, spec
        self._steps = self._touched = 0
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
        if spec.fields:
            boxes: dict[str, spaces.Space[Any]] = {
                name: _box(field.shape, field.dtype) for name, field in spec.fields.items()
            }
            entries["fields"] = spaces.Dict(boxes)
        self.observation_space = spaces.Dict(entries)
        self.action_space = shown_space(env.action_space)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode; the info is empty."""
        observation, _ = self.env.reset(seed=seed, options=options)
        self._steps = self._touched = 0
        return self._told(observation), {}

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Take a step, and judge it where it was the last."""
        observation, reward, terminated, truncated, info = self.env.step(self._doing(action))
        self._steps += 1
        if not math.isfinite(float(reward)):
            raise ArgumentError(f"{self._task.name}: expected a finite reward, got {reward}")
        if self._task.touched is not None:
            with asking(self._task.name, "touched"):
                self._touched = self._steps if self._task.touched(info) else self._touched
        truncated = truncated or (self._steps >= self._spec.max_episode_steps and not terminated)
        is_over = terminated or truncated
        end = self._end(float(reward), bool(terminated), bool(truncated), info) if is_over else {}
        if self._task.reward is not None:
            reward = self._task.reward.of(end.get("outcome"))
        terminated = bool(terminated or (is_over and self._task.limit_ends))
        return self._told(observation), reward, terminated, bool(truncated) and not terminated, end

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
        if task.touched is not None:
            end["touched"] = self._touched
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
            told: dict[str, Any] = {"frame": self._pictured(seen.frame, "frames")}
            if spec.goals == "observations":
                told["desired_goal"] = self._pictured(seen.desired_goal, "goals that are frames")
            elif spec.goals == "vectors":
                for entry in ("desired_goal", "achieved_goal"):
                    vector = np.atleast_1d(np.asarray(getattr(seen, entry), spec.goal_dtype))
                    told[entry] = _finite(vector, entry)
            if self._spec.fields:
                told["fields"] = self._beside(seen.fields)
        with asking(self._task.name, "goals"):
            told["goal"] = np.int64(_within(seen.label, 0, spec.num_goals))
        with asking(self._task.name, "interactions"):
            told["interaction"] = np.int64(_within(seen.interaction, 0, max(1, spec.num_interactions)))
        return told

    def _beside(self, fields: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
        """Further arrays, as the spec has them."""
        known = self._spec.fields
        if fields.keys() != known.keys():
            raise ArgumentError(
                f"expected the fields {', '.join(known)} as the first time, got {', '.join(fields) or 'none'}"
            )
        arrays = {name: np.asarray(part, known[name].dtype) for name, part in fields.items()}
        for name, array in arrays.items():
            if array.shape != known[name].shape:
                raise ArgumentError(
                    f"expected field `{name}` {list(known[name].shape)} as the first, got {list(array.shape)}"
                )
            _finite(array, f"field `{name}`")
        return arrays

    def _pictured(self, seen: Any, what: str) -> NDArray[Any]:
        """As the spec has it: a grey picture has a channel, and truth is a number."""
        frame: NDArray[Any] = np.atleast_1d(np.asarray(seen))
        frame = frame[..., None] if frame.ndim == 2 else frame
        frame = frame.view(np.uint8) if frame.dtype == np.bool_ else frame
        if frame.shape != self._spec.frame_shape or frame.dtype != self._spec.frame_dtype:
            raise ArgumentError(
                f"expected {what} {np.dtype(self._spec.frame_dtype)} {list(self._spec.frame_shape)} as the "
                f"first, got {frame.dtype} {list(frame.shape)}"
            )
        return _finite(frame, what)


def _box(shape: tuple[int, ...], dtype: DTypeLike) -> spaces.Box:
    kind = np.dtype(dtype)
    if kind.kind == "f":
        return spaces.Box(-np.inf, np.inf, shape, kind.type)
    limits = np.iinfo(kind)
    return spaces.Box(limits.min, limits.max, shape, kind.type)


def _finite(array: NDArray[Any], what: str) -> NDArray[Any]:
    """As it is: what a network reads has no NaN, or nothing is learned from then on."""
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        place = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ArgumentError(f"expected finite numbers in {what}, got {array[tuple(place)]} at {place}")
    return array


def _within(number: Any, low: int, limit: int) -> int:
    if not low <= int(number) < limit:
        raise ArgumentError(f"expected a number in {low}..{limit - 1}, got {number}")
    return int(number)


def _number(info: Mapping[str, Any], name: str) -> float:
    if name not in info:
        raise ArgumentError(f"expected {name} in the last info, got {', '.join(info) or 'none'}")
    return float(info[name])
