"""The feature extractor f: stacked frames to a feature vector (paper, appendix "Implementation Details").

Batch norm uses the statistics of the batch when learning and running statistics when acting;
docs/concepts/paper.md says why f(o_T) and the prototypes agree all the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d, layer_norm, linear

from vhs._core import ShapeError

ExtractorFactory = Callable[[tuple[int, ...], int], nn.Module]
"""(observation_shape, feature_dim) -> a module that makes features, float [N, feature_dim], of observations,
[N, *observation_shape] as the buffer holds them: of pictures [height, width, stack * colours]."""


class Extractor(nn.Module):
    """f: observations as a buffer holds them to features of one scale."""

    observation_shape: tuple[int, ...]
    """Of one observation."""
    feature_dim: int
    """Numbers in f(o)."""

    def forward(self, observations: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        """Embed observations, [N, *observation_shape], as float32 [N, feature_dim].

        `dtype` is the type in which it may multiply; bfloat16 or float32.
        """
        raise NotImplementedError


class FeatureExtractor(Extractor):
    """Convolutions (kernel 3, stride 2, padding 1) with batch norm and ReLU, then a linear layer.

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
        """Build a convolution an entry of `channels` for frames of (height, width, colours)."""
        super().__init__()
        height, width, colours = frame_shape
        self.observation_shape = (height, width, frame_stack * colours)
        self.feature_dim = feature_dim
        self._stack_shape = (frame_stack, height, width, colours)
        layers: list[nn.Module] = []
        inputs = frame_stack * colours
        for outputs in channels:
            layers += [
                nn.Conv2d(inputs, outputs, 3, stride=2, padding=1, bias=False),
                nn.BatchNorm2d(outputs),
                nn.ReLU(inplace=True),
            ]
            inputs, height, width = outputs, (height + 1) // 2, (width + 1) // 2
        self.convolutions = nn.Sequential(*layers).to(memory_format=torch.channels_last)
        self.project = nn.Linear(inputs * height * width, feature_dim)
        self._folded: list[tuple[Tensor, Tensor]] = []
        self._folded_versions: tuple[torch.dtype, list[int]] | None = None

    def forward(self, observations: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        """Embed observations.

        Args:
            observations: uint8, frames stacked as channels, shape [N, height, width, stack * colours], which
                costs nothing; or one after the other, shape [N, stack, height, width, colours].
            dtype: type in which the convolutions multiply; bfloat16 or float32.

        Returns:
            f(o), float32, shape [N, feature_dim].

        Raises:
            ShapeError: the observations do not have the shape that the extractor was built for.
        """
        # The same byte, read as signed, is 128 less once its first bit is turned.
        planes = (self._planes(observations) ^ 128).view(torch.int8).to(dtype)
        features: Tensor
        if self.training:
            is_cast = dtype == torch.bfloat16
            with torch.autocast(observations.device.type, dtype=torch.bfloat16, enabled=is_cast):
                features = self.project(self.convolutions(planes).flatten(1))
        else:
            features = self._act(planes)
        return layer_norm(features.float(), features.shape[1:])

    def _planes(self, observations: Tensor) -> Tensor:
        """Stacked frames as channels, uint8, shape [N, stack * colours, height, width], channels last."""
        if observations.shape[1:] == self._stack_shape:
            observations = observations.permute(0, 2, 3, 1, 4).flatten(3)
        if observations.shape[1:] != self.observation_shape:
            pictures, stacks = (", ".join(map(str, s)) for s in (self.observation_shape, self._stack_shape))
            found = list(observations.shape)
            raise ShapeError(
                f"`observations`: expected shape [N, {pictures}] or [N, {stacks}], found {found}"
            )
        return observations.permute(0, 3, 1, 2)

    def _act(self, planes: Tensor) -> Tensor:
        """All layers with running statistics, each batch norm multiplied into the weights before it.

        Acting embeds a frame for every step, and a batch norm pass costs as much as a third of its
        convolution. The products, in the type of `planes`, are kept until a weight or a statistic changes.
        """
        versions = (planes.dtype, [tensor._version for tensor in self._state()])
        if versions != self._folded_versions or torch.is_grad_enabled():
            last = self.project.weight, self.project.bias
            folded = [*(_fold(*pair) for pair in self._layers()), last]
            self._folded = [(weight.to(planes.dtype), bias.to(planes.dtype)) for weight, bias in folded]
            self._folded_versions = versions
        for weight, bias in self._folded[:-1]:
            planes = conv2d(planes, weight, bias, stride=2, padding=1).relu_()
        return linear(planes.flatten(1), *self._folded[-1])

    def _state(self) -> list[Tensor]:
        """What `_act` is made of; asked for at every step, where a walk over all modules would show."""
        state = [self.project.weight, self.project.bias]
        for convolution, norm in self._layers():
            # The count tells that a batch has moved the statistics, which is written past their versions.
            moved = norm.running_mean, norm.running_var, norm.num_batches_tracked
            state += [convolution.weight, norm.weight, norm.bias]
            state += [one for one in moved if one is not None]
        return state

    def _layers(self) -> list[tuple[nn.Conv2d, nn.BatchNorm2d]]:
        """Every convolution with the batch norm behind it."""
        layers = list(self.convolutions)
        return list(zip(layers[0::3], layers[1::3], strict=True))  # type: ignore[arg-type]


class VectorExtractor(Extractor):
    """Of frames that are vectors: numbers at unit scale by batch norm, then a perceptron."""

    def __init__(
        self, frame_shape: Sequence[int], frame_stack: int, hidden_dim: int, feature_dim: int
    ) -> None:
        """Build the layers for `frame_stack` frames of `frame_shape`."""
        super().__init__()
        self.observation_shape = (frame_stack, *frame_shape)
        self.feature_dim = feature_dim
        self.norm = nn.BatchNorm1d(math.prod(self.observation_shape), affine=False)
        self.layers = nn.Sequential(
            nn.Linear(self.norm.num_features, hidden_dim), nn.ReLU(), nn.Linear(hidden_dim, feature_dim)
        )

    def forward(self, observations: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        """Embed observations, [N, stack, *frame_shape]; always multiplied in float32."""
        _check_observations(observations, self.observation_shape)
        features: Tensor = self.layers(self.norm(observations.flatten(1).float()))
        return layer_norm(features, features.shape[1:])


class OwnExtractor(Extractor):
    """A network of the user's, its features brought to the scale of all goals and features."""

    def __init__(self, factory: ExtractorFactory, observation_shape: Sequence[int], feature_dim: int) -> None:
        """Build it.

        Raises:
            ShapeError: it is no module, or its features are of another shape.
        """
        super().__init__()
        self.observation_shape = tuple(observation_shape)
        self.feature_dim = feature_dim
        self.network = factory(self.observation_shape, feature_dim)
        if not isinstance(self.network, nn.Module):
            raise ShapeError(f"`extractor`: expected a torch.nn.Module, found {type(self.network).__name__}")

    def check(self, dtype: torch.dtype) -> None:
        """Embed two empty observations of a type.

        Raises:
            ShapeError: the features are of another shape.
        """
        self.eval()
        with torch.no_grad():
            self(torch.zeros(2, *self.observation_shape, dtype=dtype))
        self.train()

    def forward(self, observations: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        """Embed observations; what the network multiplies may be cast to `dtype`."""
        _check_observations(observations, self.observation_shape)
        is_cast = dtype == torch.bfloat16
        with torch.autocast(observations.device.type, torch.bfloat16) if is_cast else nullcontext():
            features: Tensor = self.network(observations)
        if features.shape != (len(observations), self.feature_dim):
            expected, found = [len(observations), self.feature_dim], list(features.shape)
            raise ShapeError(f"`extractor`: expected features of shape {expected}, found {found}")
        return layer_norm(features.float(), features.shape[1:])


def _check_observations(observations: Tensor, shape: tuple[int, ...]) -> None:
    if observations.shape[1:] != shape:
        wanted, found = ", ".join(map(str, shape)), list(observations.shape)
        raise ShapeError(f"`observations`: expected shape [N, {wanted}], found {found}")


def _fold(convolution: nn.Conv2d, norm: nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """Weight and bias of the one convolution that does what both do with running statistics."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = norm.weight * (norm.running_var + norm.eps).rsqrt()
    weight = convolution.weight * scale.view(-1, 1, 1, 1)
    return weight.contiguous(memory_format=torch.channels_last), norm.bias - norm.running_mean * scale
