"""The networks: feature extractor f and the recurrent, goal-gated agent."""

from vhs.models.agent import GoalAgent, RecurrentState
from vhs.models.build import make_agent
from vhs.models.device import pick_device, to_device, to_numpy
from vhs.models.discriminative import DiscriminativeAgent
from vhs.models.extractor import FeatureExtractor

__all__ = [
    "DiscriminativeAgent",
    "FeatureExtractor",
    "GoalAgent",
    "RecurrentState",
    "make_agent",
    "pick_device",
    "to_device",
    "to_numpy",
]
