"""A small learner of VHS, goal images for its store and episodes to learn from."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBatch, EpisodeBuffer, GoalStore, Outcome, Prototypes, Rng
from vhs.config import load_config
from vhs.learning.goals import Goals, PrototypeGoals
from vhs.learning.learner import Learner
from vhs.learning.replay import Replay
from vhs.models import Categorical, FeatureExtractor, GoalAgent

FRAME = (16, 16, 3)
GOALS, INTERACTIONS, DIM = 3, 2, 8
SUCCESS_REWARD = 9.99


def small_learner(*overrides: str, replay: Replay | None = None) -> Learner:
    config = load_config(
        [],
        [
            "method.warmup=6",
            "method.supcon_batch=12",
            "method.prototype_samples=4",
            "method.relabel_on=[failure]",
            "train.gamma=0.95",
            *overrides,
        ],
    )
    torch.manual_seed(0)
    agent = GoalAgent(
        FeatureExtractor(FRAME, 2, (4, 4, 4, 4), DIM),
        head=Categorical(3 + INTERACTIONS),
        num_interactions=INTERACTIONS,
        hidden_dim=12,
        head_dim=10,
        interaction_dim=4,
    )
    momentum = 0.0 if config.method.prototype == "exact" else 0.9
    store, prototypes = (
        GoalStore(GOALS, agent.extractor.observation_shape, 50, seed=0),
        Prototypes(GOALS, DIM, momentum, seed=0),
    )
    return Learner(
        agent,
        PrototypeGoals(agent, store, prototypes, config.method, torch.float32),
        method=config.method,
        train=config.train,
        success_reward=SUCCESS_REWARD,
        dtype=torch.float32,
        rng=Rng(0),
        replay=replay,
    )


def fill_store(goals: Goals, per_class: int = 5) -> None:
    rng = np.random.default_rng(7)
    for label in range(GOALS):
        for _ in range(per_class):
            goals.store.push(rng.integers(0, 256, goals.store.observation_shape, dtype=np.uint8), label)


def make_buffer(capacity_steps: int = 400) -> EpisodeBuffer:
    """An empty one."""
    return EpisodeBuffer(
        FRAME,
        num_streams=1,
        max_episode_steps=20,
        capacity_steps=capacity_steps,
        frame_stack=2,
        stacking="channels",
        num_goals=GOALS,
        interactions={3 + number: number for number in range(INTERACTIONS)},
    )


def make_batch(outcomes: list[Outcome], last_action: int = 4) -> EpisodeBatch:
    """Random episodes of growing length; each ends with `last_action`."""
    buffer = make_buffer()
    return buffer.gather(play(buffer, outcomes, last_action))


def play(buffer: EpisodeBuffer, outcomes: list[Outcome], last_action: int = 4) -> NDArray[np.int64]:
    """Random episodes of growing length; each ends with `last_action`. Their ids."""
    rng = np.random.default_rng(3)
    ids = []
    for episode, outcome in enumerate(outcomes):
        buffer.begin(0, rng.integers(0, 256, FRAME, dtype=np.uint8), episode % GOALS, 0)
        steps = 3 + episode
        for step in range(steps):
            action = last_action if step == steps - 1 else int(rng.integers(0, 3))
            reward, value = float(rng.normal()), float(rng.normal())
            buffer.append(0, action, reward, value, rng.integers(0, 256, FRAME, dtype=np.uint8))
        ids.append(buffer.finish(0, outcome))
    return np.array(ids, dtype=np.int64)


def goals_for(batch: EpisodeBatch, dim: int = DIM) -> Tensor:
    return torch.randn(len(batch.lengths), dim, generator=torch.Generator().manual_seed(5))
