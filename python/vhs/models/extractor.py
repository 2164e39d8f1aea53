"""The feature extractor f: stacked frames to a feature vector (paper, appendix "Implementation Details").

Batch norm uses the statistics of the batch when learning and running statistics when acting;
docs/paper-notes.md says why f(o_T) and the prototypes agree all the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import layer_norm

from vhs._core import ShapeError


class FeatureExtractor(nn.Module):
    """Four convolutions (kernel 3, stride 2, padding 1) with batch norm and ReLU, then a linear layer.

    Pixels go in as integers in -128..127: bfloat16 holds them exactly, and the batch norm behind the first
    convolution makes f blind to their scale, so dividing would only cost time. Centring them matters: with
    raw 0..255 the mean of the first layer moves faster than its running mean follows, and the policy that
    acts drifts from the one that learns.

    The features end in a layer norm without parameters: f(o), a prototype and the N(0, 1) vector of an empty
    class enter the policy at one scale, and no loss can make features grow until the gates saturate.
    """

    def __init__(
        self, frame_shape: Sequence[int], frame_stack: int, channels: Sequence[int], feature_dim: int
    ) -> None:
        """Build the layers for frames of `frame_shape` = (height, width, colours)."""
        super().__init__()
        height, width, colours = frame_shape
        self.observation_shape = (frame_stack, height, width, colours)
        layers: list[nn.Module] = []
        inputs = frame_stack * colours
        for outputs in channels:
            layers += [
                nn.Conv2d(inputs, outputs, 3, stride=2, padding=1, bias=False),
                nn.BatchNorm2d(outputs),
                nn.ReLU(),
            ]
            inputs, height, width = outputs, (height + 1) // 2, (width + 1) // 2
        self.convolutions = nn.Sequential(*layers).to(memory_format=torch.channels_last)
        self.project = nn.Linear(inputs * height * width, feature_dim)

    def forward(self, observations: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        """Embed observations.

        Args:
            observations: uint8, shape [N, stack, height, width, colours].
            dtype: type in which the convolutions multiply; bfloat16 or float32.

        Returns:
            f(o), float32, shape [N, feature_dim].

        Raises:
            ShapeError: the observations do not have the shape that the extractor was built for.
        """
        if tuple(observations.shape[1:]) != self.observation_shape:
            raise ShapeError(
                f"`observations`: expected shape [N, {', '.join(map(str, self.observation_shape))}], "
                f"found {list(observations.shape)}"
            )
        planes = observations.permute(0, 1, 4, 2, 3).flatten(1, 2)
        planes = planes.to(dtype, memory_format=torch.channels_last).sub_(128)
        with torch.autocast(observations.device.type, dtype=torch.bfloat16, enabled=dtype == torch.bfloat16):
            features: Tensor = self.project(self.convolutions(planes).flatten(1))
        return layer_norm(features.float(), features.shape[1:])
