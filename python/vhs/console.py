"""What a command tells a person: one way to say it, which never fails whoever speaks.

A terminal that was closed, a pipe whose reader has left, a full disk behind ``> FILE`` and a character that
the terminal cannot show are no reasons to end a training. Texts are shown as they are: brackets in a path are
no markup.
"""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.console import Console

_NOBODY_READS = {errno.EPIPE, errno.EIO, errno.EBADF}
"""A reader that has left, a terminal that is gone, an output that was closed before the start."""


class Output:
    """A text stream that takes everything, and knows whether it came through; it stands in for the stream."""

    def __init__(self, stream: TextIO | None = None) -> None:
        """Speak to `stream`, standard output by default, which may be None where a process has none."""
        self._stream = sys.stdout if stream is None else stream
        self.failure: OSError | None = None
        """The last error of the stream; None as long as everything came through."""

    @property
    def is_unread(self) -> bool:
        """Whether what was said is lost because nobody is there to read it."""
        return self.failure is not None and self.failure.errno in _NOBODY_READS

    @property
    def encoding(self) -> str:
        """That of the stream."""
        return getattr(self._stream, "encoding", None) or "utf-8"

    def say(self, text: str) -> None:
        """Tell a line, at once: behind a pipe somebody may be waiting for it."""
        self.write(f"{text}\n")
        self.flush()

    def write(self, text: str) -> int:
        """Write a text; what the stream's encoding lacks, as the bytes of a path, becomes a question mark."""
        shown = text.encode(self.encoding, errors="replace").decode(self.encoding)
        self._try("write", shown)
        return len(text)

    def flush(self) -> None:
        """Hand on what was written."""
        self._try("flush")

    def isatty(self) -> bool:
        """Whether a person sits in front of it."""
        try:
            return self._stream is not None and self._stream.isatty()
        except ValueError:  # closed
            return False

    def fileno(self) -> int:
        """The descriptor behind the stream.

        Raises:
            OSError: there is none.
        """
        if self._stream is None:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        return self._stream.fileno()

    def abandon(self) -> None:
        """Leave a stream that fails: what waits in it would fail again when Python flushes at its end."""
        self.flush()
        if self.failure is not None and self._stream is not None:
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())

    def _try(self, action: str, *arguments: str) -> None:
        if self._stream is None:
            self.failure = OSError(errno.EBADF, os.strerror(errno.EBADF))
            return
        try:
            getattr(self._stream, action)(*arguments)
        except OSError as error:
            self.failure = error
        except ValueError:  # a stream that was closed
            self.failure = OSError(errno.EBADF, os.strerror(errno.EBADF))


def make_console(output: Output) -> Console:
    """A console of rich on an output, for bars; it shows texts as they are."""
    from rich.console import Console

    return Console(file=output, markup=False, emoji=False, highlight=False)  # type: ignore[arg-type]
