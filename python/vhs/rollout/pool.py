"""`RolloutPool`: environments in worker processes, stepped by `send` and `recv`.

Owns the learner's end of the shared memory, the processes, and what follows a death or an error. Invariants:
an environment has at most one command under way; answers come in batches ordered by environment; a lost
episode is announced with the next one's first observation (`Batch.is_cut`), never silently joined to it.
"""

from __future__ import annotations

import logging
import math
import os
import pickle
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhs._core import ArgumentError, LabelError, ProtocolError, RolloutLearner
from vhs.rollout.batch import BLOB, QUARANTINED, Batch, Blobs, Blocks
from vhs.rollout.crew import Crew
from vhs.rollout.errors import Failure, PoolClosedError, WorkerError
from vhs.rollout.inherited import Inherited
from vhs.rollout.leaves import Nest
from vhs.rollout.processes import (
    EnvFn,
    cores_for,
    describe,
    find_context,
    is_lasting_thread,
    portable,
)
from vhs.rollout.worker import BEGIN, CALL, DUMP_SIGNAL, FAILED, STEP, Autoreset, Common

OnError = Literal["raise", "restart", "drop"]

MOST_FAILED_BEGINS = 3
"""Failures in a row to begin an episode after which an environment is not restarted again."""

SLICE_S = 0.1
"""How long to wait at most before Python looks after signals, in seconds."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class PoolStats:
    """Counters since the pool was made."""

    steps: int
    """Steps delivered."""
    episodes: int
    """Episodes that ended and were delivered."""
    cut_episodes: int
    """Episodes dropped: their worker died, they raised or they showed a NaN."""
    quarantined_episodes: int
    """Those among them that showed a NaN."""
    restarts: int
    """Processes started in place of dead ones."""


class RolloutPool:
    """Environments in worker processes that write their observations straight into shared memory.

    Begin with `reset`, then `recv` batches and `send` actions for their `env_ids`. `recv(1)` takes whatever
    is ready first; `recv()` waits for all environments (lock-step), and then results do not depend on the
    number of workers. One thread at a time. A context manager; `close` may be called any number of times.
    """

    def __init__(
        self,
        env_fn: EnvFn | Sequence[EnvFn],
        num_workers: int,
        envs_per_worker: int = 1,
        *,
        seed: int | None = None,
        autoreset: str | Autoreset = Autoreset.SAME_STEP,
        on_error: OnError = "raise",
        deadline_s: float | None = None,
        start_limit_s: float = 60.0,
        start_method: str | None = None,
        pin: bool | None = None,
        info_bytes: int = 1 << 16,
    ) -> None:
        """Start the workers; environments are made with their first episode.

        Args:
            env_fn: makes an environment, called in the worker; or one such function for each environment.
            num_workers: processes.
            envs_per_worker: environments that each of them steps, one after another.
            seed: from which every episode's seed follows; without one, environments seed themselves.
            autoreset: what follows the end of an episode: "SameStep" (the batch has the next episode's first
                observation, and the final one apart), "NextStep" or "Disabled".
            on_error: when an environment raises: "raise" the error here, "restart" the environment with its
                next episode, or "drop" it for good.
            deadline_s: most seconds for one step or reset; a worker that overruns is killed and started anew.
                None is for ever.
            start_limit_s: most seconds for a process to start or an environment to be made.
            start_method: "fork" or "spawn"; by default fork where the platform forks.
            pin: give each worker a core of its own; by default where they fit.
            info_bytes: room for one pickled info, error, call or set of reset options; costs memory only
                where used.

        Raises:
            ArgumentError: an argument out of range.
            Exception: whatever `env_fn` raised, with its traceback.
        """
        self._on_error = _checked_policy(on_error)
        self.autoreset = _checked_autoreset(autoreset)
        self.num_workers = _checked_size("num_workers", num_workers)
        self.envs_per_worker = _checked_size("envs_per_worker", envs_per_worker)
        self.num_envs = num_workers * envs_per_worker
        context = find_context(start_method)
        env_fns = portable(_one_each(env_fn, self.num_envs), context)
        self.description = describe(env_fns[0], context, start_limit_s)
        self.single_observation_space = self.description.observation_space
        self.single_action_space = self.description.action_space
        self._observations = Nest(self.single_observation_space, "observation")
        self._actions = Nest(self.single_action_space, "action")
        sizes = (num_workers, envs_per_worker, self._actions.nbytes, self._observations.nbytes, info_bytes)
        leaves = [(leaf.offset, leaf.nbytes) for leaf in self._observations.leaves]
        self._end = RolloutLearner(sizes, leaves, _checked_seed(seed), deadline_s, int(DUMP_SIGNAL))
        self._blocks = Blocks(self._end.block_bytes, self._end.columns, self.num_envs, self._observations)
        self._blobs = Blobs(self._end)
        self._under_way = 0
        """Environments with a command whose answer has not been received."""
        self._active = np.arange(self.num_envs)
        """Environments that have not been dropped."""
        self._failed_begins = [0] * self.num_envs
        """Failures in a row to begin an episode, by environment."""
        self._called: dict[int, Any] = {}
        """Results of the call under way, by environment; a `Failure` where one raised."""
        self._died: list[str] = []
        """What became of workers during the call under way."""
        self._in_call = False
        """Whether commands under way are those of a call."""
        self._closed = False
        common = Common(
            memory=Inherited(self._end.memory),
            sizes=sizes,
            observation_space=self.single_observation_space,
            action_space=self.single_action_space,
            autoreset=self.autoreset,
            deadline_s=deadline_s,
            start_limit_s=start_limit_s,
            parent=os.getpid(),
            ends_by_signal=is_lasting_thread(),
        )
        self._crew = Crew(self._end, context, common, env_fns, cores_for(num_workers, pin))

    # -- stepping

    def reset(
        self,
        env_ids: ArrayLike | None = None,
        *,
        seeds: Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> None:
        """Ask environments to begin an episode; the first observations come by `recv`.

        Args:
            env_ids: which, all by default. None of them may have a command under way.
            seeds: one an environment, None for an unseeded one; by default the seeds that `seed_next` or the
                pool's own seed gave.
            options: passed to every `Env.reset`.

        Raises:
            LabelError: an environment that does not exist.
            ProtocolError: an environment that has a command under way.
        """
        self._check_open()
        self._await_call()
        ids = self._ids(env_ids)
        blob = b"" if options is None else pickle.dumps(options, protocol=pickle.HIGHEST_PROTOCOL)
        if seeds is not None:
            self.seed_next(ids, seeds)
        self._end.send(ids, [], BEGIN, 0, blob)
        self._under_way += len(ids)

    def seed_next(self, env_ids: ArrayLike, seeds: Sequence[int | None]) -> None:
        """Fix the seeds of the episodes that environments begin next, by `reset` or by autoreset.

        A seed counts from the environment's next `send` on, so give it before the step that may end the
        episode. Once an episode has begun, the seed after it is again the pool's own choice (see `seed` of
        the constructor).
        """
        self._check_open()
        self._end.seed_next(self._ids(env_ids), [_checked_seed(seed) for seed in seeds])

    def send(self, actions: Any, env_ids: ArrayLike | None = None, version: int = 0) -> None:
        """Give actions to environments whose last answers have been received.

        An environment without a running episode (never reset, or ended before) begins one instead.

        Args:
            actions: nested as the action space, each leaf [n, ...]; tensors on the CPU will do.
            env_ids: which environments, int [n]; all by default.
            version: number of the policy that chose the actions, given back in `Batch.versions`.

        Raises:
            LabelError: an environment that does not exist.
            ProtocolError: an environment that has a command under way.
            ShapeError: actions of another shape.
            DtypeError: actions that cannot be stored in the action space's type.
        """
        self._check_open()
        self._await_call()
        ids = self._ids(env_ids)
        count = len(ids)
        self._end.send(ids, self._actions.rows(actions, count), STEP, version, b"")
        self._under_way += count

    def recv(self, min_envs: int | None = None, timeout: float | None = None) -> Batch:
        """Wait until enough environments have answered and take all that have.

        Args:
            min_envs: how many; all with a command under way by default (lock-step).
            timeout: most seconds to wait, None for ever.

        Returns:
            At least `min_envs` answers, in the order of their environments.

        Raises:
            TimeoutError: too few answered in time; nothing is lost, receive again.
            ProtocolError: more are wanted than have a command under way.
            WorkerError: a worker died again and again.
            Exception: what an environment raised, where `on_error` is "raise"; receive again for the others.
        """
        self._check_open()
        self._await_call()
        wanted = self._under_way if min_envs is None else min_envs
        if not 0 < wanted <= self._under_way:
            found = f"{self._under_way} under way"
            raise ProtocolError(
                f"`recv`: expected 1 to as many environments as have a command, found {found}"
            )
        block = self._blocks.take()
        until = math.inf if timeout is None else time.monotonic() + timeout
        slice_s = SLICE_S if timeout is None else min(SLICE_S, timeout)
        while (filled := self._end.recv(block.bytes, wanted, slice_s)) is None:
            self._attend()
            wanted = self._still_wanted(wanted, is_lockstep=min_envs is None)
            slice_s = min(SLICE_S, until - time.monotonic())
            if slice_s <= 0.0:
                # A death or a notice keeps back what lies ready: look once more now that it is seen to.
                filled = self._end.recv(block.bytes, wanted, 0.0)
                if filled is not None:
                    break
                raise TimeoutError(
                    f"expected {wanted} environments to answer within {timeout} s, found fewer"
                )
        rows, finals, notable = filled
        self._under_way -= rows
        batch = Batch(block, rows, finals, self._observations)
        if notable:
            self._see_to(batch)
        return batch

    # -- environments as objects

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every environment, or read an attribute; none may have a command under way.

        Returns:
            Results in the order of the environments.
        """
        return self.call_each(name, [(args, kwargs)] * self.num_envs)

    def call_each(
        self, name: str, arguments: Sequence[tuple[tuple[Any, ...], dict[str, Any]]]
    ) -> tuple[Any, ...]:
        """As `call`, with arguments for each environment: positional ones and keywords."""
        self._check_open()
        self._await_call()
        if self._under_way:
            raise ProtocolError(f"`call`: expected no commands under way, found {self._under_way}")
        self._called.clear()
        self._died.clear()
        ids = self._ids(None)
        for env in ids.tolist():
            blob = pickle.dumps((name, *arguments[env]), protocol=pickle.HIGHEST_PROTOCOL)
            self._in_call = True
            self._end.send([env], [], CALL, 0, blob)
            self._under_way += 1
        self._await_call()
        if self._died:
            raise WorkerError("; ".join(self._died))
        for result in self._called.values():
            if isinstance(result, Failure):
                raise result.exception()
        return tuple(self._called.get(env) for env in range(self.num_envs))

    def _await_call(self) -> None:
        """Wait for the answers to a call, and to one that Ctrl-C interrupted, which nobody reads any more."""
        while self._in_call and self._under_way:
            # A call is answered by a notice alone, so a batch is never ready and this looks after notices and
            # deaths.
            self._end.wait(1, SLICE_S)
            self._attend(during_call=True)
        self._in_call = False

    # -- state

    @property
    def stats(self) -> PoolStats:
        """Counters since the pool was made."""
        return PoolStats(*self._end.stats)

    @property
    def pids(self) -> list[int | None]:
        """Numbers of the worker processes, in the order of the workers."""
        return self._crew.pids

    @property
    def active_env_ids(self) -> NDArray[np.int64]:
        """Environments that have not been dropped, ascending."""
        return self._active.copy()

    @property
    def num_under_way(self) -> int:
        """Environments with a command whose answer has not been received."""
        return self._under_way

    def reseed(self, seed: int | None) -> None:
        """Start the rule for seeds over, as if the pool had been made with this seed.

        It counts from the next `send` on.
        """
        self._check_open()
        self._end.reseed(_checked_seed(seed))

    def close(self) -> None:
        """End the workers and free the memory; batches stay as they are. May be called again."""
        if not self._closed:
            self._closed = True
            self._crew.close()

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed

    def __enter__(self) -> Self:
        """The pool itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def __repr__(self) -> str:
        """Its size and state."""
        state = "closed" if self._closed else f"{self._under_way} under way"
        return f"RolloutPool({self.num_workers} workers x {self.envs_per_worker} environments, {state})"

    # -- waiting and repairing

    def _still_wanted(self, wanted: int, *, is_lockstep: bool) -> int:
        """How many answers to wait for: an environment that was dropped meanwhile will never answer."""
        if wanted <= self._under_way:
            return wanted
        if self._under_way == 0 or not is_lockstep:
            raise WorkerError(f"expected {wanted} answers, but environments were dropped")
        return self._under_way

    def _attend(self, *, during_call: bool = False) -> None:
        """See to the dead and to environments with something to say."""
        for worker, was_overdue in self._end.take_deaths():
            self._replace(worker, was_overdue=was_overdue, during_call=during_call)
        failures = []
        for env, flags, blob_bytes in self._end.take_notices():
            self._under_way -= 1
            found = pickle.loads(self._blobs.read(env, blob_bytes))
            if during_call:
                self._called[env] = found if flags & FAILED else found["result"]
            else:
                failures.append(found)
        for position, failure in enumerate(failures):
            # Should this one raise, those after it are still seen to: their environments wait for a reset.
            self._fail(failure, failures[position + 1 :])

    def _fail(self, failure: Failure, others: Iterable[Failure]) -> None:
        error = failure.exception()
        if self._on_error == "raise":
            for other in others:
                _log.error("%s %s as well\n%s", other.kind, other.where(), other.text)
            raise error
        _log.warning("%s %s: %s\n%s", failure.kind, failure.where(), self._on_error, failure.text)
        if self._on_error == "drop":
            self._active = self._active[self._active != failure.env]
            return
        is_beginning = failure.call == "reset" or failure.step == 0
        self._failed_begins[failure.env] = self._failed_begins[failure.env] + 1 if is_beginning else 0
        if self._failed_begins[failure.env] >= MOST_FAILED_BEGINS:
            raise error
        self._end.send([failure.env], [], BEGIN, 0, b"")
        self._under_way += 1

    def _replace(self, worker: int, *, was_overdue: bool, during_call: bool) -> None:
        """A process has died: have it replaced and ask the new one for what is owed."""
        try:
            lost, cause = self._crew.replace(worker, was_overdue=was_overdue)
        except WorkerError:
            self.close()
            raise
        if during_call:
            # Said once the others have answered: a pool with answers under way could not be used again.
            self._under_way -= len(lost)
            self._died.append(f"worker {worker} died ({cause}) during a call")
            return
        # Their commands stay under way; the answers will be the first observations of new episodes.
        self._end.send(lost, [], BEGIN, 0, b"")

    def _see_to(self, batch: Batch) -> None:
        """Unpickle infos and report quarantines."""
        for row, env, flags, blob_bytes in batch.notable():
            if flags & BLOB:
                batch.infos[row] = pickle.loads(self._blobs.read(env, blob_bytes))
            if flags & QUARANTINED:
                report = batch.infos[row]["quarantine"]
                place = (
                    f"{report['where']} at step {report['step']} of the episode with seed {report['seed']}"
                )
                _log.warning("environment %d: NaN in %s; the episode is dropped", env, place)

    # -- checks

    def _ids(self, env_ids: ArrayLike | None) -> NDArray[np.int64]:
        if env_ids is None:
            return self._active
        ids = np.asarray(env_ids)
        if len(self._active) < self.num_envs:
            gone = np.setdiff1d(ids, self._active)
            if len(gone):
                raise LabelError(
                    f"`env_ids`: expected environments that were not dropped, got {gone.tolist()}"
                )
        return ids

    def _check_open(self) -> None:
        if self._closed:
            raise PoolClosedError("expected an open pool, found a closed one")


def _one_each(env_fn: EnvFn | Sequence[EnvFn], num_envs: int) -> list[EnvFn]:
    if callable(env_fn):
        return [env_fn] * num_envs
    if isinstance(env_fn, str) or not isinstance(env_fn, Sequence) or not all(map(callable, env_fn)):
        raise ArgumentError(
            f"env_fn: expected a function that makes an environment, such as lambda: gymnasium.make(...), "
            f"or {num_envs} of them, got {type(env_fn).__name__}"
        )
    if len(env_fn) != num_envs:
        raise ArgumentError(f"env_fn: expected one function or {num_envs} of them, got {len(env_fn)}")
    return list(env_fn)


def _checked_size(name: str, size: int) -> int:
    if size < 1:
        raise ArgumentError(f"`{name}`: expected a number of at least 1, got {size}")
    return size


def _checked_policy(on_error: OnError) -> OnError:
    if on_error not in get_args(OnError):
        raise ArgumentError(f"on_error: expected one of {get_args(OnError)}, got {on_error!r}")
    return on_error


def _checked_autoreset(autoreset: str | Autoreset) -> Autoreset:
    try:
        return Autoreset(autoreset)
    except ValueError:
        known = [mode.value for mode in Autoreset]
        raise ArgumentError(f"autoreset: expected one of {known}, got {autoreset!r}") from None


def _checked_seed(seed: int | None) -> int | None:
    if seed is None:
        return None
    number = int(seed)
    if not 0 <= number < 1 << 64:
        raise ArgumentError(f"seed: expected an integer in 0..2**64, got {number}")
    return number
