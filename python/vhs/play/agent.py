"""A trained agent ready to act in a room; the one place where `vhs play` and `vhs report` load one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import gymnasium
import torch

from vhs.algorithms import VHS
from vhs.config import Config
from vhs.envs import RoomEnv
from vhs.train.actor import Actor
from vhs.train.build import check_runnable, make_envs, make_learner
from vhs.train.checkpoint import load_checkpoint
from vhs.train.directory import read_config


@dataclass(frozen=True, slots=True)
class TrainedAgent:
    """The newest checkpoint of a run."""

    config: Config
    learner: VHS
    """Networks, goal store and prototypes."""
    episodes: int
    """Episodes that it was trained on."""

    def actor(self, seed: int, greedy: bool) -> Actor:
        """An actor of one stream whose samples depend on the seed alone."""
        generator = torch.Generator().manual_seed(seed)
        return Actor(self.learner.agent, 1, dtype=self.learner.dtype, generator=generator, greedy=greedy)


def load_agent(run: Path) -> TrainedAgent:
    """Load the newest checkpoint of a run.

    Raises:
        CheckpointError: `run` is no run, or has no checkpoint, or a damaged one.
        ConfigError: its room, renderer or device cannot be had here.
    """
    config = read_config(run)
    check_runnable(config)
    state, goal_store = load_checkpoint(run)
    torch.set_num_threads(config.train.threads)
    learner = make_learner(config, make_envs(config, 1)[0])
    learner.load_state_dict(state["learner"])
    learner.goal_store = goal_store
    return TrainedAgent(config, learner, int(state["progress"]["episodes"]))


def make_room(config: Config, *, is_drawn: bool) -> RoomEnv:
    """A room of the configured task, without wrappers: its true state is for pictures and reports.

    Args:
        config: of the run.
        is_drawn: whether `render` gives the third-person view.
    """
    env: gymnasium.Env = make_envs(config, 1, render_mode="rgb_array" if is_drawn else None)[0]
    room = env.unwrapped
    assert isinstance(room, RoomEnv)
    return room
