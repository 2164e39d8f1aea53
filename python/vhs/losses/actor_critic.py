"""The advantage actor-critic loss: paper Eq. 1 and 2, after Mnih et al. 2016 (A3C)."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor, finfo
from torch.distributions.utils import logits_to_probs

from vhs.losses.shapes import check_shape, log_prob_of


class ActorCriticTerms(NamedTuple):
    """The three terms, each a mean over the valid steps, shape []."""

    policy: Tensor
    value: Tensor
    entropy: Tensor


def actor_critic_loss(
    log_probs: Tensor, actions: Tensor, values: Tensor, returns: Tensor, valid: Tensor
) -> ActorCriticTerms:
    """Policy gradient with the advantage R_t - V, squared value error, policy entropy.

    Args:
        log_probs: log pi(. | o_t, x, k) in nats, shape [B, T, A]; -inf of what cannot be done.
        actions: a_t, int64, shape [B, T].
        values: V(o_t | x, k), shape [B, T]; a constant in the policy term.
        returns: R_t, discounted or lambda-returns from t on, shape [B, T].
        valid: 1 inside the episode, 0 after its end, shape [B, T].

    Returns:
        -log pi(a_t) (R_t - V_t), (R_t - V_t)^2 and the entropy H(pi), unweighted; the caller subtracts the
        entropy.

    Raises:
        ShapeError: the tensors do not fit together.
    """
    check_shape("B T A", log_probs=log_probs)
    check_shape(
        "B T", log_probs=log_probs[..., 0], actions=actions, values=values, returns=returns, valid=valid
    )
    steps = valid.sum().clamp(min=1)
    advantage = returns - values
    taken = log_prob_of(log_probs, actions, valid)
    # p log p of an impossible action is 0, its limit, and not 0 times minus infinity.
    entropy = -(logits_to_probs(log_probs) * log_probs.clamp(min=finfo(log_probs.dtype).min)).sum(-1)
    return ActorCriticTerms(
        policy=-(taken * advantage.detach() * valid).sum() / steps,
        value=(advantage.square() * valid).sum() / steps,
        entropy=(entropy * valid).sum() / steps,
    )
