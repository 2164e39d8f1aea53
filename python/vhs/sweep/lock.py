"""One sweep a directory: a lock that its runs inherit, so that it is held as long as any of them lives."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from vhs.errors import ConfigError, OutputError

_POLL_S = 0.2


@contextmanager
def hold(out: Path, stream: TextIO | None = None, patience_s: float = 60.0) -> Iterator[int]:
    """Make the directory of a sweep, with `logs/`, and hold it.

    Args:
        out: the directory.
        stream: where a person reads that there is something to wait for; standard output by default.
        patience_s: how long to wait for another holder: the runs of a killed sweep save before they end.

    Yields:
        The descriptor to hand on to the runs.

    Raises:
        ConfigError: the system has no such locks.
        OutputError: the directory cannot be written, or stays held.
    """
    descriptor = _open(out)
    try:
        if not _try_lock(descriptor):
            text = f"{out}: waiting for another sweep, or for runs that it left behind to save"
            print(text, file=stream or sys.stdout, flush=True)
            end = time.monotonic() + patience_s
            while not _try_lock(descriptor):
                if time.monotonic() > end:
                    raise OutputError(f"{out}: another sweep is at work here")
                time.sleep(_POLL_S)
        yield descriptor
    finally:
        os.close(descriptor)


def _open(out: Path) -> int:
    try:
        (out / "logs").mkdir(parents=True, exist_ok=True)
        return os.open(out / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise OutputError(f"{error.filename}: cannot write: {error.strerror}") from error


def _try_lock(descriptor: int) -> bool:
    try:
        import fcntl
    except ImportError:
        raise ConfigError(f"vhs sweep: expected Linux or macOS, found {sys.platform}") from None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
