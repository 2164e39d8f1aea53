"""A policy to act with: weights and goals, no optimiser; the one way to load what was trained."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs.acting.actor import Actor
from vhs.config import Config
from vhs.learning.goals import ClassGoals, make_goals
from vhs.models import GoalAgent, make_agent
from vhs.runs.checkpoint import fitting, load_checkpoint
from vhs.runs.directory import AGENT_NAME, is_exported, read_config
from vhs.task import TaskSpec
from vhs.train.build import check_runnable, convolution_dtype, make_envs, make_spec, to_act_here


@dataclass(frozen=True, slots=True)
class Policy:
    """What acting, evaluation, films, reports and export need of a run."""

    config: Config
    """The configuration that trained it, but for workers and a device that is not here."""
    agent: GoalAgent
    """The networks."""
    goals: ClassGoals
    """What names goals: `goals.begin(label)` gives the embedding of an episode that begins. An exported agent
    brings no images of goals along."""
    dtype: torch.dtype
    """Type in which the convolutions multiply."""
    trained_episodes: int = 0

    def embed(self, observations: NDArray[np.uint8]) -> Tensor:
        """f(o): what the agent is asked for where a picture is its goal, in place of `goals.begin`.

        Args:
            observations: uint8 [n, frame_stack, height, width, channels], oldest frame first.

        Returns:
            float32 [n, feature_dim], without a gradient.
        """
        with torch.no_grad():
            features: Tensor = self.agent.extractor(
                torch.from_numpy(observations).to(self.agent.gate.weight.device)
            )
        return features

    def actor(self, seed: int, greedy: bool, num_streams: int = 1) -> Actor:
        """An actor whose samples depend on the seed alone."""
        generator = torch.Generator().manual_seed(seed)
        return Actor(self.agent, num_streams, dtype=self.dtype, generator=generator, greedy=greedy)


def make_policy(config: Config, spec: TaskSpec) -> Policy:
    """A policy with the weights of its seed, before any training."""
    agent, dtype = make_agent(config, spec), convolution_dtype(config)
    goals = make_goals(config, agent, spec.num_goals, dtype)
    return Policy(config, agent, goals, dtype)


def load_agent(path: Path | str) -> Policy:
    """Load the newest checkpoint of a run, or an exported agent, ready to act: batch norm in evaluation mode.

    Args:
        path: directory of the run or of the exported agent.

    Raises:
        CheckpointError: neither is there, it is damaged, or it does not fit its own configuration.
        ConfigError: its configuration cannot run here.
    """
    path = Path(path)
    config = to_act_here(read_config(path))
    check_runnable(config)
    with closing(make_envs(config, 1)[0]) as env:
        policy = make_policy(config, make_spec(config, env))
    policy.agent.eval()
    if is_exported(path):
        from vhs.runs.agent_file import read_agent

        about = read_agent(path / AGENT_NAME, policy.agent, policy.goals)
        return replace(policy, trained_episodes=int(about["trained_episodes"]))
    state, store = load_checkpoint(path)
    with fitting(path):
        policy.agent.load_state_dict(state["learner"]["agent"])
        policy.goals.load_state_dict(state["learner"]["prototypes"])
        episodes = int(state["progress"]["episodes"])
    policy.goals.store = store
    return replace(policy, trained_episodes=episodes)
