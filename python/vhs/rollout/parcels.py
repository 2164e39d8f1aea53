"""Pickled things on their way between learner and workers: infos, results, options, errors.

What is small travels in the shared memory of its environment. What is larger is put into a nameless file that
all processes have, where every environment has a place of its own: a frame, or a whole film, is no error.
Whose turn it is to write there is the slot's state to say, as with the shared memory.
"""

from __future__ import annotations

import mmap
import os
import pickle
from dataclasses import dataclass
from typing import Any

from vhs._core import ArgumentError

PLACE_BYTES = 1 << 32
"""Room for one thing in the file, which is sparse: only what is written takes memory."""

DOWN, UP = 0, 1
"""From the learner, and to it: each way has a place of its own for each environment."""


class Frozen(bytes):
    """A thing as it was when it was pickled, whatever becomes of it before its way begins."""

    def __reduce__(self) -> Any:
        """Unpickled, it is the thing."""
        return pickle.loads, (bytes(self),)


def frozen(thing: Any) -> Frozen:
    """A thing that is pickled now and travels later."""
    return Frozen(pickle.dumps(thing, protocol=pickle.HIGHEST_PROTOCOL))


@dataclass(frozen=True, slots=True)
class _InFile:
    """Travels instead of what lies in the file."""

    nbytes: int


class Parcels:
    """One process's way to pack and unpack."""

    def __init__(self, file: int, room: int, way: int) -> None:
        """Pack what goes this way, and unpack what comes the other.

        Args:
            file: open, that of all processes of the pool.
            room: most bytes that travel without it.
            way: `DOWN` or `UP`.
        """
        self._file, self._room, self._way = file, room, way
        self.are_in_file: dict[int, int] = {}
        """Sizes of what was packed last and lies in the file, by environment."""

    def pack(self, env: int, thing: Any) -> bytes:
        """At most `room` bytes that stand for a thing on its way to or from an environment.

        Raises:
            ArgumentError: it takes more than 4 GiB.
        """
        packed = pickle.dumps(thing, protocol=pickle.HIGHEST_PROTOCOL)
        self.free(env)
        if len(packed) <= self._room:
            return packed
        if len(packed) > PLACE_BYTES:
            raise ArgumentError(
                f"expected infos, results and options of at most 4 GiB, got {len(packed)} bytes"
            )
        self.are_in_file[env] = len(packed)
        rest, place = memoryview(packed), _place(env, self._way)
        while rest:
            written = os.pwrite(self._file, rest, place)
            rest, place = rest[written:], place + written
        return pickle.dumps(_InFile(len(packed)), protocol=pickle.HIGHEST_PROTOCOL)

    def unpack(self, env: int, packed: bytes | memoryview) -> Any:
        """The thing that was packed by the other side; may be called again until that packs the next."""
        found = pickle.loads(packed)
        if type(found) is not _InFile:
            return found
        with self._mapped(_place(env, 1 - self._way), found.nbytes) as memory:
            return pickle.loads(memory)

    def free(self, env: int) -> None:
        """Give back what memory in the file the last thing took that was packed for an environment."""
        nbytes = self.are_in_file.pop(env, 0)
        if nbytes:
            with self._mapped(_place(env, self._way), nbytes) as memory:
                memory.madvise(mmap.MADV_REMOVE)

    def _mapped(self, place: int, nbytes: int) -> mmap.mmap:
        return mmap.mmap(self._file, nbytes, offset=place)


def _place(env: int, way: int) -> int:
    return (2 * env + way) * PLACE_BYTES
