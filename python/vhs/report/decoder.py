"""What a feature looks like: a small decoder from f(o) back to the newest frame of o.

It is trained on the stored goal images for a few seconds, with the extractor as it is, and then shown the
prototypes (paper, figure "Visualization of prototypical goals", where a variational decoder is trained along
with the agent).
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import interpolate, l1_loss

STEPS = 500
"""Optimiser steps: about ten seconds on one core."""
_BATCH = 32
_CHANNELS = (64, 48, 32, 16)


class Decoder(nn.Module):
    """A linear layer to 1/8 of the picture's size, then three times: enlarge, convolve."""

    def __init__(self, feature_dim: int, height: int, width: int) -> None:
        """Build the layers for pictures of `height` x `width` pixels."""
        super().__init__()
        self.size = (height, width)
        self.small = (-(-height // 8), -(-width // 8))
        self.project = nn.Linear(feature_dim, _CHANNELS[0] * self.small[0] * self.small[1])
        self.convolutions = nn.ModuleList(
            nn.Conv2d(inputs, outputs, 3, padding=1)
            for inputs, outputs in zip(_CHANNELS, (*_CHANNELS[1:], 3), strict=True)
        )

    def forward(self, features: Tensor) -> Tensor:
        """Features [N, feature_dim] to pictures in 0..1, [N, 3, height, width]."""
        planes = self.project(features).unflatten(1, (_CHANNELS[0], *self.small))
        for number, convolution in enumerate(self.convolutions):
            if number:
                planes = interpolate(planes.relu(), scale_factor=2.0)
            planes = convolution(planes)
        return planes[:, :, : self.size[0], : self.size[1]].sigmoid()


def decode(
    features: NDArray[np.float32], frames: NDArray[np.uint8], wanted: NDArray[np.float32], seed: int = 0
) -> NDArray[np.uint8]:
    """Train a decoder on images and decode features with it.

    Args:
        features: f of the images, shape [N, feature_dim].
        frames: the images, uint8, shape [N, height, width, 3].
        wanted: features to decode, shape [M, feature_dim].
        seed: of the weights and batches; same seed, same pictures.

    Returns:
        Pictures, uint8, shape [M, height, width, 3].
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        decoder = Decoder(features.shape[1], *frames.shape[1:3])
    generator = torch.Generator().manual_seed(seed)
    inputs = torch.from_numpy(features)
    pictures = torch.from_numpy(frames).permute(0, 3, 1, 2)
    optimiser = torch.optim.Adam(decoder.parameters(), lr=2e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 4e-3, total_steps=STEPS)
    for _ in range(STEPS):
        rows = torch.randint(len(inputs), (_BATCH,), generator=generator)
        # The absolute error, because the squared one blurs a small bright object away.
        loss = l1_loss(decoder(inputs[rows]), pictures[rows].float() / 255)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    with torch.inference_mode():
        decoded = decoder(torch.from_numpy(wanted)).permute(0, 2, 3, 1)
    picture: NDArray[np.uint8] = (decoded * 255).round().to(torch.uint8).contiguous().numpy()
    return picture
