"""Which device computes, and how arrays of the Rust core get there."""

from __future__ import annotations

from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor


def pick_device(name: str) -> torch.device:
    """The device that a configuration names; ``auto`` is CUDA where there is one and the CPU elsewhere.

    Raises:
        RuntimeError: torch knows no such device.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(name)


def to_device(array: NDArray[Any], device: torch.device) -> Tensor:
    """An array as a tensor on `device`: without a copy on the CPU, from page-locked memory to CUDA.

    A copy from page-locked memory is queued: the kernels that read it follow on the same stream, and the
    interpreter goes on.
    """
    tensor = torch.from_numpy(array)
    if device.type == "cuda":
        return tensor.pin_memory().to(device, non_blocking=True)
    return tensor.to(device)


def to_numpy(tensor: Tensor) -> NDArray[Any]:
    """The numbers of a tensor on any device, without its gradient."""
    array: NDArray[Any] = tensor.detach().cpu().numpy()
    return array
