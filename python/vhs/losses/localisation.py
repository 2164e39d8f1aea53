"""Hindsight localisation: where what was reached had been all the time, learned from afterwards.

`localisation_loss` teaches it to the extractor, by views; `memory_loss` to the memory, by hidden states.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from vhs.losses.shapes import check_shape


def localisation_loss(
    logits: Tensor,
    labels: Tensor,
    bearings_rad: Tensor,
    valid: Tensor,
    in_view_rad: float,
    out_of_view_rad: float,
) -> Tensor:
    """Tell whether what an episode reached in the end is in view at each of its steps.

    Between the two angles neither answer is right: a thing at the edge of the picture is cut, and dead
    reckoning is off by a few degrees. Of the other classes nothing is known, so nothing is said.

    Args:
        logits: log-odds that each class is in view, shape [B, T, C].
        labels: class that each episode reached, int64, shape [B].
        bearings_rad: where it lay, 0 straight ahead, shape [B, T].
        valid: 1 inside the episode, 0 after its end, shape [B, T].
        in_view_rad: bearings of less, to either side, are in view.
        out_of_view_rad: bearings of more are not.

    Returns:
        Binary cross-entropy in nats, the mean over the steps that have an answer, shape []; 0 of none. A step
        weighs more where few episodes reach something, unlike an imitated one: it says what things look like,
        as goal images do, and that is needed most at first.

    Raises:
        ShapeError: the tensors do not fit together.
    """
    check_shape("B T C", logits=logits)
    check_shape("B T", logits=logits[..., 0], bearings_rad=bearings_rad, valid=valid)
    check_shape("B", bearings_rad=bearings_rad[:, 0], labels=labels)
    own = logits.gather(-1, labels.view(-1, 1, 1).expand(-1, logits.shape[1], 1)).squeeze(-1)
    aside = bearings_rad.abs()
    is_seen = aside < in_view_rad
    counted = valid * (is_seen | (aside > out_of_view_rad))
    surprise = binary_cross_entropy_with_logits(own, is_seen.to(own.dtype), reduction="none")
    return (surprise * counted).sum() / counted.sum().clamp(min=1)


def memory_loss(logits: Tensor, bearings_rad: Tensor, valid: Tensor) -> Tensor:
    """Tell from the memory in which direction lies what an episode reached in the end, seen or not.

    What has been in view has to be kept for it, and turned with every turn.

    Args:
        logits: unnormalised log-probabilities of S equal sectors, the first around straight ahead and the
            next to its left, shape [B, T, S].
        bearings_rad: where it lay, 0 straight ahead and positive to the left, shape [B, T].
        valid: 1 inside the episode, 0 after its end, shape [B, T].

    Returns:
        Cross-entropy in nats, the mean over the valid steps, shape []; 0 of none.

    Raises:
        ShapeError: the tensors do not fit together.
    """
    check_shape("B T S", logits=logits)
    check_shape("B T", logits=logits[..., 0], bearings_rad=bearings_rad, valid=valid)
    sectors = logits.shape[-1]
    lies = torch.round(bearings_rad * (sectors / math.tau)).long() % sectors
    surprise = cross_entropy(logits.flatten(0, 1), lies.flatten(), reduction="none").view_as(valid)
    return (surprise * valid).sum() / valid.sum().clamp(min=1)
