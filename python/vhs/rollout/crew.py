"""The crew of a pool: its worker processes, and what follows the death of one.

Invariant: a slot is reclaimed only after its worker's process has been reaped, so no dead worker's hand is
ever on it.
"""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.util import Finalize

from vhs._core import RolloutLearner
from vhs.rollout.errors import PoolClosedError, WorkerError
from vhs.rollout.options import EnvFn
from vhs.rollout.processes import Context, Worker, new_file
from vhs.rollout.worker import Common, Setup

MOST_BARREN_DEATHS = 3
"""Deaths in a row without a single answer after which a worker is given up."""

_log = logging.getLogger(__name__)


@dataclass
class _Members:
    """All that is to be ended, apart from the crew itself, whose end may be what ends it."""

    end: RolloutLearner
    close_limit_s: float
    files: list[int]
    """Descriptors to be closed."""
    workers: list[Worker] = field(default_factory=list)
    owner: int = field(default_factory=os.getpid)
    lock: threading.RLock = field(default_factory=threading.RLock)
    """Who replaces a worker or ends them has it."""
    is_over: bool = False


class Crew:
    """The processes of a pool; ended by `close`, or when the crew is forgotten."""

    def __init__(
        self,
        end: RolloutLearner,
        context: Context,
        common: Common,
        env_fns: Sequence[EnvFn],
        cores: Sequence[int | None],
        close_limit_s: float,
    ) -> None:
        """Start a process for each core, each with an equal share of the environments."""
        self._end = end
        self._start_limit_s = common.start_limit_s
        self._members = members = _Members(end, close_limit_s, [common.overflow.number])
        self._barren_deaths = [0] * len(cores)
        # Not by `weakref`: multiprocessing waits for its processes at exit, and these must be told to end.
        self._finalizer = Finalize(self, _close, (members,), exitpriority=10)
        each = len(env_fns) // len(cores)
        try:
            for worker, cpu in enumerate(cores):
                stack_file = new_file(f"stack-{worker}")
                members.files.append(stack_file.number)
                share = list(env_fns[worker * each : (worker + 1) * each])
                members.workers.append(Worker(context, Setup(common, worker, share, stack_file, cpu)))
                self._start(worker)
        except BaseException:
            self.close()
            raise

    @property
    def pids(self) -> list[int | None]:
        """Numbers of the processes, in the order of the workers."""
        return [worker.pid for worker in self._members.workers]

    def close(self, limit_s: float | None = None) -> None:
        """End everything; may be called again, and by any thread.

        Args:
            limit_s: most seconds for the workers to close their environments; None is what the pool was made
                with.
        """
        if limit_s is not None:
            self._members.close_limit_s = limit_s
        self._finalizer()

    def replace(self, worker: int, *, was_overdue: bool, again: bool) -> tuple[list[int], str]:
        """Take a dead worker's slots and start another process in its place.

        Args:
            worker: the dead one.
            was_overdue: whether it was killed for taking too long.
            again: whether environments whose commands or answers are lost are to begin an episode.

        Returns:
            Those environments, and what it died of.

        Raises:
            WorkerError: it has died again and again.
            PoolClosedError: everything is being ended by another thread.
        """
        with self._members.lock:
            if self._members.is_over:
                raise PoolClosedError("expected an open pool, found a closed one")
            dead = self._members.workers[worker]
            code, stack = dead.reap(), dead.stack()
            lost, has_answered = self._end.reclaim(worker, again)
            cause = "it took longer than allowed" if was_overdue else f"exit code {code}"
            told = f"; its stack was\n{stack}" if stack else ""
            _log.warning("worker %d died (%s): starting another%s", worker, cause, told)
            self._barren_deaths[worker] = 0 if has_answered else self._barren_deaths[worker] + 1
            if self._barren_deaths[worker] >= MOST_BARREN_DEATHS:
                raise WorkerError(
                    f"worker {worker} died {MOST_BARREN_DEATHS} times without an answer ({cause})"
                )
            self._start(worker)
        return lost, cause

    def _start(self, worker: int) -> None:
        self._end.expect_start(worker, self._start_limit_s)
        self._end.listen_to(worker, self._members.workers[worker].start())


def _close(members: _Members) -> None:
    """Undo everything; in a fork of the learner nothing is the fork's to undo."""
    if os.getpid() != members.owner:
        return
    members.end.close()
    until = time.monotonic() + members.close_limit_s
    with members.lock:
        members.is_over = True
        try:
            for number, worker in enumerate(members.workers):
                if not worker.leave(max(0.0, until - time.monotonic())):
                    _log.warning(
                        "worker %d was killed: its environments were not closed %.3g s after it was told to "
                        "(`close_limit_s`)",
                        number,
                        members.close_limit_s,
                    )
        except BaseException:  # a second Ctrl-C: nobody wants to wait
            for worker in members.workers:
                worker.leave(0.0)
            raise
        finally:
            for file in members.files:
                with contextlib.suppress(OSError):  # it must not hide what went wrong before
                    os.close(file)
            members.files.clear()
            members.end.free()
