"""A policy to act with: weights and goals, no optimiser; the one way to load what was trained."""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBuffer, LabelError
from vhs.acting.actor import Actor
from vhs.acting.players import AgentPlayer
from vhs.acting.setup import (
    check_runnable,
    check_spec,
    convolution_dtype,
    is_room,
    settled,
    task_of,
    to_act_here,
)
from vhs.config import Config, EnvSection, resolve_config
from vhs.config.load import MOST_BYTES, read_task
from vhs.distribution import find_agent
from vhs.errors import ConfigError
from vhs.learning.averaging import averaged
from vhs.learning.goals import ClassGoals
from vhs.learning.told import make_goals
from vhs.models import ExtractorFactory, GoalAgent, make_agent
from vhs.reading import read_bounded
from vhs.runs.agent_file import check_limits, read_agent
from vhs.runs.checkpoint import fitting, load_checkpoint
from vhs.runs.directory import AGENT_NAME, CONFIG_NAME, check_settings, is_exported, read_config
from vhs.runs.remote import fetch_agent, is_on_hub
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

    def show(self, goal: int | str, pictures: NDArray[np.uint8]) -> None:
        """Show the agent a goal, so that it can be asked for what it was never told of; nothing learns.

        From now on the class is named by the mean of f over these pictures.

        Args:
            goal: a class, or its name in `Task.goals`.
            pictures: what an episode sees last that reaches it, one at least: frames, uint8
                [n, height, width, channels], of which each is seen for as long as an observation lasts; or
                observations, uint8 [n, height, width, frame_stack * channels], oldest frame first.

        Raises:
            ArgumentError: goals are not named by pictures of their class.
            LabelError, DtypeError, ShapeError: for an argument that does not fit; nothing has changed.
        """
        label = self._label(goal)
        if np.shape(pictures)[1:] == self.spec.frame_shape and len(self.spec.frame_shape) == 3:
            pictures = np.concatenate([pictures] * self.config.model.frame_stack, axis=-1)
        self.goals.show(label, np.ascontiguousarray(pictures))

    def _label(self, goal: int | str) -> int:
        """The class of a goal: a name's, or itself."""
        names = self.task.goals or ()
        if isinstance(goal, str) and goal in names:
            return names.index(goal)
        try:
            return operator.index(goal)  # type: ignore[arg-type]
        except TypeError:
            known = ", ".join(names) or "its number"
            raise LabelError(
                f"show: expected a goal of task {self.task.name} ({known}), found {goal!r}"
            ) from None

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
    check_spec(config, task, spec, is_own=extractor is not None)
    agent, dtype = make_agent(config, spec, extractor), convolution_dtype(config)
    goals = make_goals(config, agent, spec, dtype)
    return Policy(config, agent, goals, dtype, task, spec)


def told_task(run: Path, named: str) -> Task:
    """The task of a run, where a person says that it is.

    Args:
        run: directory of a run or of an exported agent, whose `env.kwargs` hold; or one that holds some.
        named: as for `vhs.config.load.read_task`.

    Raises:
        ConfigError: it is not there.
        CheckpointError: the configuration of the run is damaged.
    """
    config = read_config(run) if (run / CONFIG_NAME).exists() else Config()
    env = EnvSection() if is_room(config) else config.env
    return task_of(resolve_config([{"env": env.model_dump()}, read_task(named)]))


def load_agent(
    path: Path | str, task: Task | None = None, extractor: ExtractorFactory | None = None
) -> Policy:
    """Load the newest checkpoint of a run, or an exported agent, ready to act: batch norm in evaluation mode.

    Args:
        path: directory of the run or of the exported agent, or the name of an agent that comes with the
            package, ``task1`` to ``task3``, or ``hf://user/name`` on the Hugging Face Hub.
        task: what it was trained on; None: the task that its configuration names.
        extractor: what made its feature extractor, where `train` was given one.

    Raises:
        CheckpointError: neither is there, it is damaged, or it does not fit its own configuration.
        ConfigError: its configuration cannot run here, or an exported agent's task is no room and not given.
    """
    path = fetch_agent(path) if is_on_hub(path) else find_agent(path)
    config = to_act_here(read_config(path))
    if task is None and is_exported(path) and not is_room(config):
        raise ConfigError(
            f"{path}: expected to be told the task of an exported agent, as no code is run that a stranger "
            f"names: --task FILE.py (it says {config.task_name}), or `task=`"
        )
    if is_exported(path):
        return _load_exported(path, config, task, extractor)
    policy = make_policy(config, task, extractor)
    policy.agent.eval()
    state, store = load_checkpoint(path)
    with fitting(path):
        check_settings(path, config, state["settings"])
        weights, prototypes = averaged(state["learner"])
        policy.agent.load_state_dict(weights)
        policy.goals.load_state_dict(prototypes)
        episodes = int(state["progress"]["episodes"])
    policy.goals.store = store
    return replace(policy, trained_episodes=episodes)


def _load_exported(
    path: Path, config: Config, task: Task | None, extractor: ExtractorFactory | None
) -> Policy:
    """An exported agent, maybe a stranger's: checked before anything of the size that it names is made."""
    check_limits(config)
    if config.model.extractor is not None and extractor is None:
        raise ConfigError(
            f"{path}: expected no code of its own, found model.extractor = {config.model.extractor}; "
            "load_agent(path, extractor=...) says which code it may run"
        )
    file = read_agent(path / AGENT_NAME)
    file.check_beside(read_bounded(path / CONFIG_NAME, MOST_BYTES))
    task = task or task_of(config)
    file.check(config, task.spec(), extractor)
    policy = make_policy(config, task, extractor)
    policy.agent.eval()
    file.load(policy.agent, policy.goals)
    return replace(policy, trained_episodes=file.trained_episodes)
