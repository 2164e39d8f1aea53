"""Becomes a run of a sweep: tied to its cores and to the life of the sweep, then `vhs` with some arguments.

A program of its own that imports nothing of `vhs`: what is set here has to be there before any library starts
threads. Arguments: process id of its parent, cores (``0,1``; none pins it to none), arguments of `vhs`.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def launch(parent: int, cores: set[int], arguments: list[str]) -> None:
    """Replace this process by `vhs`."""
    if sys.platform.startswith("linux"):
        if cores:
            os.sched_setaffinity(0, cores)
        # A killed sweep must not leave runs behind: the next sweep would train in the same directories. The
        # signal asks the run to save and end; the setting outlives the exec.
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM))
        if os.getppid() != parent:
            sys.exit(130)
    # -P: a folder named vhs where the user happens to stand is not the package.
    os.execv(sys.executable, [sys.executable, "-P", "-m", "vhs.cli", *arguments])


if __name__ == "__main__":
    launch(int(sys.argv[1]), {int(core) for core in sys.argv[2].split(",") if core}, sys.argv[3:])
