"""How an episode ended, in the words and numbers that the Rust core uses."""

from __future__ import annotations

from enum import IntEnum
from typing import Self

from vhs._core import ArgumentError


class Outcome(IntEnum):
    """How an episode ended; `info["outcome"]` holds the lower-case name."""

    SUCCESS = 0
    """The instructed object was reached and the instructed interaction done."""
    FAILURE = 1
    """A wrong object or a wrong interaction ended the episode."""
    TIMEOUT = 2
    """The time ran out."""

    @classmethod
    def from_name(cls, name: str) -> Self:
        """The outcome called "success", "failure" or "timeout".

        Raises:
            ArgumentError: For any other name.
        """
        for outcome in cls:
            if outcome.name.lower() == name:
                return outcome
        names = ", ".join(f'"{outcome.name.lower()}"' for outcome in cls)
        raise ArgumentError(f"`name`: expected one of {names}, got {name!r}")
