"""GDAN's agent: a goal-discriminator whose hidden layer asks the policy's attention (Kim et al. 2021).

"Goal-Aware Cross-Entropy for Multi-Target Reinforcement Learning": key and value come from the gated features
and the LSTM, the query from the discriminator, and attention is a gate a number, not a weight a place.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from vhs.models.agent import GoalAgent
from vhs.models.extractor import Extractor


class DiscriminativeAgent(GoalAgent):
    """A goal-gated agent whose heads read its LSTM and what the goal-discriminator attends to.

    Actor and critic read the query as a constant: the discriminator is trained by its own loss alone.
    """

    by_class = (*GoalAgent.by_class, "classify.")

    def __init__(self, extractor: Extractor, *, num_goals: int, hidden_dim: int, **kwargs: Any) -> None:
        """Build the layers behind `extractor` for `num_goals` classes; `kwargs` as for `GoalAgent`."""
        super().__init__(extractor, hidden_dim=hidden_dim, **kwargs)
        feature_dim = extractor.feature_dim
        self.recognise = nn.Sequential(nn.Linear(feature_dim, hidden_dim), nn.ReLU())
        self.classify = nn.Linear(hidden_dim, num_goals)
        self.memory = nn.Sequential(nn.Linear(feature_dim + hidden_dim, 2 * hidden_dim), nn.ReLU())
        self.query = nn.Sequential(nn.Linear(hidden_dim, hidden_dim), nn.ReLU())
        self.key = nn.Sequential(nn.Linear(hidden_dim, hidden_dim), nn.ReLU())
        self.fuse = nn.Sequential(nn.Linear(2 * hidden_dim, hidden_dim), nn.LayerNorm(hidden_dim), nn.Tanh())

    def discriminate(self, features: Tensor) -> Tensor:
        """Unnormalised log-probabilities of the goal classes, shape [..., num_goals], from f(o)."""
        logits: Tensor = self.classify(self.recognise(features))
        return logits

    def _attend(self, features: Tensor, gated: Tensor, hidden: Tensor) -> Tensor:
        """tanh(query + key) * value beside the LSTM's hidden state, fused to its size and its range.

        Norm and tanh help: `value` has no bound, and with a ReLU here, or without the norm, the policy became
        deterministic within a few hundred episodes and learned nothing more; with both it still did so once
        at a learning rate of 5e-4, hence the method's own (`vhs.learning.methods`).
        """
        query = self.recognise(features).detach()
        key, value = self.memory(torch.cat([gated, hidden], dim=-1)).chunk(2, dim=-1)
        attended = torch.tanh(self.query(query) + self.key(key)) * value
        fused: Tensor = self.fuse(torch.cat([attended, hidden], dim=-1))
        return fused
