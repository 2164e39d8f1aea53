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
from torch.nn.functional import avg_pool2d, interpolate

STEPS = 300
"""Optimiser steps: a few seconds on one core."""
_BATCH = 32
_CHANNELS = (48, 32, 24)
_MOST_WEIGHT = 10.0
"""Of a pixel in the loss, where the mean is 1."""


class Decoder(nn.Module):
    """A linear layer to a quarter of the picture's size, then convolutions with enlargements between them."""

    def __init__(self, feature_dim: int, height: int, width: int) -> None:
        """Build the layers for pictures of `height` x `width` pixels, half those of a frame."""
        super().__init__()
        self.size = (height, width)
        self.small = (-(-height // 4), -(-width // 4))
        self.project = nn.Linear(feature_dim, _CHANNELS[0] * self.small[0] * self.small[1])
        self.convolutions = nn.ModuleList(
            nn.Conv2d(inputs, outputs, 3, padding=1)
            for inputs, outputs in zip(_CHANNELS, (*_CHANNELS[1:], 3), strict=True)
        )

    def forward(self, features: Tensor) -> Tensor:
        """Features [N, feature_dim] to departures from the mean picture, [N, 3, height, width]."""
        planes: Tensor = self.project(features).unflatten(1, (_CHANNELS[0], *self.small))
        for number, convolution in enumerate(self.convolutions):
            if number:
                planes = interpolate(planes.relu(), scale_factor=2.0)
            planes = convolution(planes)
        return planes[:, :, : self.size[0], : self.size[1]]


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
    # Half the size: what a prototype keeps of a picture is coarser than that.
    pictures = avg_pool2d(torch.from_numpy(frames).permute(0, 3, 1, 2).float() / 255, 2)
    mean_picture = pictures.mean(dim=0)
    # Features of all images are much alike; the decoder learns from how they differ.
    inputs = torch.from_numpy(features)
    mean, spread = inputs.mean(dim=0), inputs.std(dim=0, correction=0) + 1e-3
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        decoder = Decoder(features.shape[1], *pictures.shape[2:])
    _train(decoder, (inputs - mean) / spread, pictures - mean_picture, seed)
    with torch.inference_mode():
        decoded = decoder((torch.from_numpy(wanted) - mean) / spread) + mean_picture
        decoded = interpolate(decoded, size=frames.shape[1:3], mode="bilinear").permute(0, 2, 3, 1)
    picture: NDArray[np.uint8] = (decoded * 255).clamp(0, 255).to(torch.uint8).contiguous().numpy()
    return picture


def _train(decoder: Decoder, inputs: Tensor, pictures: Tensor, seed: int) -> None:
    """Fit pictures [N, 3, height, width] from inputs [N, feature_dim]."""
    generator = torch.Generator().manual_seed(seed)
    mean_square = pictures.square().sum(dim=1).mean()
    optimiser = torch.optim.Adam(decoder.parameters(), lr=3e-3)
    for _ in range(STEPS):
        rows = torch.randint(len(inputs), (_BATCH,), generator=generator)
        wanted = pictures[rows]
        # What stands out of the mean picture is the object: unweighted, only walls and floors would count.
        weight = (wanted.square().sum(dim=1, keepdim=True) / mean_square).clamp(max=_MOST_WEIGHT)
        loss = (weight * (decoder(inputs[rows]) - wanted).square()).mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
