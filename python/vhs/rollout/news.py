"""News of a pool: deaths, errors and answers to calls, and what is done about each.

All of it is done as a whole: a signal handler that raises in the middle, as Ctrl-C does, finds it done.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from vhs._core import RolloutLearner
from vhs.rollout.batch import Blobs
from vhs.rollout.crew import Crew
from vhs.rollout.errors import Failure, WorkerError
from vhs.rollout.options import OnError
from vhs.rollout.parcels import Parcels
from vhs.rollout.signals import undisturbed
from vhs.rollout.worker import BEGIN, FAILED

MOST_FAILED_BEGINS = 3
"""Failures in a row to begin an episode after which an environment is not restarted again."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Mail:
    """What the learner sends to and hears from its environments, pickled."""

    _blobs: Blobs
    _parcels: Parcels

    def pack(self, env: int, thing: Any) -> bytes:
        """What is to be sent with the next command; the environment must be held."""
        return self._parcels.pack(env, thing)

    def read(self, env: int, nbytes: int) -> Any:
        """What came with the last answer; may be called again until the next command."""
        return self._parcels.unpack(env, self._blobs.read(env, nbytes))


class News:
    """What a learner hears beside the batches."""

    def __init__(self, end: RolloutLearner, crew: Crew, mail: Mail, num_envs: int, on_error: OnError) -> None:
        """Begin to listen; `on_error` is that of `RolloutPool`."""
        self._end, self._crew, self._mail, self._on_error = end, crew, mail, on_error
        self.active = np.arange(num_envs)
        """Environments that have not been dropped."""
        self._failed_begins = [0] * num_envs
        """Failures in a row to begin an episode, by environment."""
        self._error: BaseException | None = None
        """Of an environment, still to be raised."""
        self._called: dict[int, Any] = {}
        """Results of the last call, by environment; a `Failure` where one raised."""
        self._died: list[str] = []
        """What became of workers during the last call."""

    def see_to(self, *, during_call: bool) -> None:
        """See to all there is.

        A call loses what a dead worker owed; a batch gets the beginning of an episode in its place.

        Raises:
            WorkerError: a worker died again and again; the pool is of no use any more.
            OSError: no process could be started.
        """
        if self._end.has_news():
            undisturbed(partial(self._attend, during_call=during_call))

    def raise_error(self) -> None:
        """Raise what an environment raised, once.

        Raises:
            Exception: that.
        """
        # No call between the two, so that a signal handler cannot lose it.
        error, self._error = self._error, None
        if error is not None:
            raise error

    def forget_call(self) -> None:
        """A call begins."""
        self._called.clear()
        self._died.clear()

    def results(self) -> dict[int, Any]:
        """The results of a call, by environment.

        Raises:
            WorkerError: a worker died of it.
            Exception: what an environment raised.
        """
        if self._died:
            raise WorkerError("; ".join(self._died))
        for result in self._called.values():
            if isinstance(result, Failure):
                raise result.exception()
        return self._called

    def _attend(self, *, during_call: bool = False) -> None:
        """Replace the dead, and hear environments with something to say."""
        for worker, was_overdue in self._end.take_deaths():
            _, cause = self._crew.replace(worker, was_overdue=was_overdue, again=not during_call)
            if during_call:
                # Said once the others have answered: a pool with answers under way could not be used again.
                self._died.append(f"worker {worker} died ({cause}) during a call")
        failures = []
        for env, flags, blob_bytes in self._end.take_notices():
            try:
                found = self._mail.read(env, blob_bytes)
            except Exception as error:  # of a class that this process does not know
                found = Failure.of(error, worker=-1, env=env, seed=None, step=0, call="unpickle")
            if during_call:
                self._called[env] = found["result"] if type(found) is dict and not flags & FAILED else found
            else:
                failures.append(found)
        for failure in failures:
            self._fail(failure)

    def _fail(self, failure: Failure) -> None:
        """Do about a failed step or reset what `on_error` says."""
        if self._on_error == "raise":
            self._raise_later(failure)
            return
        _log.warning("%s %s: %s\n%s", failure.kind, failure.where(), self._on_error, failure.text)
        if self._on_error == "drop":
            self.active = self.active[self.active != failure.env]
            return
        is_beginning = failure.call == "reset" or failure.step == 0
        self._failed_begins[failure.env] = self._failed_begins[failure.env] + 1 if is_beginning else 0
        if self._failed_begins[failure.env] >= MOST_FAILED_BEGINS:
            self._raise_later(failure)
        else:
            self._end.send([failure.env], [], BEGIN, 0, [])

    def _raise_later(self, failure: Failure) -> None:
        """Have the first error raised and log others with it; their environments wait for a reset."""
        if self._error is None:
            self._error = failure.exception()
        else:
            _log.error("%s %s as well\n%s", failure.kind, failure.where(), failure.text)
