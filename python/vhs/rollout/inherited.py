"""File descriptors that a child process gets, whether it is forked or spawned."""

from __future__ import annotations

from dataclasses import dataclass
from multiprocessing.reduction import DupFd
from typing import Any


@dataclass(frozen=True)
class Inherited:
    """A descriptor's number: the same in a fork, that of a duplicate in a process spawned with it."""

    number: int

    def __reduce__(self) -> Any:
        """Pickled while a process is spawned, the descriptor is passed to that process."""
        return _adopted, (DupFd(self.number),)


def _adopted(duplicate: Any) -> Inherited:
    return Inherited(duplicate.detach())
