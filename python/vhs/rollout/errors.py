"""What goes wrong in a worker, as the learner sees it: the original error, its traceback and its place."""

from __future__ import annotations

import multiprocessing
import pickle
import traceback
from dataclasses import dataclass, replace

from gymnasium.error import ClosedEnvironmentError

from vhs._core import VhsError


class WorkerError(VhsError, RuntimeError):
    """A worker cannot go on: it died again and again, or its error cannot be carried over as it was."""


class PoolClosedError(VhsError, ClosedEnvironmentError, RuntimeError):
    """A call on a pool that is closed."""


class AnswerTimeoutError(VhsError, TimeoutError, multiprocessing.TimeoutError):
    """Too few environments answered in time; nothing is lost."""


class RemoteTraceback(Exception):
    """The traceback of an error in its worker, as text: frames cannot leave their process."""

    def __str__(self) -> str:
        """The text, set apart from the local traceback."""
        return f'\n"""\n{self.args[0]}"""'


@dataclass(frozen=True, slots=True)
class Failure:
    """An error of an environment, packed for its way to the learner."""

    worker: int
    env: int
    seed: int | None
    step: int
    call: str
    kind: str
    text: str
    """The traceback as the worker saw it."""
    error: bytes | None
    """The pickled exception; None where it cannot be pickled."""

    @classmethod
    def of(
        cls, error: BaseException, *, worker: int, env: int, seed: int | None, step: int, call: str
    ) -> Failure:
        """Pack an error that is being handled."""
        text = "".join(traceback.format_exception(error))
        return cls(worker, env, seed, step, call, type(error).__qualname__, text, _pickled(error))

    def where(self) -> str:
        """One line that says where it happened."""
        place = f"environment {self.env}, worker {self.worker}, seed {self.seed}, step {self.step}"
        return f"in `{self.call}` of {place}"

    def exception(self) -> BaseException:
        """The original error, or a `WorkerError` that names it, with the worker's traceback as its cause."""
        error = _unpickled(self.error)
        if error is None:
            error = WorkerError(
                f"{self.kind} {self.where()}; it could not be pickled, its traceback is above"
            )
        error.add_note(self.where())
        error.__cause__ = RemoteTraceback(self.text)
        return error

    def bare(self) -> Failure:
        """What is left where memory for the whole is refused: a few hundred bytes."""
        return replace(self, error=None, text=self.text[-200:])


def _pickled(error: BaseException) -> bytes | None:
    """The error, if it survives the way there and back: many exceptions pickle but do not unpickle."""
    try:
        packed = pickle.dumps(error, protocol=pickle.HIGHEST_PROTOCOL)
        pickle.loads(packed)
    except Exception:  # whatever a user's class raises here, it means the same
        return None
    return packed


def _unpickled(packed: bytes | None) -> BaseException | None:
    if packed is None:
        return None
    try:
        error = pickle.loads(packed)
    except Exception:  # its class may exist in the worker alone
        return None
    return error if isinstance(error, BaseException) else None
