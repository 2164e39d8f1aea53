"""The feature extractor f: stacked frames to a feature vector (paper, appendix "Implementation Details").

Batch norm uses the statistics of the batch when learning and running statistics when acting;
docs/paper-notes.md says why f(o_T) and the prototypes agree all the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from vhs._core import ShapeError


class FeatureExtractor(nn.Module):
    """Four convolutions (kernel 3, stride 2, padding 1) with batch norm and ReLU, then a linear layer.

    Raw 0..255 goes in: bfloat16 holds these values exactly, and the batch norm behind the first convolution
    makes f blind to their scale, so dividing by 255 would only cost time.
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
        planes = (
            observations.permute(0, 1, 4, 2, 3).flatten(1, 2).to(dtype, memory_format=torch.channels_last)
        )
        with torch.autocast(observations.device.type, dtype=torch.bfloat16, enabled=dtype == torch.bfloat16):
            features: Tensor = self.project(self.convolutions(planes).flatten(1))
        return features.float()
