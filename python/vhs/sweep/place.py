"""Where the jobs of a sweep run: what the runner asks of this machine and of a cluster alike."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol


class Job(Protocol):
    """One command of `vhs` that was started."""

    def poll(self) -> str | None:
        """None while it runs, then why it failed; nothing where it did not."""

    def stop(self) -> None:
        """Ask it to save and end; a second time, to end at once."""

    def kill(self) -> None:
        """End it, and return when it is gone."""


class Place(Protocol):
    """What has cores for jobs."""

    @property
    def cores_per_run(self) -> int:
        """Cores that every run gets: all the same, so that runs of one sweep can be compared in minutes."""

    @property
    def has_room(self) -> bool:
        """Whether another job may start."""

    def settle(self, directory: Path, lock: int) -> None:
        """Get ready for the jobs of a sweep.

        Args:
            directory: of the sweep, which is held.
            lock: the descriptor that holds it.

        Raises:
            ConfigError: jobs could not run there.
        """

    def start(self, arguments: Sequence[str], log: Path) -> Job:
        """Start `vhs` with these arguments; what it prints goes to the end of a file.

        Raises:
            OSError: it cannot be started.
        """

    def leave(self) -> None:
        """Give back what the place itself takes; no job runs any more."""
