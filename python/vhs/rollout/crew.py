"""The crew of a pool: its worker processes, and what follows the death of one.

Invariant: a slot is reclaimed only after its worker's process has been reaped, so no dead worker's hand is
ever on it.
"""

from __future__ import annotations

import contextlib
import logging
import os
import time
from collections.abc import Sequence
from multiprocessing.util import Finalize

from vhs._core import RolloutLearner
from vhs.rollout.errors import WorkerError
from vhs.rollout.processes import LEAVE_LIMIT_S, Context, EnvFn, Worker, new_stack_file
from vhs.rollout.worker import Common, Setup

MOST_BARREN_DEATHS = 3
"""Deaths in a row without a single answer after which a worker is given up."""

_log = logging.getLogger(__name__)


class Crew:
    """The processes of a pool; ended by `close`, or when the crew is forgotten."""

    def __init__(
        self,
        end: RolloutLearner,
        context: Context,
        common: Common,
        env_fns: Sequence[EnvFn],
        cores: Sequence[int | None],
    ) -> None:
        """Start a process for each core, each with an equal share of the environments."""
        self._end = end
        self._start_limit_s = common.start_limit_s
        each = len(env_fns) // len(cores)
        setups = [
            Setup(
                common,
                worker,
                list(env_fns[worker * each : (worker + 1) * each]),
                new_stack_file(worker),
                cpu,
            )
            for worker, cpu in enumerate(cores)
        ]
        self._workers = [Worker(context, setup) for setup in setups]
        self._barren_deaths = [0] * len(setups)
        files = [setup.stack_file.number for setup in setups]
        # Not by `weakref`: multiprocessing waits for its processes at exit, and these must be told to end.
        self.close = Finalize(self, _close, (end, self._workers, files, os.getpid()), exitpriority=10)
        """Ends everything; may be called again."""
        try:
            for worker in range(len(setups)):
                self._start(worker)
        except BaseException:
            self.close()
            raise

    @property
    def pids(self) -> list[int | None]:
        """Numbers of the processes, in the order of the workers."""
        return [worker.pid for worker in self._workers]

    def replace(self, worker: int, *, was_overdue: bool) -> tuple[list[int], str]:
        """Take a dead worker's slots and start another process in its place.

        Returns:
            Environments whose commands or answers are lost and must be asked anew, and what it died of.

        Raises:
            WorkerError: it has died again and again; everything is ended.
        """
        code = self._workers[worker].reap()
        stack = self._workers[worker].stack()
        lost, has_answered = self._end.reclaim(worker)
        cause = "it took longer than allowed" if was_overdue else f"exit code {code}"
        told = f"; its stack was\n{stack}" if stack else ""
        _log.warning("worker %d died (%s): starting another%s", worker, cause, told)
        self._barren_deaths[worker] = 0 if has_answered else self._barren_deaths[worker] + 1
        if self._barren_deaths[worker] >= MOST_BARREN_DEATHS:
            self.close()
            raise WorkerError(f"worker {worker} died {MOST_BARREN_DEATHS} times without an answer ({cause})")
        self._start(worker)
        return lost, cause

    def _start(self, worker: int) -> None:
        self._end.expect_start(worker, self._start_limit_s)
        self._end.watch(worker, self._workers[worker].start())


def _close(end: RolloutLearner, workers: list[Worker], files: list[int], owner: int) -> None:
    """Undo everything; in a fork of the learner nothing is the fork's to undo."""
    if os.getpid() != owner:
        return
    end.close()
    until = time.monotonic() + LEAVE_LIMIT_S
    for worker in workers:
        worker.leave(max(0.0, until - time.monotonic()))
    for file in files:
        with contextlib.suppress(OSError):  # it must not hide what went wrong before
            os.close(file)
