"""Spaces as bytes: which arrays an observation or an action consists of, and where each lies.

A nest of `Dict` and `Tuple` spaces has parts. A part of fixed shape and type is a leaf: an array in shared
memory, ordered as gymnasium orders the spaces, 64-byte aligned. Any other part (text, graphs, sequences, a
space of one's own) is loose: it travels pickled, and a batch has a tuple of them, as gymnasium's batches do.
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
"""Keys and indices that lead from the whole to a part."""


@dataclass(frozen=True, slots=True)
class Leaf:
    """One array of an observation or action."""

    path: Path
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    offset: int
    """From the start of the observation or action, in bytes."""
    is_scalar: bool
    """Given to environments as a numpy scalar instead of an array, as gymnasium does."""

    @property
    def nbytes(self) -> int:
        """Size in bytes."""
        return self.dtype.itemsize * int(np.prod(self.shape, dtype=np.int64))


class Unfit(OverflowError):
    """A number that the type of its space does not hold."""


class Nest:
    """The parts of a space, and the ways between nested values and flat lists."""

    def __init__(self, space: Space[Any], what: str) -> None:
        """Find the parts of a space.

        Args:
            space: any.
            what: "observation" or "action", for messages.
        """
        self.what = what
        self.leaves: list[Leaf] = []
        self.loose: list[int] = []
        """Places of the loose parts among all."""
        self.nbytes = 0
        self._paths: list[Path] = []
        for path, part in _parts(space, ()):
            if _is_fixed(part):
                self.leaves.append(self._leaf(path, part))
            else:
                self.loose.append(len(self._paths))
            self._paths.append(path)
        self._fixed = [place for place in range(len(self._paths)) if place not in set(self.loose)]
        self.nbytes_of_leaves = [leaf.nbytes for leaf in self.leaves]
        """Sizes of the leaves, in bytes."""
        self._space = space
        self._is_flat = not isinstance(space, spaces.Dict | spaces.Tuple)
        self.floats = [index for index, leaf in enumerate(self.leaves) if leaf.dtype.kind in "fc"]
        """Leaves that can be NaN."""

    def _leaf(self, path: Path, part: Space[Any]) -> Leaf:
        dtype, shape = part.dtype, part.shape
        assert dtype is not None
        assert shape is not None
        is_scalar = isinstance(part, spaces.Discrete) or shape == ()
        leaf = Leaf(path, np.dtype(dtype), shape, self.nbytes, is_scalar)
        self.nbytes += -(-leaf.nbytes // ALIGNMENT) * ALIGNMENT
        return leaf

    def is_like(self, other: Nest) -> bool:
        """Whether values of both have the same parts, each of the same type and shape."""
        return (self.leaves, self._paths, self.loose) == (other.leaves, other._paths, other.loose)

    def name(self, leaf: Leaf) -> str:
        """What and where, for messages, such as `observation['image']`."""
        return self.what + "".join(f"[{part!r}]" for part in leaf.path)

    def views(self, memory: NDArray[np.uint8], start: int) -> list[NDArray[Any]]:
        """One array a leaf, over the bytes of one observation or action that begins at `start`."""
        return [_view(memory, start + leaf.offset, leaf.dtype, leaf.shape) for leaf in self.leaves]

    def split(self, value: Any) -> list[Any]:
        """A nested value as a list, one item a part."""
        if self._is_flat:
            return [value]
        return [_follow(value, path) for path in self._paths]

    def join(self, items: Sequence[Any]) -> Any:
        """A list, one item a part, as a nested value."""
        if self._is_flat:
            return items[0]
        return _join(self._space, iter(items))

    def join_batch(self, leaves: Sequence[Any], rows: Sequence[Sequence[Any]]) -> Any:
        """A nested batch from an array a leaf and, for each row, its loose parts."""
        if not self.loose:
            return self.join(leaves)
        parts: list[Any] = [None] * len(self._paths)
        for place, leaf in zip(self._fixed, leaves, strict=True):
            parts[place] = leaf
        for index, place in enumerate(self.loose):
            parts[place] = tuple(row[index] for row in rows)
        return self.join(parts)

    def write(self, views: Sequence[NDArray[Any]], value: Any) -> Sequence[Any]:
        """Copy a nested value into the arrays of its leaves and return its loose parts.

        Raises:
            ShapeError: a part has another shape than its space.
            DtypeError: a part cannot be stored in the type of its space, or a number in it does not fit.
        """
        if self._is_flat and type(value) is np.ndarray and views:
            # The most frequent case, at the price of three comparisons.
            (view,) = views
            if value.dtype == view.dtype and value.shape == view.shape:
                view[...] = value
                return ()
        parts = self.split(value)
        fixed = [parts[place] for place in self._fixed] if self.loose else parts
        for leaf, view, part in zip(self.leaves, views, fixed, strict=True):
            array = part if isinstance(part, np.ndarray) else np.asarray(part)
            # Without the check, numpy would broadcast whatever fits.
            if array.shape != leaf.shape:
                raise ShapeError(f"{self.name(leaf)}: expected shape {leaf.shape}, got {array.shape}")
            if array.dtype != leaf.dtype:
                try:
                    array = converted(array, leaf.dtype, self.name(leaf))
                except Unfit as error:
                    raise DtypeError(str(error)) from None
            view[...] = array
        return [parts[place] for place in self.loose]

    def read(self, views: Sequence[NDArray[Any]]) -> Any:
        """A nested value of its own, of leaves alone: nothing in it lies in the arrays."""
        if self._is_flat:
            view = views[0]
            return view[()] if self.leaves[0].is_scalar else view.copy()
        items = [
            view[()] if leaf.is_scalar else view.copy() for leaf, view in zip(self.leaves, views, strict=True)
        ]
        return self.join(items)

    def rows(self, values: Any, count: int) -> list[tuple[int, int, NDArray[Any]]]:
        """A nested batch of leaves as contiguous arrays, each with its leaf's offset and size in bytes.

        Args:
            values: nested arrays or sequences, first dimension `count`; tensors on the CPU will do.
            count: how many rows.

        Raises:
            ShapeError: a part has another shape.
            DtypeError: a part cannot be stored in the type of its space.
            Unfit: a number that the type of its space does not hold.
        """
        if self._is_flat and type(values) is np.ndarray and self.leaves:
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

    def items(self, values: Any, count: int) -> list[Any]:
        """A nested batch as a list of nested values, whatever their types: what is to travel pickled.

        Raises:
            ShapeError: a part has another number of rows.
        """
        parts = self.split(values)
        for place in self._fixed:
            parts[place] = np.asarray(parts[place])
        for path, part in zip(self._paths, parts, strict=True):
            if len(part) != count:
                where = "".join(f"[{key!r}]" for key in path)
                raise ShapeError(f"{self.what}s{where}: expected {count} rows, got {len(part)}")
        return [self.join([part[row] for part in parts]) for row in range(count)]

    def _row_array(self, leaf: Leaf, part: Any, count: int) -> NDArray[Any]:
        array, name = np.asarray(part), self.name(leaf).replace(self.what, self.what + "s", 1)
        if array.shape != (count, *leaf.shape):
            refused = ShapeError if array.ndim else DtypeError
            raise refused(f"{name}: expected shape {(count, *leaf.shape)}, got {array.shape}")
        if array.dtype is not leaf.dtype and array.dtype != leaf.dtype:
            array = converted(array, leaf.dtype, name)
        return np.ascontiguousarray(array)


def converted(array: NDArray[Any], dtype: np.dtype[Any], name: str) -> NDArray[Any]:
    """Numbers in another type, each as it was but for a float's precision.

    Integers never wrap and finite numbers never become infinite; numpy counts integers of every width as one
    kind.

    Raises:
        DtypeError: numbers of another kind.
        Unfit: a number that the type does not hold.
    """
    if dtype.kind in "iu" and array.dtype.kind in "iu":
        limits = np.iinfo(dtype)
        for number in (array.min(), array.max()) if array.size else ():
            if not limits.min <= number <= limits.max:
                raise Unfit(f"{name}: expected numbers that {dtype} holds, got {number} ({array.dtype})")
        return array.astype(dtype)
    if not np.can_cast(array.dtype, dtype, "same_kind"):
        raise DtypeError(f"{name}: expected {dtype}, got {array.dtype}")
    with np.errstate(over="ignore"):
        made = array.astype(dtype)
    if dtype.kind in "fc" and np.isinf(made).any() and not np.array_equal(np.isinf(made), np.isinf(array)):
        raise Unfit(f"{name}: expected numbers that {dtype} holds, got larger ones ({array.dtype})")
    return made


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


def _parts(space: Space[Any], path: Path) -> Iterator[tuple[Path, Space[Any]]]:
    if isinstance(space, spaces.Dict):
        for key, part in space.spaces.items():
            yield from _parts(part, (*path, key))
    elif isinstance(space, spaces.Tuple):
        for index, part in enumerate(space.spaces):
            yield from _parts(part, (*path, index))
    else:
        yield path, space


def _is_fixed(space: Space[Any]) -> bool:
    """Whether all values of a space are arrays of one shape and type."""
    return isinstance(space, spaces.Box | spaces.Discrete | spaces.MultiBinary | spaces.MultiDiscrete)


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
