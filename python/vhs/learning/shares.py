"""What goes into a learner's part of an update and what comes out, and arrays to tensors and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBatch, Hindsight


class GoalImages(NamedTuple):
    """A class-balanced batch of goal images and their classes."""

    observations: Tensor
    labels: Tensor


class Share(NamedTuple):
    """What one learner of an update learns from."""

    batch: EpisodeBatch
    goals: Tensor
    """The goal embedding each episode was acted under, shape [B, feature_dim]."""
    hindsight: Hindsight
    stored: GoalImages | None


class Learned(NamedTuple):
    """What one learner found: unweighted terms, features of its goal images, float32 [n, feature_dim]."""

    terms: dict[str, Tensor]
    goal_features: Tensor


def to_tensors(arrays: Mapping[str, Any]) -> dict[str, Tensor]:
    """State of the Rust core as tensors, which `torch.load` reads without unpickling code."""
    return {name: torch.from_numpy(array) for name, array in arrays.items()}


def to_arrays(tensors: Mapping[str, Tensor]) -> dict[str, NDArray[Any]]:
    """The arrays that `to_tensors` was given."""
    return {name: tensor.numpy() for name, tensor in tensors.items()}


def to_numpy(tensor: Tensor) -> NDArray[Any]:
    """The numbers of a tensor on any device, without its gradient."""
    array: NDArray[Any] = tensor.detach().cpu().numpy()
    return array
