"""The toy environment of all tests: small pictures with one object, as a task; learners and a loop for it.

Its sizes can be chosen, to try what trains on environments of other shapes than the package's rooms.
"""

from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from vhs import Outcome
from vhs.acting.actor import Actor
from vhs.acting.episodes import Episodes
from vhs.acting.players import AgentPlayer
from vhs.acting.seeds import episode_seeds
from vhs.acting.setup import make_buffer, make_env
from vhs.acting.stepping import LocalStepping
from vhs.config import Config, load_config
from vhs.learning.learner import Learner
from vhs.task import Task, last_actions
from vhs.train.build import make_learner

SMALL = Path(__file__).parent / "toy.yaml"
ALGORITHMS = Path(__file__).parents[2] / "configs" / "algorithms"
SMALL = Path(__file__).parent / "toy.yaml"
FRAME = (16, 16, 3)
STREAMS = 16


class Toy(gymnasium.Env[Any, Any]):
    """An object of one of three colours beside the view's centre, and `interactions` ways to handle it.

    Turn (the last two moves) until it is in the centre, then do the interaction that was asked for: another
    one is a failure, six steps are a timeout. Without interactions the centre alone is the goal, and turning
    away from it, where it is twice as far, a failure.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        frame: tuple[int, ...] = FRAME,
        moves: int = 3,
        interactions: int = 2,
        start: int = 0,
        render_mode: str | None = None,
    ) -> None:
        self.frame, self.moves, self.interactions, self.start = frame, moves, interactions, start
        entries: dict[str, gymnasium.spaces.Space[Any]] = {
            "image": gymnasium.spaces.Box(0, 255, frame, np.uint8),
            "goal": gymnasium.spaces.Discrete(3),
        }
        if interactions:
            entries["interaction"] = gymnasium.spaces.Discrete(interactions)
        self.observation_space = gymnasium.spaces.Dict(entries)
        self.action_space = gymnasium.spaces.Discrete(moves + interactions, start=start)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        rng = np.random.default_rng(seed)
        self.goal, self.interaction = int(rng.integers(3)), int(rng.integers(max(1, self.interactions)))
        self.offset, self.t = int(rng.choice([-2, -1, 1, 2])), 0
        return self.observe(), {}

    def observe(self) -> dict[str, Any]:
        image = np.full(self.frame, 40, dtype=np.uint8)
        column = self.frame[1] // 2 - 1 + 3 * self.offset
        if image.ndim == 3 and image.shape[2] == 3:
            image[5:11, max(column - 1, 0) : column + 2, self.goal] = 255
        else:
            image[5:11, max(column - 1, 0) : column + 2] = 100 + 50 * self.goal
        told = {"image": image, "goal": np.int64(self.goal)}
        return told | ({"interaction": np.int64(self.interaction)} if self.interactions else {})

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        self.t += 1
        taken = int(action) - self.start
        assert 0 <= taken < self.moves + self.interactions
        turn = {self.moves - 2: 1, self.moves - 1: -1}.get(taken, 0)
        moved = self.offset + turn
        self.offset = int(np.clip(moved, -2, 2))
        outcome, reward = None, -0.01
        if taken >= self.moves and self.offset == 0:
            is_right = taken - self.moves == self.interaction
            outcome, reward = ("success", 9.99) if is_right else ("failure", -1.01)
        elif not self.interactions and self.offset == 0:
            outcome, reward = "success", 9.99
        elif not self.interactions and abs(moved) > 2:
            outcome, reward = "failure", -1.01
        elif self.t == 6:
            outcome, reward = "timeout", -0.11
        info = {} if outcome is None else {"outcome": outcome}
        return self.observe(), reward, outcome in ("success", "failure"), outcome == "timeout", info


def toy_task(moves: int = 3, interactions: int = 2, **sizes: Any) -> Task:
    """The toy environment of some sizes as a task."""
    return Task(
        name="toy",
        make=partial(Toy, moves=moves, interactions=interactions, **sizes),
        max_steps=6,
        interactions=last_actions(moves + interactions, interactions),
        success_reward=9.99,
        limit_ends=True,
    )


TOY = toy_task()
TOY_SPEC = TOY.spec()


def toy_config(name: str, *overrides: str) -> Config:
    """A method's overlay with networks that fit the toy environment."""
    return load_config([SMALL, ALGORITHMS / f"{name}.yaml"], overrides)


def toy_learner(name: str, *overrides: str) -> Learner:
    """The learner of a method at its beginning, built as for any task."""
    return make_learner(toy_config(name, *overrides), TOY_SPEC)


def play_toy(config: Config, episodes: int, task: Task = TOY) -> float:
    """Train on a small environment; the success rate of the last quarter."""
    spec = task.spec()
    learner = make_learner(config, spec)
    group = config.train.episodes_per_update
    buffer = make_buffer(config, spec, STREAMS, STREAMS + group)
    generator = torch.Generator().manual_seed(config.seed)
    actor = Actor(learner.agent, STREAMS, dtype=learner.dtype, generator=generator)
    stepping = LocalStepping([make_env(task, spec) for _ in range(STREAMS)])
    player = AgentPlayer(actor, buffer, learner.goals.begin)
    played = Episodes(stepping, player, buffer, episode_seeds(config.seed))
    played.start()
    waiting, outcomes = [], []
    while len(outcomes) < episodes:
        waiting += played.step()
        while len(waiting) >= group:
            ended, waiting = waiting[:group], waiting[group:]
            ids = np.array([episode.id for episode in ended])
            goals = torch.stack([episode.goal_embedding for episode in ended])
            learner.update(buffer.gather(ids), goals)
            learner.goals.collect(buffer, ids)
            outcomes += [episode.outcome for episode in ended]
    return float(np.mean([outcome == Outcome.SUCCESS for outcome in outcomes[-episodes // 4 :]]))
