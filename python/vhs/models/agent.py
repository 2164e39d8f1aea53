"""The agent: features gated by a goal embedding, an LSTM, a policy head and a value head.

Gated attention after Chaplot et al. 2018; the interaction embedding enters before and after the LSTM (paper,
appendix "Implementation Details"). A goal is a vector, whoever made it: a prototype or a learned word when
acting, f(o_T) in hindsight.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple, Self

import torch
from torch import Tensor, nn
from torch.nn.functional import layer_norm

from vhs.models.extractor import Extractor
from vhs.models.heads import ActionHead


class RecurrentState(NamedTuple):
    """LSTM state, each of shape [B, hidden_dim]."""

    hidden: Tensor
    cell: Tensor


class AgentOutput(NamedTuple):
    """What an agent makes of sequences of observations, each under one goal."""

    policy: Tensor
    """pi, as parameters of the agent's head, shape [B, T, head.size]."""
    values: Tensor
    """V, shape [B, T]."""
    hidden: Tensor
    """The LSTM's hidden state after each observation, shape [B, T, hidden_dim]."""
    state: RecurrentState
    """After the last step."""


BEARINGS = 8
"""Sectors of the directions that `GoalAgent.recall` tells apart, the first around straight ahead."""


class GoalAgent(nn.Module):
    """pi(a | o, goal, interaction) and V(o | goal, interaction) over a shared extractor and LSTM."""

    by_class: ClassVar[tuple[str, ...]] = ("words.", "sight.2.")
    """How the names of those weights begin that have a row a goal class."""
    aside: ClassVar[tuple[str, ...]] = ("sight.", "bearing.")
    """How the names of those begin that acting does not read, and that an agent may lack."""

    def __init__(
        self,
        extractor: Extractor,
        *,
        head: ActionHead,
        num_interactions: int,
        hidden_dim: int,
        head_dim: int,
        interaction_dim: int,
        num_words: int = 0,
        num_sights: int = 0,
        recalls: bool = False,
        goal_dim: int = 0,
        beside_dim: int = 0,
    ) -> None:
        """Build the layers behind `extractor`.

        Args:
            extractor: f.
            head: What actions are.
            num_interactions: Interactions that can be instructed, at least 1.
            hidden_dim: Of the LSTM.
            head_dim: Hidden layer of each head, and of what embeds goal vectors.
            interaction_dim: Of an interaction's embedding.
            num_words: Goal classes with a learned name; 0 where classes are named otherwise.
            num_sights: Goal classes that `see` tells from a view; 0: no such head.
            recalls: Whether `recall` tells from the LSTM's hidden state in which direction the goal lies.
            goal_dim: Numbers in a goal vector; 0 where goals are no vectors.
            beside_dim: Numbers that an observation has beside its frame; 0: none.
        """
        super().__init__()
        feature_dim = extractor.feature_dim
        self.hidden_dim = hidden_dim
        self.extractor = extractor
        self.gate = nn.Linear(feature_dim, feature_dim)
        self.interaction = nn.Embedding(num_interactions, interaction_dim)
        self.beside_dim = beside_dim
        known = 2 * feature_dim + interaction_dim + (head_dim if beside_dim else 0)
        self.lstm = nn.LSTM(known, hidden_dim, batch_first=True)
        self.head = head
        self.policy = _head(hidden_dim + interaction_dim, head_dim, head.size)
        self.value = _head(hidden_dim + interaction_dim, head_dim, 1)
        # N(0, 1), the scale of features and of the vectors of empty classes.
        self.words = nn.Embedding(num_words, feature_dim) if num_words else None
        self.vectors = _perceptron(goal_dim, head_dim, feature_dim) if goal_dim else None
        # Last: the weights before it are the same with and without it.
        self.sight = _head(feature_dim, head_dim, num_sights) if num_sights else None
        self.bearing = _head(hidden_dim, head_dim, BEARINGS) if recalls else None
        self.beside = nn.Sequential(nn.Linear(beside_dim, head_dim), nn.ReLU()) if beside_dim else None

    def train(self, mode: bool = True) -> Self:
        """Turn to learning, or to acting; `eval` comes here too.

        Training turns at every update and is told at every step, and a walk over all modules takes a fifth of
        the time of acting.
        """
        return self if mode == self.training else super().train(mode)

    def initial_state(self, batch: int) -> RecurrentState:
        """The state at the start of an episode: zeros, shape [batch, hidden_dim]."""
        zeros = self.gate.weight.new_zeros(batch, self.hidden_dim)
        return RecurrentState(zeros, zeros.clone())

    def forward(
        self,
        features: Tensor,
        goals: Tensor,
        interactions: Tensor,
        state: RecurrentState | None = None,
        beside: Tensor | None = None,
    ) -> AgentOutput:
        """Run sequences of features under one goal each.

        Args:
            features: f(o_t), shape [B, T, feature_dim].
            goals: goal embedding of each sequence, shape [B, feature_dim].
            interactions: instructed interaction of each sequence, int64, shape [B].
            state: state before the first step; zeros when None.
            beside: what observations have beside their frames, float32 [B, T, beside_dim]; goals are told by
                frames alone, so the memory reads it, not f. None where they have nothing.
        """
        steps = features.shape[1]
        gate = torch.sigmoid(self.gate(goals)).unsqueeze(1)
        kind = self.interaction(interactions).unsqueeze(1).expand(-1, steps, -1)
        gated = features * gate
        known = [gated, gate.expand(-1, steps, -1), kind]
        if self.beside is not None:
            assert beside is not None, "what observations have beside their frames"
            known.append(self.beside(beside))
        inputs = torch.cat(known, dim=-1)
        hidden, last = self._remember(inputs, state)
        joined = torch.cat([self._attend(features, gated, hidden), kind], dim=-1)
        policy = self.head.parameters(self.policy(joined))
        values = self.value(joined).squeeze(-1)
        return AgentOutput(policy, values, hidden, last)

    def embed_vectors(self, goals: Tensor) -> Tensor:
        """Goal vectors, float32 [n, goal_dim], as goal embeddings at the scale of features."""
        assert self.vectors is not None, "an agent that was built with goal vectors"
        found: Tensor = self.vectors(goals)
        return layer_norm(found, found.shape[1:])

    def see(self, features: Tensor) -> Tensor:
        """Unnormalised log-odds that each goal class is in view, shape [..., num_sights], from f(o)."""
        assert self.sight is not None, "an agent that was built to see"
        logits: Tensor = self.sight(features)
        return logits

    def recall(self, hidden: Tensor) -> Tensor:
        """Unnormalised log-probabilities of where the goal lies, [..., BEARINGS], from hidden states."""
        assert self.bearing is not None, "an agent that was built to recall"
        logits: Tensor = self.bearing(hidden)
        return logits

    def _attend(self, features: Tensor, gated: Tensor, hidden: Tensor) -> Tensor:
        """What the heads read of a step, shape [B, T, hidden_dim]: here the LSTM's hidden state."""
        return hidden

    def _remember(self, inputs: Tensor, state: RecurrentState | None) -> tuple[Tensor, RecurrentState]:
        """The LSTM: its hidden states, shape [B, T, hidden_dim], and the state after the last step."""
        if state is not None and inputs.shape[1] == 1:
            # Acting: one step of a sequence packs all weights anew on every call, a cell does not.
            hidden, cell = torch.lstm_cell(inputs[:, 0], state, *self.lstm.all_weights[0])
            return hidden.unsqueeze(1), RecurrentState(hidden, cell)
        before = None if state is None else (state.hidden.unsqueeze(0), state.cell.unsqueeze(0))
        hidden, (last_hidden, last_cell) = self.lstm(inputs, before)
        return hidden, RecurrentState(last_hidden[0], last_cell[0])


def _head(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    """A 2-layer perceptron whose last layer starts small: a uniform policy and a value of 0."""
    last = nn.Linear(hidden, outputs)
    nn.init.orthogonal_(last.weight, 0.01)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), last)


def _perceptron(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, outputs))
