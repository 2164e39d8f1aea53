"""From a configuration and the spec of a task to networks and a learner at their beginning."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch

from vhs import GoalStore, Prototypes, Rng
from vhs.acting.setup import convolution_dtype
from vhs.config import Config
from vhs.learning.algorithms import ALGORITHMS, VHS
from vhs.models import DiscriminativeAgent, FeatureExtractor, GoalAgent, pick_device
from vhs.task import TaskSpec


def make_agent(config: Config, spec: TaskSpec) -> GoalAgent:
    """Networks that fit a task, initialised from the run's seed alone."""
    model, classes = config.model, spec.num_goals
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        extractor = FeatureExtractor(spec.frame_shape, model.frame_stack, model.channels, model.feature_dim)
        kind: Callable[..., GoalAgent] = GoalAgent
        if config.method.name == "gdan":
            kind = partial(DiscriminativeAgent, num_goals=classes)
        agent = kind(
            extractor,
            num_actions=spec.num_actions,
            # Where an instruction names no interaction, all are asked for the same one.
            num_interactions=max(1, spec.num_interactions),
            hidden_dim=model.hidden_dim,
            head_dim=model.head_dim,
            interaction_dim=model.interaction_dim,
            num_words=classes if config.method.embedding == "word" else 0,
        )
    return agent.to(pick_device(config.train.device))


def make_learner(config: Config, spec: TaskSpec) -> VHS:
    """The learner at its beginning, before any episode."""
    method, classes = config.method, spec.num_goals
    image = (config.model.frame_stack, *spec.frame_shape)
    return ALGORITHMS[method.name](
        make_agent(config, spec),
        GoalStore(classes, image, method.goal_capacity, seed=config.seed),
        Prototypes(classes, config.model.feature_dim, momentum=prototype_momentum(config), seed=config.seed),
        method=method,
        train=config.train,
        success_reward=spec.success_reward or 0.0,
        dtype=convolution_dtype(config),
        rng=Rng(config.seed),
    )


def prototype_momentum(config: Config) -> float:
    """Share of the old prototype kept by an update: none when prototypes are exact."""
    return config.method.prototype_momentum if config.method.prototype == "running" else 0.0
