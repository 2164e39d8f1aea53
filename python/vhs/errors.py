"""Errors that the Python half raises; those of the Rust core come from `vhs._core`.

A user can catch `VhsError` for both.
"""

from __future__ import annotations

from vhs._core import VhsError

__all__ = [
    "CheckpointError",
    "ComparisonError",
    "ConfigError",
    "DivergenceError",
    "OutputError",
    "PeerError",
    "ReplayError",
    "ToldError",
    "VhsError",
]


class ConfigError(VhsError, ValueError):
    """A configuration that cannot be used: unknown key, wrong type, out of range, unreadable file."""


class CheckpointError(VhsError, RuntimeError):
    """A run directory or checkpoint that is missing, damaged or made with another configuration."""


class ComparisonError(VhsError, ValueError):
    """Runs that cannot be compared: another task, no evaluation, evaluated in another way."""


class DivergenceError(VhsError, ArithmeticError):
    """A loss or gradient that is not finite; the weights were left as they were."""


class OutputError(VhsError, RuntimeError):
    """Something that cannot be shown or written: no display, no such folder, no encoder, no permission."""


class ReplayError(VhsError, RuntimeError):
    """An episode that did not go as before when it was played again from its seed and actions."""


class PeerError(VhsError, RuntimeError):
    """Another process of the same training is gone, failed, or was started with something else."""


class ToldError(VhsError, RuntimeError):
    """What ended all processes of a training, in one that another process speaks for."""


def without_frames(error: BaseException) -> str:
    """What an error says, without the frames of C++ that torch may put behind it."""
    return str(error).partition("\nException raised from ")[0]
