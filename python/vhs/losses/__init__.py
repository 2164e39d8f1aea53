"""Losses as formulas: tensors in, tensors out, no configuration."""

from vhs.losses.actor_critic import ActorCriticTerms, actor_critic_loss
from vhs.losses.contrastive import supcon_loss
from vhs.losses.discrimination import goal_discrimination_loss
from vhs.losses.imitation import ImitationTerms, hindsight_imitation_loss, imitation_loss
from vhs.losses.localisation import localisation_loss, memory_loss
from vhs.losses.returns import lambda_returns

__all__ = [
    "ActorCriticTerms",
    "ImitationTerms",
    "actor_critic_loss",
    "goal_discrimination_loss",
    "hindsight_imitation_loss",
    "imitation_loss",
    "lambda_returns",
    "localisation_loss",
    "memory_loss",
    "supcon_loss",
]
