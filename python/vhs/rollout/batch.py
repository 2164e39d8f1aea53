"""Batches and the recycled memory they lie in.

A block has a column for each field with room for all environments. A batch is a view of a block's first rows.
A block is filled again only when no array of its last batch is left anywhere: arrays that a user keeps stay
as they are, and arrays that nobody keeps cost no fresh memory, which is 10 to 15 times slower to fill than
warm memory.
"""

from __future__ import annotations

import mmap
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhs._core import RolloutLearner
from vhs.rollout.leaves import Nest, view_rows

CUT, QUARANTINED, BLOB, OUTSIDE = 1 << 4, 1 << 5, 1 << 7, 1 << 9
"""Bits of a row's flags, as in `rust/vhs-rollout/src/flags.rs`."""

_SCALARS = {
    "env_ids": np.int64,
    "rewards": np.float64,
    "versions": np.int64,
    "seeds": np.uint64,
    "steps": np.int64,
    "blob_bytes": np.int64,
    "flags": np.uint32,
    "terminated": np.bool_,
    "truncated": np.bool_,
    "is_first": np.bool_,
    "final_rows": np.int64,
}
"""Columns in the order in which the core tells their offsets, and their types."""


_FEW = 4
"""Rows of which the block has more than so many times as many are few."""


class Block:
    """Memory for one batch."""

    __slots__ = ("bytes", "columns", "final_leaves", "leaves")

    def __init__(
        self, nbytes: int, offsets: tuple[list[int], list[int], list[int]], rows: int, nest: Nest
    ) -> None:
        """Allocate a block.

        Args:
            nbytes: size as the core tells it.
            offsets: of the scalar columns, the observation's leaves and the final observation's leaves, in
                bytes.
            rows: how many environments there are.
            nest: leaves of an observation.
        """
        scalars, leaves, finals = offsets
        self.bytes = np.empty(nbytes, np.uint8)
        self.columns = {
            name: view_rows(self.bytes, start, rows, dtype)
            for (name, dtype), start in zip(_SCALARS.items(), scalars, strict=True)
        }
        self.leaves, self.final_leaves = (
            [
                view_rows(self.bytes, start, rows, leaf.dtype, leaf.shape)
                for leaf, start in zip(nest.leaves, starts, strict=True)
            ]
            for starts in (leaves, finals)
        )


class Blocks:
    """Hands out a block that nobody uses, making one where there is none."""

    def __init__(
        self, nbytes: int, offsets: tuple[list[int], list[int], list[int]], rows: int, nest: Nest
    ) -> None:
        """Remember how blocks are made; the arguments are those of `Block`."""
        self._recipe = (nbytes, offsets, rows, nest)
        first = Block(*self._recipe)
        self._blocks = [first]
        # Every view of a block, of whatever generation, holds the block's bytes; so one count tells them all.
        self._unused = sys.getrefcount(first.bytes)

    def __len__(self) -> int:
        """How many blocks there are, used or not."""
        return len(self._blocks)

    def forget(self) -> None:
        """Give back the memory that no batch uses; none is taken any more."""
        self._blocks.clear()

    def take(self) -> Block:
        """A block that no batch and no array of a batch uses."""
        for position, block in enumerate(self._blocks):
            if sys.getrefcount(block.bytes) == self._unused:
                # Last in line now: the one after it has been cold for longest.
                self._blocks.append(self._blocks.pop(position))
                return block
        block = Block(*self._recipe)
        self._blocks.append(block)
        return block


class Blobs:
    """Where workers leave pickled things: infos, results, errors."""

    def __init__(self, end: RolloutLearner) -> None:
        """Map the pool's memory once more, so that it lasts as long as what is read from it."""
        *_, self._start, self._stride, total = end.offsets
        self._memory = memoryview(mmap.mmap(end.memory, total))

    def read(self, env: int, nbytes: int) -> memoryview:
        """The blob of an environment, to be unpickled before its next command."""
        start = self._start + env * self._stride
        return self._memory[start : start + nbytes]


class Batch:
    """Answers of some environments, in the order of their ids.

    Arrays are made when asked for and share memory, that of the block; where few of its rows are used, an
    array has memory of its own: one that is kept holds at most four times its size. A part of an array
    holds all of it, as in numpy: copy a row that is to stay. Parts of observations that are no arrays, such
    as text, are tuples with an item a row.
    """

    __slots__ = ("_block", "_copies", "_finals", "_infos", "_loose", "_loose_finals", "_nest", "_rows")

    def __init__(self, block: Block, rows: int, finals: int, nest: Nest) -> None:
        """View the first `rows` rows of a filled block, `finals` of which have a final observation."""
        self._block = block
        self._rows = rows
        self._finals = finals
        self._nest = nest
        self._copies: dict[int, NDArray[Any]] = {}
        self._infos: dict[int, dict[str, Any]] | None = None
        self._loose: Sequence[Sequence[Any]] = ()
        self._loose_finals: Sequence[Sequence[Any]] = ()

    def __len__(self) -> int:
        """Number of rows."""
        return self._rows

    @property
    def infos(self) -> dict[int, dict[str, Any]]:
        """The info of each row that has one, by row.

        Where an episode ended and the next one began in the same step, it is the next one's first info, with
        the other as `final_info`.
        """
        if self._infos is None:
            self._infos = {}
        return self._infos

    @property
    def env_ids(self) -> NDArray[np.int64]:
        """Environments, ascending, int64 [n]."""
        return self._column("env_ids")

    @property
    def observation(self) -> Any:
        """What to act on, nested as the observation space, each leaf [n, ...]."""
        return self._nested(self._block.leaves, self._rows, self._loose)

    @property
    def rewards(self) -> NDArray[np.float64]:
        """Rewards of the steps, float64 [n]; 0 where no step was taken."""
        return self._column("rewards")

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """Whether the step ended its episode in a terminal state, bool [n]."""
        return self._column("terminated")

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """Whether the step's episode was ended for another reason, bool [n]."""
        return self._column("truncated")

    @property
    def is_first(self) -> NDArray[np.bool_]:
        """Whether the observation is the first of an episode, bool [n]."""
        return self._column("is_first")

    @property
    def is_cut(self) -> NDArray[np.bool_]:
        """Whether the last episode was cut and is to be dropped, bool [n]; always with `is_first`."""
        found: NDArray[np.bool_] = (self._column("flags") & CUT) != 0
        return found

    @property
    def is_quarantined(self) -> NDArray[np.bool_]:
        """Whether it was cut because of a NaN, bool [n]; the info says where."""
        found: NDArray[np.bool_] = (self._column("flags") & QUARANTINED) != 0
        return found

    @property
    def versions(self) -> NDArray[np.int64]:
        """Policy versions given with the actions, int64 [n]."""
        return self._column("versions")

    @property
    def seeds(self) -> NDArray[np.uint64]:
        """Seeds of the episodes that run now, uint64 [n]; 0 where unseeded."""
        return self._column("seeds")

    @property
    def steps(self) -> NDArray[np.int64]:
        """Steps taken in the step's episode, int64 [n]; 0 where no step was taken."""
        return self._column("steps")

    @property
    def final_rows(self) -> NDArray[np.int64]:
        """Rows whose episode ended while the next one has begun already, int64 [m]."""
        return self._first(self._block.columns["final_rows"], self._finals)

    @property
    def final_observation(self) -> Any:
        """Last observations of the episodes of `final_rows`, nested, each leaf [m, ...]."""
        return self._nested(self._block.final_leaves, self._finals, self._loose_finals)

    def notable(self) -> list[tuple[int, int, int, int]]:
        """Rows with something to look at: row, environment, flags, length of the pickled part in bytes."""
        flags = self._column("flags")
        rows = np.flatnonzero(flags & (CUT | QUARANTINED | BLOB | OUTSIDE))
        columns = (rows, self._column("env_ids")[rows], flags[rows], self._column("blob_bytes")[rows])
        return list(zip(*(column.tolist() for column in columns), strict=True))

    def add(self, row: int, content: Any) -> None:
        """Take what was pickled with an answer; in the order of the rows."""
        if self._nest.loose:
            content, loose, finals = content
            self._loose = [*self._loose, loose]
            if finals is not None:
                self._loose_finals = [*self._loose_finals, finals]
        if content:
            self.infos[row] = content

    def _column(self, name: str) -> NDArray[Any]:
        return self._first(self._block.columns[name], self._rows)

    def _nested(self, leaves: Sequence[NDArray[Any]], rows: int, loose: Sequence[Sequence[Any]]) -> Any:
        return self._nest.join_batch([self._first(leaf, rows) for leaf in leaves], loose)

    def _first(self, array: NDArray[Any], rows: int) -> NDArray[Any]:
        """The first rows of an array of the block: a view, or a copy, always the same, where they are few."""
        if _FEW * rows >= len(array):
            return array[:rows]
        copy = self._copies.get(id(array))
        if copy is None:
            copy = self._copies[id(array)] = array[:rows].copy()
        return copy
