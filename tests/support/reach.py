"""Small environments whose goals are pictures or vectors and whose actions are of any kind, as tasks."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from vhs.task import GoalDict, Instruction, Task

SIZE = 12
"""Pixels of a picture's side."""
REACH = 0.3
"""Distance at which a place is reached, in a world from -1 to 1."""


class Reach(gymnasium.Env[Any, Any]):
    """Walk from the centre of a square to the place that is told, within eight steps; a wall is a wall.

    A picture shows where one is, bright on grey. Actions: `Discrete` (four ways), `MultiDiscrete` (left, stay
    or right, and the same up and down) or `Box` (a step of any length up to `far` along both).
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012
    far = 0.4

    def __init__(
        self,
        goals: str = "picture",
        action_space: spaces.Space[Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        self.goals = goals
        self.action_space = action_space or spaces.Discrete(4)
        picture, place = spaces.Box(0, 255, (SIZE, SIZE, 1), np.uint8), spaces.Box(-1, 1, (2,), np.float32)
        entries: dict[str, spaces.Space[Any]] = {"image": picture, "goal": picture}
        if goals == "vector":
            entries = {"observation": picture, "achieved_goal": place, "desired_goal": place}
        elif goals == "state":
            entries = {"observation": place, "achieved_goal": place, "desired_goal": place}
        self.observation_space = spaces.Dict(entries)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[dict[str, Any], dict[str, Any]]:
        rng = np.random.default_rng(seed)
        self.place, self.t = np.zeros(2, np.float32), 0
        angle = rng.integers(4) * np.pi / 2
        self.target = np.array([np.cos(angle), np.sin(angle)], np.float32) * 0.8
        return self.observe(), {}

    def picture(self, place: Any) -> Any:
        image = np.full((SIZE, SIZE, 1), 40, np.uint8)
        row, column = ((place + 1) / 2 * (SIZE - 3)).round().astype(int)
        image[row : row + 3, column : column + 3] = 255
        return image

    def observe(self) -> dict[str, Any]:
        if self.goals == "picture":
            return {"image": self.picture(self.place), "goal": self.picture(self.target)}
        seen = self.picture(self.place) if self.goals == "vector" else self.place.copy()
        return {"observation": seen, "achieved_goal": self.place.copy(), "desired_goal": self.target.copy()}

    def way(self, action: Any) -> Any:
        assert self.action_space.contains(action), (action, self.action_space)
        if isinstance(self.action_space, spaces.Discrete):
            return np.array([(1, 0), (-1, 0), (0, 1), (0, -1)][int(action)]) * self.far
        if isinstance(self.action_space, spaces.MultiDiscrete):
            return (np.asarray(action) - self.action_space.start - 1) * self.far
        low, high = self.action_space.low, self.action_space.high
        return (2 * (np.asarray(action) - low) / (high - low) - 1) * self.far

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        self.t += 1
        self.place = np.clip(self.place + self.way(action), -1, 1).astype(np.float32)
        is_there = bool(np.linalg.norm(self.place - self.target) < REACH)
        return self.observe(), 10.0 if is_there else 0.0, is_there, not is_there and self.t == 8, {}


def reach_task(goals: str = "picture", action_space: spaces.Space[Any] | None = None) -> Task:
    """A task of one of these environments."""

    def make(**kwargs: Any) -> Reach:
        return Reach(goals, action_space, **kwargs)

    return Task(
        name="reach", make=make, max_steps=8, read=Instruction() if goals == "picture" else GoalDict()
    )
