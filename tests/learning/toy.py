"""A room of 16x16 pixels with one object in it, and a training loop around it that takes seconds."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from vhs import Outcome
from vhs.acting.actor import Actor
from vhs.acting.episodes import Rollout, episode_seeds
from vhs.acting.stepping import LocalRooms
from vhs.config import Config, load_config
from vhs.learning.learner import Learner
from vhs.task import read_spec
from vhs.train.build import make_buffer, make_learner

ALGORITHMS = Path(__file__).parents[2] / "configs" / "algorithms"
SMALL = Path(__file__).parent / "toy.yaml"
FRAME = (16, 16, 3)
STREAMS = 16


class ToyRoom(gymnasium.Env[Any, Any]):
    """An object of one of three colours beside the view's centre, and two ways to handle it.

    Turn (actions 1, 2) until it is in the centre, then do the interaction that was asked for (3, 4): the
    other one is a failure, six steps are a timeout.
    """

    observation_space = gymnasium.spaces.Dict(
        {
            "image": gymnasium.spaces.Box(0, 255, FRAME, np.uint8),
            "goal": gymnasium.spaces.Discrete(3),
            "interaction": gymnasium.spaces.Discrete(2),
        }
    )
    action_space = gymnasium.spaces.Discrete(5)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        rng = np.random.default_rng(seed)
        self.goal, self.interaction = int(rng.integers(3)), int(rng.integers(2))
        self.offset, self.t = int(rng.choice([-2, -1, 1, 2])), 0
        return self.observe(), {}

    def observe(self) -> dict[str, Any]:
        image = np.full(FRAME, 40, dtype=np.uint8)
        column = 7 + 3 * self.offset
        image[5:11, max(column - 1, 0) : column + 2, self.goal] = 255
        return {"image": image, "goal": np.int64(self.goal), "interaction": np.int64(self.interaction)}

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        self.t += 1
        self.offset = int(np.clip(self.offset + {1: 1, 2: -1}.get(int(action), 0), -2, 2))
        outcome, reward = None, -0.01
        if action >= 3 and self.offset == 0:
            is_right = action - 3 == self.interaction
            outcome, reward = ("success", 9.99) if is_right else ("failure", -1.01)
        elif self.t == 6:
            outcome, reward = "timeout", -0.11
        ended = outcome is not None
        info = {"outcome": outcome, "reached_object": self.goal} if ended else {}
        return self.observe(), reward, ended, False, info


TOY = read_spec(ToyRoom(), max_episode_steps=6, interactions=2, success_reward=9.99)


def toy_config(name: str, *overrides: str) -> Config:
    """A method's overlay with networks that fit the toy room."""
    return load_config([SMALL, ALGORITHMS / f"{name}.yaml"], overrides)


def toy_learner(name: str, *overrides: str) -> Learner:
    """The learner of a method at its beginning, built as for a real room."""
    return make_learner(toy_config(name, *overrides), TOY)


def play_toy(config: Config, episodes: int) -> float:
    """Train on the toy room; the success rate of the last quarter."""
    learner = make_learner(config, TOY)
    group = config.train.episodes_per_update
    buffer = make_buffer(config, TOY, STREAMS, STREAMS + group)
    generator = torch.Generator().manual_seed(config.seed)
    actor = Actor(learner.agent, STREAMS, dtype=learner.dtype, generator=generator)
    rooms = LocalRooms([ToyRoom() for _ in range(STREAMS)])
    rollout = Rollout(rooms, STREAMS, actor, buffer, learner.goals.begin, episode_seeds(config.seed))
    waiting, outcomes = [], []
    while len(outcomes) < episodes:
        waiting += rollout.step()
        while len(waiting) >= group:
            ended, waiting = waiting[:group], waiting[group:]
            ids = np.array([episode.id for episode in ended])
            goals = torch.stack([episode.goal_embedding for episode in ended])
            learner.update([(buffer.gather(ids), goals)])
            learner.goals.collect(buffer, ids)
            outcomes += [episode.outcome for episode in ended]
    return float(np.mean([outcome == Outcome.SUCCESS for outcome in outcomes[-episodes // 4 :]]))
