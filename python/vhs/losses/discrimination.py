"""The goal-aware cross-entropy loss of GDAN, after Kim et al. 2021 ("Goal-Aware Cross-Entropy")."""

from __future__ import annotations

from torch import Tensor
from torch.nn.functional import cross_entropy

from vhs.losses.shapes import check_shape


def goal_discrimination_loss(logits: Tensor, labels: Tensor) -> Tensor:
    """Tell the goal class of a goal image.

    Args:
        logits: unnormalised log-probabilities of the classes, shape [N, classes].
        labels: goal class of each image, int64, shape [N].

    Returns:
        -log p(label) in nats, the mean over the images, shape []; 0 of none.

    Raises:
        ShapeError: the tensors do not fit together.
    """
    check_shape("N C", logits=logits)
    check_shape("N", logits=logits[:, 0], labels=labels)
    return cross_entropy(logits, labels, reduction="sum") / max(len(labels), 1)
