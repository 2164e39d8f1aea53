"""The networks: feature extractor f and the recurrent, goal-gated agent."""

from vhs.models.agent import GoalAgent, RecurrentState
from vhs.models.device import pick_device, to_device
from vhs.models.discriminative import DiscriminativeAgent
from vhs.models.extractor import FeatureExtractor

__all__ = [
    "DiscriminativeAgent",
    "FeatureExtractor",
    "GoalAgent",
    "RecurrentState",
    "pick_device",
    "to_device",
]
