"""The advantage actor-critic loss: paper Eq. 1 and 2, after Mnih et al. 2016 (A3C)."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from vhs.losses.shapes import check_shape


class ActorCriticTerms(NamedTuple):
    """The three terms, each a mean over the valid steps, shape []."""

    policy: Tensor
    value: Tensor
    entropy: Tensor


def actor_critic_loss(
    taken: Tensor, entropy: Tensor, values: Tensor, returns: Tensor, valid: Tensor
) -> ActorCriticTerms:
    """Policy gradient with the advantage R_t - V, squared value error, policy entropy.

    Args:
        taken: log pi(a_t | o_t, x, k) of what was done, in nats, shape [B, T].
        entropy: H(pi(. | o_t, x, k)) in nats, shape [B, T].
        values: V(o_t | x, k), shape [B, T]; a constant in the policy term.
        returns: R_t, discounted or lambda-returns from t on, shape [B, T].
        valid: 1 inside the episode, 0 after its end, shape [B, T].

    Returns:
        -log pi(a_t) (R_t - V_t), (R_t - V_t)^2 and the entropy H(pi), unweighted; the caller subtracts the
        entropy.

    Raises:
        ShapeError: the tensors do not fit together.
    """
    check_shape("B T", taken=taken, entropy=entropy, values=values, returns=returns, valid=valid)
    steps = valid.sum().clamp(min=1)
    advantage = returns - values
    taken = taken.masked_fill(valid == 0, 0.0)  # after the end stands anything, impossible actions too
    return ActorCriticTerms(
        policy=-(taken * advantage.detach() * valid).sum() / steps,
        value=(advantage.square() * valid).sum() / steps,
        entropy=(entropy * valid).sum() / steps,
    )
