"""An agent to act with: the one way to load what was trained, out of a run or of an exported directory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBuffer
from vhs.acting.actor import Actor
from vhs.acting.players import AgentPlayer
from vhs.acting.setup import check_runnable, check_spec, task_of, to_act_here
from vhs.config import Config
from vhs.learning.algorithms import VHS
from vhs.runs.checkpoint import fitting, load_checkpoint
from vhs.runs.directory import AGENT_NAME, is_exported, read_config
from vhs.task import Task, TaskSpec
from vhs.train.build import make_learner


@dataclass(frozen=True, slots=True)
class TrainedAgent:
    """What acting needs: networks (`learner.agent`) and goal embeddings (`learner.embed_goal`)."""

    config: Config
    """The configuration that trained it, but for workers and a device that is not here."""
    learner: VHS
    """Of an exported agent, goal store and optimiser are those of a learner at its beginning."""
    trained_episodes: int
    task: Task
    spec: TaskSpec

    def embed(self, observations: NDArray[np.uint8]) -> Tensor:
        """f(o): what the agent is asked for where a picture is its goal, in place of `learner.embed_goal`.

        Args:
            observations: uint8 [n, frame_stack, height, width, channels], oldest frame first.

        Returns:
            float32 [n, feature_dim], without a gradient.
        """
        agent = self.learner.agent
        with torch.no_grad():
            features: Tensor = agent.extractor(
                torch.from_numpy(observations).to(next(agent.parameters()).device)
            )
        return features

    def actor(self, seed: int, greedy: bool, num_streams: int = 1) -> Actor:
        """An actor whose samples depend on the seed alone."""
        generator = torch.Generator().manual_seed(seed)
        learner = self.learner
        return Actor(learner.agent, num_streams, dtype=learner.dtype, generator=generator, greedy=greedy)

    def player(self, buffer: EpisodeBuffer, seed: int, greedy: bool) -> AgentPlayer:
        """The agent as a player of the streams of a buffer."""
        return AgentPlayer(self.actor(seed, greedy, buffer.num_streams), buffer, self.learner.embed_goal)


def load_agent(path: Path | str, task: Task | None = None) -> TrainedAgent:
    """Load the newest checkpoint of a run, or an exported agent, ready to act: batch norm in evaluation mode.

    Args:
        path: directory of the run or of the exported agent.
        task: what it was trained on; None: the task that its configuration names.

    Raises:
        CheckpointError: neither is there, it is damaged, or it does not fit its own configuration.
        ConfigError: its configuration cannot run here.
    """
    path = Path(path)
    config = to_act_here(read_config(path))
    task = task or task_of(config)
    check_runnable(config, task)
    spec = task.spec()
    check_spec(config, task, spec)
    learner = make_learner(config, spec)
    learner.agent.eval()
    if is_exported(path):
        from vhs.runs.agent_file import read_agent

        episodes = int(read_agent(path / AGENT_NAME, learner)["trained_episodes"])
        return TrainedAgent(config, learner, episodes, task, spec)
    state, goal_store = load_checkpoint(path)
    with fitting(path):
        learner.load_state_dict(state["learner"])
        episodes = int(state["progress"]["episodes"])
    learner.goal_store = goal_store
    return TrainedAgent(config, learner, episodes, task, spec)
