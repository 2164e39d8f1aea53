"""Asking what a user wrote: what goes wrong in it is told with the field of the `Task` that it stands in."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vhs._core import ArgumentError, VhsError


@contextmanager
def asking(task: str, field: str) -> Iterator[None]:
    """Say of an error which task and which field of it it is about, and where in its code it came up.

    Raises:
        ArgumentError: In place of any error.
    """
    try:
        yield
    except VhsError as error:
        raise ArgumentError(f"task {task}: `{field}`: {error}") from error
    except Exception as error:  # whatever a function of the user's raises
        raise ArgumentError(
            f"task {task}: `{field}`: expected an answer, got {what_happened(error)}"
        ) from error


def what_happened(error: Exception) -> str:
    """An error in somebody's code: its kind, what it says, and the line that it came up in."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{place}"
