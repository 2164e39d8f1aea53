"""A policy to act with: weights and goals, no optimiser; the one way to load what was trained."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBuffer
from vhs.acting.actor import Actor
from vhs.acting.players import AgentPlayer
from vhs.acting.setup import check_runnable, check_spec, convolution_dtype, settled, task_of, to_act_here
from vhs.config import Config
from vhs.learning.goals import ClassGoals
from vhs.learning.told import make_goals
from vhs.models import ExtractorFactory, GoalAgent, make_agent
from vhs.runs.checkpoint import fitting, load_checkpoint
from vhs.runs.directory import AGENT_NAME, is_exported, read_config
from vhs.task import Task, TaskSpec


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
    task: Task
    """What it acts on."""
    spec: TaskSpec
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

    def player(self, buffer: EpisodeBuffer, seed: int, greedy: bool) -> AgentPlayer:
        """A player of the streams of a buffer, whose samples depend on the seed alone."""
        return AgentPlayer(self.actor(seed, greedy, buffer.num_streams), buffer, self.goals.begin)


def make_policy(
    config: Config, task: Task | None = None, extractor: ExtractorFactory | None = None
) -> Policy:
    """A policy with the weights of its seed, before any training.

    Args:
        config: resolved.
        task: what it acts on; None: the task that the configuration names.
        extractor: makes the feature extractor in place of `model.extractor`.

    Raises:
        ConfigError: its configuration cannot run here.
    """
    task = task or task_of(config)
    check_runnable(config, task)
    spec = task.spec()
    config = settled(config, spec)
    check_spec(config, task, spec)
    agent, dtype = make_agent(config, spec, extractor), convolution_dtype(config)
    goals = make_goals(config, agent, spec, dtype)
    return Policy(config, agent, goals, dtype, task, spec)


def load_agent(
    path: Path | str, task: Task | None = None, extractor: ExtractorFactory | None = None
) -> Policy:
    """Load the newest checkpoint of a run, or an exported agent, ready to act: batch norm in evaluation mode.

    Args:
        path: directory of the run or of the exported agent.
        task: what it was trained on; None: the task that its configuration names.
        extractor: what made its feature extractor, where `train` was given one.

    Raises:
        CheckpointError: neither is there, it is damaged, or it does not fit its own configuration.
        ConfigError: its configuration cannot run here.
    """
    path = Path(path)
    policy = make_policy(to_act_here(read_config(path)), task, extractor)
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
