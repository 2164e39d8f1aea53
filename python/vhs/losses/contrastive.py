"""The goal-aware supervised contrastive loss: paper Eq. 3, after Khosla et al. 2020 (SupCon, L_out)."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize

from vhs.losses.shapes import check_shape


def supcon_loss(features: Tensor, labels: Tensor, temperature: float) -> Tensor:
    """Pull goal features of one class together and push those of other classes apart.

    Eq. 3 sums over the anchors j of the batch; this is their mean, as in Khosla et al., so that the weight of
    the loss does not depend on the size of the batch. An anchor without a positive is left out.

    Args:
        features: g_j = f(o_j), any scale: they are L2-normalised here, shape [N, D].
        labels: goal class of each image, int64, shape [N].
        temperature: tau_s, above 0.

    Returns:
        Mean over the anchors that have a positive, shape []; 0 when no anchor has one.

    Raises:
        ShapeError: the tensors do not fit together.
    """
    check_shape("N D", features=features)
    check_shape("N", features=features[:, 0], labels=labels)
    unit = normalize(features, dim=1)
    self_pair = torch.eye(len(labels), dtype=torch.bool, device=labels.device)
    similarity = (unit @ unit.T / temperature).masked_fill(self_pair, -torch.inf)
    log_share = similarity - similarity.logsumexp(dim=1, keepdim=True)
    positive = (labels.unsqueeze(0) == labels.unsqueeze(1)) & ~self_pair
    positives = positive.sum(dim=1)
    per_anchor = -log_share.masked_fill(~positive, 0.0).sum(dim=1) / positives.clamp(min=1)
    anchors = positives > 0
    return (per_anchor * anchors).sum() / anchors.sum().clamp(min=1)
