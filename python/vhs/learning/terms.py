"""Terms: the named losses that methods are made of, each a function over what one forward pass gives.

A term has its name in the log (``loss/policy``). `vhs.learning.methods` says which method has which,
`Learner` sums them by their weights. A new one is an entry of `TERMS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBatch, discounted_returns
from vhs.config import MethodSection, TrainSection
from vhs.losses import (
    ActorCriticTerms,
    ImitationTerms,
    actor_critic_loss,
    goal_discrimination_loss,
    hindsight_imitation_loss,
    imitation_loss,
    lambda_returns,
    localisation_loss,
    memory_loss,
    supcon_loss,
)
from vhs.models import ActionHead, DiscriminativeAgent, GoalAgent, to_device

Over = Literal["lived", "relabelled", "replayed", "images", "reached", "remembered"]
"""What a term is over: episodes as lived, relabelled ones, those of the past under what they reached, goal
images, views of what was reached, what is remembered on the way to it."""

_Found = TypeVar("_Found")


@dataclass(frozen=True)
class Episodes:
    """What the agent makes of B episodes of up to T steps, under one goal each, and what they did."""

    rows: NDArray[np.int64]
    """Which episodes of the batch, shape [B]."""
    head: ActionHead
    policy: Tensor
    """pi, as parameters of `head`, shape [B, T, head.size]."""
    values: Tensor
    """V, shape [B, T]."""
    hidden: Tensor
    """The LSTM's hidden state, shape [B, T, hidden_dim]."""
    actions: Tensor
    """Taken, int64 [B, T], or float32 [B, T, dim]."""
    valid: Tensor
    """1 at the steps that terms are over, 0 at others and after the end, shape [B, T]."""
    beyond: Tensor | None = None
    """V of the last observation of each episode that a limit cut off, 0 of one that ended, shape [B]; None
    where all ended."""

    @cached_property
    def taken(self) -> Tensor:
        """The actions' log pi, in nats, shape [B, T]."""
        return self.head.log_prob(self.policy, self.actions)

    @cached_property
    def entropy(self) -> Tensor:
        """Of pi, in nats, shape [B, T]."""
        return self.head.entropy(self.policy)


class Images(NamedTuple):
    """Goal images of an update: f(o), shape [n, feature_dim], and classes, int64 [n]."""

    features: Tensor
    labels: Tensor


class Reached(NamedTuple):
    """R episodes that reached something, of up to T steps, and where it lay."""

    features: Tensor
    """f(o), shape [R, T, feature_dim]."""
    labels: Tensor
    """Class of what was reached, int64 [R]."""
    bearings_rad: Tensor
    """Where it lay by dead reckoning, 0 straight ahead, shape [R, T]."""
    valid: Tensor
    """1 inside the episode, 0 after its end, shape [R, T]."""


class Remembered(NamedTuple):
    """R episodes under the goal that they reached, of up to T steps, and where it lay."""

    hidden: Tensor
    """The LSTM's hidden state, shape [R, T, hidden_dim]."""
    bearings_rad: Tensor
    """Where the goal lay by dead reckoning, 0 straight ahead, shape [R, T]."""
    valid: Tensor
    """1 inside the episode, 0 after its end, shape [R, T]."""


@dataclass(frozen=True)
class Forward:
    """What one forward pass of an agent over its share of an update gives; what no term reads is None."""

    agent: GoalAgent
    batch: EpisodeBatch
    """Episodes that have just ended, and behind them those that are replayed."""
    num_ended: int
    ends: NDArray[np.int64]
    """Steps of each episode until it reached what it is relabelled to, shape [B]."""
    lived: Episodes | None
    """Every episode, under its instruction."""
    relabelled: Episodes | None
    """Some episodes again, under what they reached; None also where nothing was relabelled."""
    replayed: Episodes | None
    """Kept episodes under what they reached; None also until there are some."""
    images: Images | None
    """None also until the store is warm."""
    reached: Reached | None
    """None also where no episode reached anything whose class is known."""
    remembered: Remembered | None
    """None also where no episode was told what it reached."""
    method: MethodSection
    train: TrainSection
    success_reward: float
    """What the environment pays for the last step of a success, unscaled."""

    @property
    def gamma(self) -> float:
        """The discount, once the task is known."""
        assert self.train.gamma is not None, "a settled configuration"
        return self.train.gamma

    @cached_property
    def steps(self) -> Tensor:
        """Steps of the share's episodes that have just ended, shape []."""
        return self.tensor(self.batch.mask[: self.num_ended]).float().sum()

    @cached_property
    def actor_critic(self) -> ActorCriticTerms:
        """L_RL on the episodes as they were lived, term by term."""
        lived = _there(self.lived)
        returns = lambda_returns(
            self.tensor(self.batch.rewards[: self.num_ended]) * self.train.reward_scale,
            lived.values,
            lived.valid,
            self.gamma,
            self.train.return_lambda,
            lived.beyond,
        )
        return actor_critic_loss(lived.taken, lived.entropy, lived.values, returns, lived.valid)

    @cached_property
    def imitation(self) -> ImitationTerms:
        """L_VHS on the relabelled episodes, term by term."""
        relabelled = _there(self.relabelled)
        targets = hindsight_values(
            self.batch,
            self.ends,
            self.method.value_target,
            success_reward=self.success_reward,
            reward_scale=self.train.reward_scale,
            gamma=self.gamma,
        )
        return hindsight_imitation_loss(
            relabelled.taken,
            relabelled.values,
            self.tensor(targets[relabelled.rows]),
            relabelled.valid,
            self.steps,
            self.method.hindsight_discount,
        )

    @cached_property
    def replay(self) -> Tensor:
        """Kept episodes imitated again; what the critic thought of them then is stale and left out."""
        again = _there(self.replayed)
        return imitation_loss(again.taken, again.valid, self.steps, self.method.hindsight_discount)

    def tensor(self, array: NDArray[np.generic]) -> Tensor:
        """An array on the device of the agent."""
        return to_device(array, self.agent.gate.weight.device)


class Term(NamedTuple):
    """A loss of a method."""

    loss: Callable[[Forward], Tensor]
    """Unweighted, as it is logged; shape []."""
    over: Over
    """The part of the pass that it reads, which is there when `loss` is called. Where nothing was relabelled,
    reached or kept the term is 0; without images there is none yet."""
    weight: str | float = 1.0
    """A number, or a key of the configuration, which moves to ``<key>_end`` over training if there is one."""
    sign: Literal[1, -1] = 1
    """-1 where more is better."""


def hindsight_values(
    batch: EpisodeBatch,
    ends: NDArray[np.int64],
    target: str,
    *,
    success_reward: float,
    reward_scale: float,
    gamma: float,
) -> NDArray[np.float32]:
    """The target v_i of the hindsight value.

    Args:
        batch: the episodes.
        ends: steps of each until it reached what it is relabelled to, shape [B].
        target: "behaviour" for the critic's value when acting (paper), "hindsight_return" for the discounted
            return as if each episode had succeeded there.
        success_reward: of the last step of a success, unscaled.
        reward_scale: factor on rewards.
        gamma: discount a step.

    Returns:
        Shape [B, T].
    """
    if target == "behaviour":
        return batch.values
    rewards = batch.rewards.copy()
    rewards[np.arange(len(rewards)), ends - 1] = success_reward
    return discounted_returns(rewards * reward_scale, ends, gamma)


def _supcon(x: Forward) -> Tensor:
    images = _there(x.images)
    return supcon_loss(images.features, images.labels, x.method.supcon_temperature)


def _discriminator(x: Forward) -> Tensor:
    images = _there(x.images)
    assert isinstance(x.agent, DiscriminativeAgent)
    return goal_discrimination_loss(x.agent.discriminate(images.features), images.labels)


def _localise(x: Forward) -> Tensor:
    reached, method = _there(x.reached), x.method
    return localisation_loss(
        x.agent.see(reached.features),
        reached.labels,
        reached.bearings_rad,
        reached.valid,
        math.radians(method.localisation_in_view_deg),
        math.radians(method.localisation_out_of_view_deg),
    )


def _remember(x: Forward) -> Tensor:
    kept = _there(x.remembered)
    return memory_loss(x.agent.recall(kept.hidden), kept.bearings_rad, kept.valid)


def _there(part: _Found | None) -> _Found:
    assert part is not None, "a term reads another part than it says"
    return part


TERMS: dict[str, Term] = {
    "policy": Term(lambda x: x.actor_critic.policy, "lived"),
    "value": Term(lambda x: x.actor_critic.value, "lived", "train.value_weight"),
    "entropy": Term(lambda x: x.actor_critic.entropy, "lived", "train.entropy_weight", sign=-1),
    "imitation_policy": Term(lambda x: x.imitation.policy, "relabelled", "method.vhs_weight"),
    "imitation_value": Term(lambda x: x.imitation.value, "relabelled", "method.vhs_weight"),
    "replay": Term(lambda x: x.replay, "replayed", "method.vhs_weight"),
    "localise": Term(_localise, "reached", "method.localisation_weight"),
    "remember": Term(_remember, "remembered", "method.memory_weight"),
    "supcon": Term(_supcon, "images", "method.supcon_weight"),
    "discriminator": Term(_discriminator, "images", "method.discriminator_weight"),
}
