"""The cores of this machine as the place of a sweep: a process a job, pinned to a share of them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vhs.errors import ConfigError
from vhs.sweep.process import explain_end, start_process


def available_cores() -> list[int]:
    """Cores that this process may use, where the system says so."""
    if sys.platform.startswith("linux"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def share_cores(cores: Sequence[int], jobs: int | None) -> list[tuple[int, ...]]:
    """Disjoint shares of the cores, all of the same size.

    Raises:
        ConfigError: more jobs than cores.
    """
    count = len(cores) if jobs is None else jobs
    if count > len(cores):
        raise ConfigError(f"--jobs: expected at most {len(cores)}, the cores that there are, found {count}")
    size = len(cores) // count
    return [tuple(cores[index * size : (index + 1) * size]) for index in range(count)]


@dataclass(slots=True)
class _LocalJob:
    """A process of this machine."""

    process: subprocess.Popen[bytes]
    log: Path
    cores: tuple[int, ...]
    is_over: bool = False
    """Whether whoever polls has seen its end: until then nobody else gets its cores."""

    def poll(self) -> str | None:
        status = self.process.poll()
        self.is_over = status is not None
        return None if status is None else explain_end(status, self.log)

    def stop(self) -> None:
        self.process.terminate()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


class LocalPlace:
    """Cores of this machine, each share with one job at a time."""

    def __init__(self, cores: Sequence[int], jobs: int | None) -> None:
        """Share cores among so many jobs; None takes one a core.

        Raises:
            ConfigError: more jobs than cores.
        """
        self._shares = share_cores(cores, jobs)
        self._jobs: list[_LocalJob] = []
        self._lock = -1

    @property
    def cores_per_run(self) -> int:
        """Cores of a share."""
        return len(self._shares[0])

    @property
    def has_room(self) -> bool:
        """Whether a share is free."""
        return bool(self._free())

    def settle(self, directory: Path, lock: int) -> None:
        """Every job holds the directory as well: a killed sweep may leave some behind."""
        self._lock = lock

    def start(self, arguments: Sequence[str], log: Path) -> _LocalJob:
        """Start a process on a free share."""
        cores = self._free()[0]
        process = start_process(arguments, log, cores=cores, pass_fds=(self._lock,))
        self._jobs.append(_LocalJob(process, log, cores))
        return self._jobs[-1]

    def leave(self) -> None:
        """Nothing is taken."""

    def _free(self) -> list[tuple[int, ...]]:
        self._jobs = [job for job in self._jobs if not job.is_over]
        taken = {job.cores for job in self._jobs}
        return [share for share in self._shares if share not in taken]
