"""From a configuration to networks that fit a task."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from vhs._core import ShapeError
from vhs.buffer import beside_dim
from vhs.errors import ConfigError, without_frames
from vhs.models.agent import GoalAgent
from vhs.models.device import pick_device
from vhs.models.discriminative import DiscriminativeAgent
from vhs.models.extractor import Extractor, ExtractorFactory, FeatureExtractor, OwnExtractor, VectorExtractor
from vhs.models.heads import head_of

if TYPE_CHECKING:
    from vhs.config import Config
    from vhs.task import TaskSpec


def make_agent(config: Config, spec: TaskSpec, extractor: ExtractorFactory | None = None) -> GoalAgent:
    """The networks of a configuration's method, on its device, initialised from the run's seed alone.

    Args:
        config: resolved.
        spec: of the task.
        extractor: makes f; None: `model.extractor`, or what fits the task's frames.

    Raises:
        ConfigError: an extractor that cannot be had or does not fit; sizes that torch cannot make.
    """
    try:
        return _agent(config, spec, extractor)
    except (RuntimeError, TypeError, OverflowError) as error:
        raise ConfigError(
            f"model: expected networks that can be made, found {without_frames(error)}"
        ) from error


def _agent(config: Config, spec: TaskSpec, extractor: ExtractorFactory | None) -> GoalAgent:
    model, method = config.model, config.method
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        f = _extractor(config, spec, extractor)
        parts: dict[str, Any] = {
            "head": head_of(spec),
            # Where an instruction names no interaction, all are asked for the same one.
            "num_interactions": max(1, spec.num_interactions),
            "hidden_dim": model.hidden_dim,
            "head_dim": model.head_dim,
            "interaction_dim": model.interaction_dim,
            "num_words": spec.num_goals if spec.goals == "labels" and method.embedding == "word" else 0,
            "num_sights": spec.num_goals if method.localisation_weight else 0,
            "recalls": bool(method.memory_weight),
            "goal_dim": int(np.prod(spec.goal_shape)) if spec.goals == "vectors" else 0,
            "beside_dim": beside_dim(spec),
        }
        if method.row.network == "discriminative":
            agent: GoalAgent = DiscriminativeAgent(f, num_goals=spec.num_goals, **parts)
        else:
            agent = GoalAgent(f, **parts)
    return agent.to(pick_device(config.train.device))


def load_extractor(name: str) -> ExtractorFactory:
    """The factory that ``module:name`` says.

    Raises:
        ConfigError: there is none.
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"model.extractor: expected module:factory, found {name!r}: {error}") from error
    if not callable(found):
        raise ConfigError(f"model.extractor: expected a factory, found {found!r}")
    factory: ExtractorFactory = found
    return factory


def _extractor(config: Config, spec: TaskSpec, factory: ExtractorFactory | None) -> Extractor:
    model, shape = config.model, spec.frame_shape
    if factory is None and model.extractor is not None:
        factory = load_extractor(model.extractor)
    if factory is not None:
        return _own(factory, config, spec)
    if len(shape) == 3:
        return FeatureExtractor(shape, model.frame_stack, model.channels, model.feature_dim)
    return VectorExtractor(shape, model.frame_stack, model.head_dim, model.feature_dim)


def _own(factory: ExtractorFactory, config: Config, spec: TaskSpec) -> OwnExtractor:
    stack, shape = config.model.frame_stack, spec.frame_shape
    observed = (*shape[:2], stack * shape[2]) if len(shape) == 3 else (stack, *shape)
    try:
        own = OwnExtractor(factory, observed, config.model.feature_dim)
        own.check(torch.from_numpy(np.zeros(0, spec.frame_dtype)).dtype)
    except (ShapeError, TypeError, RuntimeError) as error:
        raise ConfigError(
            f"model.extractor: expected a factory (observation_shape, feature_dim) -> module of features "
            f"[N, {config.model.feature_dim}] from {spec.frame_dtype} [N, {', '.join(map(str, observed))}], "
            f"found {without_frames(error)}"
        ) from error
    return own
