"""Spaces as bytes: which arrays an observation or an action consists of, and where each lies.

A leaf is one array of fixed shape and type inside a nest of `Dict` and `Tuple` spaces. Leaves are ordered as
gymnasium orders the spaces, each 64-byte aligned.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import Space, spaces
from numpy.typing import NDArray

from vhs._core import DtypeError, ShapeError

ALIGNMENT = 64

Path = tuple[str | int, ...]
"""Keys and indices that lead from the whole to a leaf."""


@dataclass(frozen=True, slots=True)
class Leaf:
    """One array of an observation or action."""

    path: Path
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    offset: int
    """From the start of the observation or action, in bytes."""
    is_scalar: bool
    """Given to environments as a numpy scalar instead of an array: `Discrete`."""

    @property
    def nbytes(self) -> int:
        """Size in bytes."""
        return self.dtype.itemsize * int(np.prod(self.shape, dtype=np.int64))

    @property
    def name(self) -> str:
        """The path for messages, such as `observation['image']`."""
        return "".join(f"[{part!r}]" for part in self.path)


class Nest:
    """The leaves of a space, and the ways between nested values and flat lists of arrays."""

    def __init__(self, space: Space[Any], what: str) -> None:
        """Find the leaves of a space.

        Args:
            space: of fixed size: Box, Discrete, MultiBinary, MultiDiscrete, or a Dict or Tuple of such.
            what: "observation" or "action", for messages.

        Raises:
            TypeError: the space holds something whose size is not fixed.
        """
        self.what = what
        self.leaves: list[Leaf] = []
        self.nbytes = 0
        for path, part in _parts(space, (), what):
            dtype, shape = part.dtype, part.shape
            assert dtype is not None
            assert shape is not None
            leaf = Leaf(path, np.dtype(dtype), shape, self.nbytes, isinstance(part, spaces.Discrete))
            self.leaves.append(leaf)
            self.nbytes += -(-leaf.nbytes // ALIGNMENT) * ALIGNMENT
        self.nbytes_of_leaves = [leaf.nbytes for leaf in self.leaves]
        """Sizes of the leaves, in bytes."""
        self._space = space
        self._is_flat = not isinstance(space, spaces.Dict | spaces.Tuple)
        self.floats = [index for index, leaf in enumerate(self.leaves) if leaf.dtype.kind in "fc"]
        """Leaves that can be NaN."""

    def views(self, memory: NDArray[np.uint8], start: int) -> list[NDArray[Any]]:
        """One array a leaf, over the bytes of one observation or action that begins at `start`."""
        return [_view(memory, start + leaf.offset, leaf.dtype, leaf.shape) for leaf in self.leaves]

    def split(self, value: Any) -> list[Any]:
        """A nested value as a list, one item a leaf."""
        if self._is_flat:
            return [value]
        return [_follow(value, leaf.path) for leaf in self.leaves]

    def join(self, items: Sequence[Any]) -> Any:
        """A list, one item a leaf, as a nested value."""
        if self._is_flat:
            return items[0]
        return _join(self._space, iter(items))

    def write(self, views: Sequence[NDArray[Any]], value: Any) -> None:
        """Copy a nested value into the arrays of its leaves.

        Raises:
            ShapeError: a part has another shape than its space.
            DtypeError: a part cannot be stored in the type of its space.
        """
        if self._is_flat and type(value) is np.ndarray:
            # The most frequent case, at the price of three comparisons.
            (view,) = views
            if value.dtype == view.dtype and value.shape == view.shape:
                view[...] = value
                return
        for leaf, view, part in zip(self.leaves, views, self.split(value), strict=True):
            # Without the check, numpy would broadcast whatever fits.
            shape = part.shape if isinstance(part, np.ndarray) else np.shape(part)
            if shape != leaf.shape:
                raise ShapeError(f"{self.what}{leaf.name}: expected shape {leaf.shape}, got {shape}")
            try:
                np.copyto(view, part, casting="same_kind")
            except TypeError as error:
                got = np.asarray(part).dtype
                raise DtypeError(f"{self.what}{leaf.name}: expected {leaf.dtype}, got {got}") from error

    def read(self, views: Sequence[NDArray[Any]]) -> Any:
        """A nested value of its own: nothing in it lies in the arrays."""
        if self._is_flat:
            view = views[0]
            return view[()] if self.leaves[0].is_scalar else view.copy()
        items = [
            view[()] if leaf.is_scalar else view.copy() for leaf, view in zip(self.leaves, views, strict=True)
        ]
        return self.join(items)

    def rows(self, values: Any, count: int) -> list[tuple[int, int, NDArray[Any]]]:
        """A nested batch as contiguous arrays, each with its leaf's offset and size in bytes.

        Args:
            values: nested arrays or sequences, first dimension `count`; tensors on the CPU will do.
            count: how many rows.

        Raises:
            ShapeError: a part has another shape.
            DtypeError: a part cannot be stored in the type of its space.
        """
        if self._is_flat and type(values) is np.ndarray:
            leaf = self.leaves[0]
            # The most frequent case, at the price of three comparisons.
            if (
                values.dtype == leaf.dtype
                and values.shape == (count, *leaf.shape)
                and values.flags.c_contiguous
            ):
                return [(0, self.nbytes_of_leaves[0], values)]
        return [
            (leaf.offset, size, self._row_array(leaf, part, count))
            for leaf, size, part in zip(self.leaves, self.nbytes_of_leaves, self.split(values), strict=True)
        ]

    def _row_array(self, leaf: Leaf, part: Any, count: int) -> NDArray[Any]:
        array = np.asarray(part)
        if array.shape != (count, *leaf.shape):
            expected = (count, *leaf.shape)
            raise ShapeError(f"{self.what}s{leaf.name}: expected shape {expected}, got {array.shape}")
        if array.dtype is not leaf.dtype and array.dtype != leaf.dtype:
            if not np.can_cast(array.dtype, leaf.dtype, casting="same_kind"):
                raise DtypeError(f"{self.what}s{leaf.name}: expected {leaf.dtype}, got {array.dtype}")
            array = array.astype(leaf.dtype)
        return np.ascontiguousarray(array)


def view_rows(
    memory: NDArray[np.uint8], start: int, count: int, dtype: Any, shape: tuple[int, ...] = ()
) -> NDArray[Any]:
    """An array of `count` rows over the bytes that begin at `start`."""
    return _view(memory, start, np.dtype(dtype), (count, *shape))


def _view(
    memory: NDArray[np.uint8], start: int, dtype: np.dtype[Any], shape: tuple[int, ...]
) -> NDArray[Any]:
    nbytes = dtype.itemsize * int(np.prod(shape, dtype=np.int64))
    return memory[start : start + nbytes].view(dtype).reshape(shape)


def _parts(space: Space[Any], path: Path, what: str) -> Iterator[tuple[Path, Space[Any]]]:
    if isinstance(space, spaces.Dict):
        for key, part in space.spaces.items():
            yield from _parts(part, (*path, key), what)
    elif isinstance(space, spaces.Tuple):
        for index, part in enumerate(space.spaces):
            yield from _parts(part, (*path, index), what)
    elif isinstance(space, spaces.Box | spaces.Discrete | spaces.MultiBinary | spaces.MultiDiscrete):
        yield path, space
    else:
        expected = "Box, Discrete, MultiBinary, MultiDiscrete, Dict or Tuple"
        raise TypeError(f"{what} space: expected {expected}, got {type(space).__name__}")


def _follow(value: Any, path: Path) -> Any:
    for part in path:
        value = value[part]
    return value


def _join(space: Space[Any], items: Iterator[Any]) -> Any:
    if isinstance(space, spaces.Dict):
        return {key: _join(part, items) for key, part in space.spaces.items()}
    if isinstance(space, spaces.Tuple):
        return tuple(_join(part, items) for part in space.spaces)
    return next(items)


def as_mapping(value: Any) -> Mapping[str, Any]:
    """An info that an environment returned; None, as some return, is an empty one."""
    return {} if value is None else value
