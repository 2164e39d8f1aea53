"""Small goal-conditioned environments; importable by spawned processes."""

from __future__ import annotations

import os
import signal
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

LIMIT = 6


class Line(gymnasium.Env[dict[str, Any], Any]):
    """A place on a line, 0 to 20, and a place to reach; each observation tells its episode and its step too.

    Reaching the goal ends the task with reward 0; other steps pay -1; after `LIMIT` steps it is cut off.
    """

    def __init__(self, *, is_continuous: bool = False) -> None:
        """Steps are -1 or 1, chosen by number or by sign."""
        place = spaces.Box(0, 20, (1,), np.float32)
        seen = spaces.Box(-1, 1e6, (3,), np.float32)
        self.observation_space = spaces.Dict(observation=seen, achieved_goal=place, desired_goal=place)
        self.action_space = spaces.Box(-1, 1, (1,), np.float32) if is_continuous else spaces.Discrete(2)
        self.episode = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.place, self.goal = self.np_random.choice(21, 2, replace=False).tolist()
        self.episode, self.time = self.episode + 1, 0
        return self.seen(), {"options": options} if options else {}

    def step(self, action: Any) -> Any:
        way = np.sign(action[0]) if isinstance(self.action_space, spaces.Box) else 2 * int(action) - 1
        self.place = int(np.clip(self.place + way, 0, 20))
        self.time += 1
        reached = self.place == self.goal
        info = {"is_success": reached, "time": self.time}
        return self.seen(), float(reached) - 1, reached, self.time == LIMIT, info

    def seen(self) -> dict[str, Any]:
        return {
            "observation": np.array([self.place, self.episode, self.time], np.float32),
            "achieved_goal": np.array([self.place], np.float32),
            "desired_goal": np.array([self.goal], np.float32),
        }

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
        return (achieved == desired).all(-1).astype(np.float32) - 1


class EndingLine(Line):
    """Says of a batch whether the task is over."""

    def compute_terminated(self, achieved: Any, desired: Any, info: Any) -> Any:
        return (achieved == desired).all(-1)


class EndingLineByRow(Line):
    """Says so of one step alone, as the mazes of gymnasium-robotics do."""

    def compute_terminated(self, achieved: Any, desired: Any, info: Any) -> Any:
        return bool(np.linalg.norm(achieved - desired) < 0.5)


class Tile(gymnasium.Env[dict[str, Any], Any]):
    """A white tile in a picture of 36 by 36, moved four ways in steps of 12; the goal is a picture too."""

    def __init__(self) -> None:
        picture = spaces.Box(0, 255, (36, 36, 3), np.uint8)
        self.observation_space = spaces.Dict(observation=picture, achieved_goal=picture, desired_goal=picture)
        self.action_space = spaces.Discrete(4)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        here, there = self.np_random.choice(9, 2, replace=False)
        self.place, self.goal, self.time = np.array(divmod(int(here), 3)), divmod(int(there), 3), 0
        return self.seen(), {}

    def step(self, action: Any) -> Any:
        self.place = np.clip(self.place + [(0, 1), (0, -1), (1, 0), (-1, 0)][int(action)], 0, 2)
        self.time += 1
        reached = tuple(self.place.tolist()) == self.goal
        return self.seen(), float(reached) - 1, reached, self.time == LIMIT, {"is_success": reached}

    def seen(self) -> dict[str, Any]:
        here = picture(self.place)
        return {"observation": here, "achieved_goal": here.copy(), "desired_goal": picture(self.goal)}

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
        return (achieved == desired).all((-1, -2, -3)).astype(np.float32) - 1

    def compute_terminated(self, achieved: Any, desired: Any, info: Any) -> Any:
        return (achieved == desired).all((-1, -2, -3))


def picture(place: Any) -> np.ndarray:
    shown = np.zeros((36, 36, 3), np.uint8)
    row, column = 12 * int(place[0]), 12 * int(place[1])
    shown[row : row + 12, column : column + 12] = 255
    return shown


class Deadly(Line):
    """Its process ends in the third step of its first episode."""

    def reset(self, **how: Any) -> Any:
        super().reset(**how)
        self.place, self.goal = 0, 20
        return self.seen(), {}

    def step(self, action: Any) -> Any:
        if self.time == 2 and self.episode == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().step(action)
