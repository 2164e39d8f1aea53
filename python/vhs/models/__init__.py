"""The networks: feature extractor f and the recurrent, goal-gated agent."""

from vhs.models.agent import GoalAgent, RecurrentState
from vhs.models.extractor import FeatureExtractor

__all__ = ["FeatureExtractor", "GoalAgent", "RecurrentState"]
