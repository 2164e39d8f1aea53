"""The seam between a training and whoever shares it: sums, exchanges and errors that all have in common.

A call is a meeting: every rank makes it, in the same order, and none goes on before what it needs of the
others has come.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Protocol

import torch
from torch import Tensor


class World(Protocol):
    """The processes that train one run."""

    rank: int
    """Which of them this one is, from 0; rank 0 tells, logs and saves."""
    size: int
    """How many there are."""

    @property
    def is_orphan(self) -> bool:
        """Whether the launcher of this process is gone: nobody else would end it."""
        ...

    def device(self, name: str) -> str:
        """Where this rank computes, of a `train.device`: each rank of a host takes a GPU of its own.

        Raises:
            ConfigError: this host has fewer GPUs than ranks.
        """
        ...

    def average(
        self,
        tensors: Sequence[Tensor],
        along: Sequence[Tensor] = (),
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        """Replace float tensors by their mean over the ranks, those of `along` by their sum, in one message.

        Args:
            tensors: of the same shapes on every rank, the first on the device that sums.
            along: the same, on any device; what passes between ranks is float32.
            meanwhile: done while the message is under way, of the tensors as they were; not done by a process
                alone.

        Raises:
            PeerError: a rank is gone.
        """
        ...

    def share(self, data: bytes, most: int | None = None) -> list[bytes]:
        """What each rank has to say, by rank.

        Args:
            data: of this rank.
            most: bytes that no rank exceeds, alike on all of them; None: they find out first.

        Raises:
            PeerError: a rank is gone.
        """
        ...

    def gather(self, data: bytes) -> list[bytes]:
        """As `share`, at rank 0; nothing elsewhere."""
        ...

    def together(self) -> AbstractContextManager[None]:
        """A body that each rank goes through for itself; if one of them fails, all of them do.

        Raises:
            VhsError: at rank 0, its own error, or that of the first rank with one.
            ToldError: elsewhere.
        """
        ...

    def expect_equal(self, facts: Mapping[str, Any]) -> None:
        """Compare plain values with those of rank 0.

        Raises:
            PeerError: at rank 0; the first rank with another value is named, and what differs.
            ToldError: elsewhere.
        """
        ...

    def set_patience(self, seconds: float) -> None:
        """How long a rank is waited for in any later meeting."""
        ...


class Alone(World):
    """This process and no other: everything is already agreed."""

    rank, size = 0, 1
    is_orphan = False

    def device(self, name: str) -> str:
        """The same."""
        return name

    def average(
        self,
        tensors: Sequence[Tensor],
        along: Sequence[Tensor] = (),
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        """Leave them as they are."""

    def share(self, data: bytes, most: int | None = None) -> list[bytes]:
        """What this rank has to say."""
        return [data]

    def gather(self, data: bytes) -> list[bytes]:
        """What this rank has to say."""
        return [data]

    def together(self) -> AbstractContextManager[None]:
        """The body's own errors."""
        return nullcontext()

    def expect_equal(self, facts: Mapping[str, Any]) -> None:
        """Nobody else can differ."""

    def set_patience(self, seconds: float) -> None:
        """Nobody is waited for."""


ALONE = Alone()


def table(world: World, row: Sequence[float]) -> Tensor:
    """This rank's row among zeros, float64 [size, len(row)]: summed over the ranks it has the row of each."""
    rows = torch.zeros(world.size, len(row), dtype=torch.float64)
    rows[world.rank] = torch.tensor(row, dtype=torch.float64)
    return rows
