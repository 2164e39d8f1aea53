"""A pull towards the uniform policy that does not fade where the policy has made up its mind."""

from __future__ import annotations

import math

from torch import Tensor

from vhs.losses.shapes import check_shape


def policy_spread_loss(log_probs: Tensor, valid: Tensor) -> Tensor:
    """KL(uniform || pi): the mean of -log pi over the actions, less log A.

    The gradient of -log pi(a) with respect to a logit is pi(a) - [a]: the policy gradient and that of the
    entropy both vanish with the probability of an action, so an action that has died out never comes back,
    however bad its rivals turn out to be. Here the pull on each logit is pi(a) - 1/A, whatever pi is.

    Args:
        log_probs: log pi(. | o_t, x, k) in nats, shape [B, T, A].
        valid: 1 inside the episode, 0 after its end, shape [B, T].

    Returns:
        Mean over the valid steps, in nats, at least 0, shape [].

    Raises:
        ShapeError: the tensors do not fit together.
    """
    check_shape("B T A", log_probs=log_probs)
    check_shape("B T", log_probs=log_probs[..., 0], valid=valid)
    divergence = -log_probs.mean(-1) - math.log(log_probs.shape[-1])
    return (divergence * valid).sum() / valid.sum().clamp(min=1)
