"""The one way in which files of runs and agents are read: regular, bounded, whole.

Whoever reads a directory of a stranger opens no pipe that never answers, no device that never ends, and takes
no more into memory than the file may have.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path


def read_bounded(path: Path, most: int, *, may_be_pipe: bool = False) -> bytes:
    """The content of a file.

    Args:
        path: of the file; links are followed.
        most: bytes that it may have.
        may_be_pipe: whether it is the user's own word, as in ``--config <(echo "seed: 1")``.

    Raises:
        OSError: it cannot be opened or read, as `open` says it.
        ValueError: it is no regular file, or has more bytes.
    """
    # Without O_NONBLOCK the opening of a pipe waits for a writer.
    waits = 0 if may_be_pipe else getattr(os, "O_NONBLOCK", 0)
    descriptor = os.open(path, os.O_RDONLY | waits | getattr(os, "O_BINARY", 0))
    with open(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not (may_be_pipe or stat.S_ISREG(status.st_mode)):
            raise ValueError("expected a regular file, found a pipe or a device")
        # Of a file no more is asked for than it has: what is asked for is memory at once.
        content = file.read(min(most, status.st_size) + 1 if stat.S_ISREG(status.st_mode) else most + 1)
    if len(content) > most or status.st_size > most:
        raise ValueError(f"expected at most {most:,} bytes, found {max(status.st_size, len(content)):,}")
    return content
