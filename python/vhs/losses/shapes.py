"""Shapes of a padded batch: checks that say what was expected and found, and what was taken inside."""

from __future__ import annotations

from torch import Tensor

from vhs._core import ShapeError


def check_shape(spec: str, **tensors: Tensor) -> None:
    """Check that tensors share the named axes of `spec`.

    Args:
        spec: axis names by spaces, for example ``"B T"``; an axis has one size over all tensors.
        **tensors: the tensors by name.

    Raises:
        ShapeError: a tensor has another number of axes, or an axis another size than in the tensors before
            it.
    """
    axes = spec.split()
    sizes: dict[str, int] = {}
    for name, tensor in tensors.items():
        expected = "[" + ", ".join(f"{axis}={sizes[axis]}" if axis in sizes else axis for axis in axes) + "]"
        found = list(tensor.shape)
        if len(found) != len(axes) or any(
            sizes.setdefault(axis, size) != size for axis, size in zip(axes, found, strict=True)
        ):
            raise ShapeError(f"`{name}`: expected shape {expected}, found {found}")
