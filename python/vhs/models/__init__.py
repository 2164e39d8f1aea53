"""The networks: feature extractor f and the recurrent, goal-gated agent."""

from vhs.models.agent import GoalAgent, RecurrentState
from vhs.models.build import make_agent
from vhs.models.device import pick_device, to_device, to_numpy
from vhs.models.discriminative import DiscriminativeAgent
from vhs.models.extractor import Extractor, ExtractorFactory, FeatureExtractor
from vhs.models.heads import ActionHead, Categorical, MultiCategorical, SquashedNormal, head_of

__all__ = [
    "ActionHead",
    "Categorical",
    "DiscriminativeAgent",
    "Extractor",
    "ExtractorFactory",
    "FeatureExtractor",
    "GoalAgent",
    "MultiCategorical",
    "RecurrentState",
    "SquashedNormal",
    "head_of",
    "make_agent",
    "pick_device",
    "to_device",
    "to_numpy",
]
