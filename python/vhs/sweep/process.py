"""The process of a run, on whatever machine: how it starts, and what is said when it fails."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from vhs.sweep import launch


def start_process(
    arguments: Sequence[str],
    log: Path,
    *,
    cores: Sequence[int] = (),
    directory: Path | None = None,
    pass_fds: Sequence[int] = (),
) -> subprocess.Popen[bytes]:
    """Start `vhs` as a process that ends with this one.

    Args:
        arguments: of `vhs`.
        log: where what it prints is added.
        cores: that it is tied to; none ties it to none.
        directory: where it stands; None is where this process does.
        pass_fds: descriptors that it inherits.

    Raises:
        OSError: the log cannot be written, or the process cannot be made.
    """
    with log.open("ab") as output:
        return subprocess.Popen(
            [sys.executable, "-IS", launch.__file__, str(os.getpid()), ",".join(map(str, cores)), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            cwd=directory,
            pass_fds=pass_fds,
            # Ctrl-C goes to a whole process group; a run that got it from the terminal and from here would
            # take the second one as an order to end at once.
            process_group=0,
        )


def explain_end(status: int, log: Path) -> str:
    """Why a process failed: its signal, or the last line that it printed; nothing where it did not."""
    if status == 0:
        return ""
    if status < 0:
        return f"killed by signal {-status} ({signal.strsignal(-status)})"
    try:
        lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError as error:
        return f"its output cannot be read: {error.strerror}"
    return next((line.strip() for line in reversed(lines) if line.strip()), "no word")
