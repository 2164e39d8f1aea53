"""The visual hindsight self-imitation loss: paper Eq. 5."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from vhs.losses.shapes import check_shape


class ImitationTerms(NamedTuple):
    """The two terms, each divided by the number of steps it is a mean over, shape []."""

    policy: Tensor
    value: Tensor


def hindsight_imitation_loss(
    taken: Tensor,
    values: Tensor,
    value_targets: Tensor,
    valid: Tensor,
    steps: Tensor,
    discount: float = 1.0,
) -> ImitationTerms:
    """Imitate the actions and values of episodes under the goal that they reached.

    Args:
        taken: log pi(a_i | o_i, f(o_T), a_T) of what was done, in nats, shape [B, T].
        values: V(o_i | f(o_T), a_T), shape [B, T].
        value_targets: v_i, shape [B, T]; a constant.
        valid: 1 inside the episode, 0 after its end, shape [B, T].
        steps: number of steps to divide by, shape []. The steps of *all* episodes of the update make a
            relabelled step weigh as much as a step of the RL loss, which is what the paper's update on one
            episode does.
        discount: weight of an action for each step between it and the end of its episode; 1 is Eq. 5.

    Returns:
        -log pi(a_i), discounted, and (V_i - v_i)^2, summed over the valid steps and divided by `steps`.

    Raises:
        ShapeError: the tensors do not fit together.
    """
    check_shape("B T", taken=taken, values=values, value_targets=value_targets, valid=valid)
    error = values - value_targets.detach()
    return ImitationTerms(
        policy=imitation_loss(taken, valid, steps, discount),
        value=(error.square() * valid).sum() / steps.clamp(min=1),
    )


def imitation_loss(taken: Tensor, valid: Tensor, steps: Tensor, discount: float = 1.0) -> Tensor:
    """Imitate the actions of episodes under the goal that they reached: the first half of Eq. 5.

    Args:
        taken: log pi of what was done, in nats, shape [B, T].
        valid: 1 inside the episode, 0 after its end, shape [B, T].
        steps: number of steps to divide by, shape [].
        discount: weight of an action for each step between it and the end of its episode.

    Returns:
        -log pi(a_i), discounted, summed over the valid steps and divided by `steps`, shape [].

    Raises:
        ShapeError: the tensors do not fit together.
    """
    check_shape("B T", taken=taken, valid=valid)
    taken = taken.masked_fill(valid == 0, 0.0)  # after the end stands anything, impossible actions too
    remaining = (valid.sum(dim=1, keepdim=True) - valid.cumsum(dim=1)).clamp(min=0)
    return -(taken * valid * discount**remaining).sum() / steps.clamp(min=1)
