"""One lock for everything that one process at a time may do to a directory."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from vhs.errors import OutputError
from vhs.runs.files import writing

_POLL_S = 0.05


@contextmanager
def hold(
    path: Path,
    busy: str,
    *,
    by_children: bool = False,
    patience_s: float = 0.0,
    wait: Callable[[], None] = lambda: None,
) -> Iterator[int]:
    """Hold a lock until the block ends or this process does.

    Where the system or the file system has no such locks, nothing is held.

    Args:
        path: the lock file, made when missing; or a directory, which needs no file of its own.
        busy: what is said when somebody else holds it.
        by_children: whether processes that inherit the descriptor hold it as well, until the last one ends.
        patience_s: how long to wait for another holder, in seconds.
        wait: called once before waiting.

    Yields:
        The descriptor, to hand on to processes that shall hold it.

    Raises:
        OutputError: somebody else holds it, or the file cannot be opened.
    """
    with writing(path):
        is_directory = path.is_dir()
        # A directory cannot be opened on Windows, which has none of these locks either.
        opened = os.devnull if is_directory and os.name == "nt" else path
        descriptor = os.open(opened, os.O_RDONLY if is_directory else os.O_RDWR | os.O_CREAT, 0o644)
    try:
        of_file = by_children or is_directory
        if not _try(descriptor, of_file):
            if patience_s:
                wait()
            end = time.monotonic() + patience_s
            while not _try(descriptor, of_file):
                if time.monotonic() > end:
                    raise OutputError(busy)
                time.sleep(_POLL_S)
        yield descriptor
    finally:
        os.close(descriptor)


def _try(descriptor: int, of_file: bool) -> bool:
    """Take the lock of the open file, which children inherit, or that of this process."""
    try:
        import fcntl
    except ImportError:  # no such locks here
        return True
    try:
        (fcntl.flock if of_file else fcntl.lockf)(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # nor on this file system
        return True
    return True
