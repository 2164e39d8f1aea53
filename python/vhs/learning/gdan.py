"""GDAN: actor-critic under goal words, with a goal-discriminator trained on the goal store.

After Kim et al. 2021, "Goal-Aware Cross-Entropy for Multi-Target Reinforcement Learning".
"""

from __future__ import annotations

from torch import Tensor

from vhs.learning.learner import VHS
from vhs.losses import goal_discrimination_loss
from vhs.models import DiscriminativeAgent, GoalAgent


class GDAN(VHS):
    """A3C whose extractor also learns to tell the stored goal images apart; its agent attends by that."""

    def _goal_terms(self, agent: GoalAgent, features: Tensor, labels: Tensor) -> dict[str, Tensor]:
        """The discriminator's cross-entropy, in place of SupCon."""
        assert isinstance(agent, DiscriminativeAgent)
        return {"discriminator": goal_discrimination_loss(agent.discriminate(features), labels)}
