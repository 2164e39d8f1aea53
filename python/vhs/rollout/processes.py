"""Starting, ending and describing worker processes. Nothing here knows of slots.

The spaces of an environment are found out by a short-lived process: making one in the learner's process would
leave its GL contexts, threads and locks to every fork.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import ForkContext, SpawnContext
from typing import Any

import cloudpickle  # type: ignore[import-untyped]
import gymnasium
from gymnasium.vector.utils import CloudpickleWrapper

from vhs._core import ArgumentError
from vhs.rollout.errors import Failure, WorkerError
from vhs.rollout.inherited import Inherited
from vhs.rollout.options import EnvFn
from vhs.rollout.worker import Setup, work

Context = ForkContext | SpawnContext


@dataclass(frozen=True)
class Description:
    """What a pool has to know of its environments before the first is made in a worker."""

    observation_space: gymnasium.Space[Any]
    action_space: gymnasium.Space[Any]
    metadata: dict[str, Any]
    render_mode: str | None
    spec: Any


class Worker:
    """The process that is worker `number` at present."""

    def __init__(self, context: Context, setup: Setup) -> None:
        """Remember how to start it."""
        self._context, self._setup = context, setup
        self._process: Any = None

    def start(self) -> int:
        """Start a process and return its number."""
        name = f"vhs-rollout-{self._setup.worker}"
        self._process = started(self._context, name, work, self._setup, is_lasting_thread())
        return int(self._process.pid)

    @property
    def pid(self) -> int | None:
        """The process's number, if one was started."""
        return None if self._process is None else self._process.pid

    def reap(self) -> int | None:
        """Take leave of a process that has ended; its exit code, or minus a signal's number."""
        self._process.join()
        return self._process.exitcode  # type: ignore[no-any-return] # multiprocessing says so

    def leave(self, limit_s: float) -> bool:
        """Wait until the process ends, and kill it after `limit_s` seconds; whether it ended by itself."""
        if self._process is None:
            return True
        self._process.join(limit_s)
        is_killed = self._process.is_alive()
        if is_killed:
            self._process.kill()
            self._process.join()
        self._process.close()
        self._process = None
        return not is_killed

    def stack(self) -> str:
        """What the process wrote down of its Python stack when it was overdue; forgotten after this."""
        file = self._setup.stack_file.number
        size = os.fstat(file).st_size
        text = os.pread(file, size, 0).decode(errors="replace")
        os.ftruncate(file, 0)
        os.lseek(file, 0, os.SEEK_SET)
        return text


def find_context(start_method: str | None) -> Context:
    """The context of a start method: by default fork, or spawn where `multiprocessing` was told to spawn.

    A forkserver, the default of Python 3.14, would be the parent of the workers in the place of this process.

    Raises:
        ArgumentError: another word.
    """
    if start_method is None:
        # To ask without `allow_none` would fix the method for the whole process.
        is_told_to_spawn = multiprocessing.get_start_method(allow_none=True) == "spawn"
        start_method = "spawn" if is_told_to_spawn else "fork"
    if start_method == "fork":
        return multiprocessing.get_context("fork")
    if start_method == "spawn":
        return multiprocessing.get_context("spawn")
    raise ArgumentError(f"start_method: expected 'fork', 'spawn' or None, got {start_method!r}")


def portable(env_fns: Sequence[EnvFn], context: Context) -> list[EnvFn]:
    """Functions that reach a new process: lambdas and closures too."""
    if isinstance(context, ForkContext):
        return list(env_fns)
    return [CloudpickleWrapper(env_fn) for env_fn in env_fns]


def describe(env_fn: EnvFn, context: Context, limit_s: float) -> Description:
    """Make an environment in a process of its own and ask it for its spaces.

    Raises:
        Exception: whatever `env_fn` raised, with its traceback.
        WorkerError: the process died or took longer than `limit_s` seconds.
    """
    ours, theirs = context.Pipe(duplex=False)
    with closing(ours):
        with closing(theirs):
            process = started(context, "vhs-rollout-probe", _describe, env_fn, theirs)
        try:
            if not ours.poll(limit_s):
                raise WorkerError(f"env_fn: expected an environment within {limit_s} s, found none")
            found = pickle.loads(ours.recv_bytes())
        except EOFError:
            process.join()
            raise WorkerError(
                f"env_fn: its process died with exit code {process.exitcode}{_hint(context)}"
            ) from None
        finally:
            process.kill()
            process.join()
            process.close()
    if isinstance(found, Failure):
        raise found.exception()
    assert isinstance(found, Description)
    return found


def _hint(context: Context) -> str:
    if isinstance(context, ForkContext):
        return ""
    return "; a script whose processes are spawned needs its `if __name__ == '__main__':`"


def started(context: Context, name: str, work: Callable[..., None], *arguments: Any) -> Any:
    """A process that may have children of its own, started by one that may be a daemon of `multiprocessing`.

    Nothing outlives its learner all the same: workers end with it (`RolloutWorker.end_with`).
    """
    process = context.Process(target=work, args=arguments, name=name, daemon=False)
    here = multiprocessing.current_process()
    if not here.daemon:
        process.start()
        return process
    here.daemon = False
    try:
        process.start()
    finally:
        here.daemon = True
    return process


def check_system(num_workers: int) -> None:
    """Refuse to begin what could not be finished.

    Raises:
        WorkerError: the process ignores the signal of its children's ends, and so cannot learn how they
            ended.
        OSError: too few descriptors may be open at once.
    """
    if signal.getsignal(signal.SIGCHLD) is signal.SIG_IGN:
        raise WorkerError(
            "SIGCHLD: expected it to be heard, found it ignored, so that nobody can tell how a worker ends; "
            "call signal.signal(signal.SIGCHLD, signal.SIG_DFL) first"
        )
    # A worker needs a pidfd, a file and two pipe ends; the pool memory, a file, pipes and copies of
    # descriptors.
    wanted, files = 4 * num_workers + 12, list[int]()
    try:
        while len(files) < wanted:
            files.append(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))
    except OSError as error:
        found = f"found {len(files)}: {error.strerror} (see ulimit -n)"
        raise OSError(
            error.errno, f"a pool of {num_workers} workers: expected {wanted} free descriptors, {found}"
        ) from None
    finally:
        for file in files:
            os.close(file)


def cores_for(num_workers: int, pin: bool | None) -> list[int | None]:
    """The core of each worker: one each where they fit (or `pin` insists), no particular one otherwise."""
    cores = sorted(os.sched_getaffinity(0))
    if pin is False or (pin is None and num_workers > len(cores)):
        return [None] * num_workers
    return [cores[worker % len(cores)] for worker in range(num_workers)]


def new_file(name: str) -> Inherited:
    """A file in memory that is in no folder."""
    return Inherited(os.memfd_create(f"vhs-rollout-{name}"))


def is_lasting_thread() -> bool:
    """Whether this thread lives as long as its process: the kernel's parent-death signal means the thread."""
    return threading.current_thread() is threading.main_thread()


def _describe(env_fn: EnvFn, pipe: Connection) -> None:
    try:
        env = env_fn()
        found = Description(
            env.observation_space, env.action_space, dict(env.metadata), env.render_mode, _picklable(env.spec)
        )
        packed = cloudpickle.dumps(found)
        env.close()
    except Exception as error:  # whatever a user's function raises travels to the learner
        failure = Failure.of(error, worker=-1, env=-1, seed=None, step=0, call="env_fn")
        packed = pickle.dumps(failure)
    pipe.send_bytes(packed)
    pipe.close()


def _picklable(value: Any) -> Any:
    """The value, or None where it cannot be pickled."""
    try:
        pickle.dumps(value)
    except Exception:  # a spec with a closure in it; it is a courtesy, not a need
        return None
    return value
