"""What a Ray task does on its node: one job of a sweep, as a process of its own.

Nodes import this module, so it needs neither torch nor Ray.
"""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass
from pathlib import Path

from vhs import __version__
from vhs.interrupt import stop_on_signal
from vhs.sweep.process import explain_end, start_process

_POLL_S = 0.2


@dataclass(frozen=True, slots=True)
class Site:
    """What a node must have to work on a sweep: the file system and the version of whoever started it."""

    directory: Path
    """Where the sweep was started: its files are named from there."""
    mark: Path
    """A file in the directory of the runs."""
    token: str
    """What stands in it: a directory of the same name on the node's own disk has another one, or none."""
    version: str = __version__

    def what_is_missing(self) -> str:
        """A sentence about this node; empty where nothing is."""
        node = f"node {socket.gethostname()}"
        if self.version != __version__:
            return f"{node}: expected vhs {self.version}, found {__version__}"
        try:
            found = self.mark.read_text(encoding="utf-8")
        except OSError:
            found = ""
        if found == self.token and self.directory.is_dir():
            return ""
        unseen = self.directory if found == self.token else self.mark.parent
        return (
            f"{node}: expected to see {unseen}, on a file system that all nodes share, found none or another"
        )


def work(site: Site, arguments: list[str], log: Path) -> str:
    """Run `vhs` until it ends; Ray's wish to cancel becomes the signal to save and end.

    Ray raises it as Ctrl-C does; a second one ends the process at once.

    Args:
        site: what this node must see.
        arguments: of `vhs`.
        log: where what it prints is added.

    Returns:
        Why it failed; nothing where it did not.
    """
    missing = site.what_is_missing()
    if missing:
        return missing
    with stop_on_signal() as stop:
        try:
            process = start_process(arguments, log, directory=site.directory)
        except OSError as error:
            return f"cannot start: {error.strerror}"
        try:
            while process.poll() is None and not stop.is_set:
                time.sleep(_POLL_S)
            process.terminate()
            while process.poll() is None:
                time.sleep(_POLL_S)
        finally:
            process.terminate()
            status = process.wait()
    return explain_end(status, log)
