"""From a configuration to networks that fit a task."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from vhs.models.agent import GoalAgent
from vhs.models.device import pick_device
from vhs.models.discriminative import DiscriminativeAgent
from vhs.models.extractor import FeatureExtractor

if TYPE_CHECKING:
    from vhs.config import Config
    from vhs.task import TaskSpec


def make_agent(config: Config, spec: TaskSpec) -> GoalAgent:
    """The networks of a configuration's method, on its device, initialised from the run's seed alone."""
    model, method = config.model, config.method.for_task(can_localise=spec.can_localise)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        extractor = FeatureExtractor(spec.frame_shape, model.frame_stack, model.channels, model.feature_dim)
        numbers = {
            "num_actions": spec.num_actions,
            # Where an instruction names no interaction, all are asked for the same one.
            "num_interactions": max(1, spec.num_interactions),
            "hidden_dim": model.hidden_dim,
            "head_dim": model.head_dim,
            "interaction_dim": model.interaction_dim,
            "num_words": spec.num_goals if method.embedding == "word" else 0,
            "num_sights": spec.num_goals if method.localisation_weight else 0,
        }
        if method.row.network == "discriminative":
            agent: GoalAgent = DiscriminativeAgent(extractor, num_goals=spec.num_goals, **numbers)
        else:
            agent = GoalAgent(extractor, **numbers)
    return agent.to(pick_device(config.train.device))
