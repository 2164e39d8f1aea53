"""`RolloutPool`: environments in worker processes, stepped by `send` and `recv`.

Owns the learner's end of the shared memory, the processes, and what follows a death or an error. Invariants:
an environment has at most one command under way; answers come in batches ordered by environment; a lost
episode is announced with the next one's first observation (`Batch.is_cut`), never silently joined to it; a
call that a signal handler interrupts, as Ctrl-C does, loses nothing: what is under way is counted in Rust, a
filled batch is the pool's until `recv` has returned it, and repairs are done as a whole.
"""

from __future__ import annotations

import logging
import math
import os
import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from gymnasium import Space
from numpy.typing import ArrayLike, NDArray

from vhs._core import ArgumentError, LabelError, ProtocolError, RolloutLearner, VhsError
from vhs.rollout.batch import BLOB, OUTSIDE, QUARANTINED, Batch, Blobs, Block, Blocks
from vhs.rollout.crew import Crew
from vhs.rollout.errors import AnswerTimeoutError, PoolClosedError, WorkerError
from vhs.rollout.inherited import Inherited
from vhs.rollout.leaves import Nest, Unfit
from vhs.rollout.news import Mail, News
from vhs.rollout.options import EnvFn, OnError, Settings, checked_seed, one_each, seconds
from vhs.rollout.parcels import DOWN, Parcels
from vhs.rollout.processes import Context, check_system, cores_for, describe, find_context, new_file, portable
from vhs.rollout.worker import BEGIN, CALL, DUMP_SIGNAL, FINAL, MAKE, STEP, Autoreset, Common

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
    number of workers. One thread at a time, in the process that made it; `close` may be called by any thread,
    any number of times. A context manager.
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
        close_limit_s: float = 10.0,
        start_method: str | None = None,
        pin: bool | None = None,
        info_bytes: int = 1 << 16,
        observation_mode: Literal["same", "different"] | Space[Any] = "same",
    ) -> None:
        """Start the workers; environments are made with their first episode, and now where functions differ.

        Args:
            env_fn: makes an environment, called in the worker; or one such function for each environment.
            num_workers: processes.
            envs_per_worker: environments that each of them steps, one after another.
            seed: from which every episode's seed follows; without one, environments seed themselves.
            autoreset: what follows the end of an episode: "SameStep" (the batch has the next episode's first
                observation, and the final one apart), "NextStep" or "Disabled".
            on_error: when an environment raises: "raise" the error here, "restart" the environment with its
                next episode, or "drop" it for good.
            deadline_s: most seconds for one step, reset or call, and for a worker to take it up; one that
                overruns, hangs or is stopped is killed and started anew. None is for ever.
            start_limit_s: most seconds for a process to start or an environment to be made.
            close_limit_s: most seconds for the workers to end the step under way and close their
                environments, once the pool is closed; who needs longer is killed, and that is logged.
            start_method: "fork" or "spawn"; by default fork, or spawn where `multiprocessing` was told to.
            pin: give each worker a core of its own; by default where they fit. What its environments start is
                not bound to that core.
            info_bytes: room in shared memory for one pickled info, error, call or set of reset options; costs
                memory only where used. What needs more takes a little longer.
            observation_mode: "same": every environment has the first one's observation space; "different":
                one of its shape and type; or a space that stands for all, of their shape and type.

        Raises:
            ArgumentError: an argument out of range.
            DtypeError: an argument of another type.
            RuntimeError: environments whose spaces are not those of the first one.
            OSError: the system lacks what a pool needs.
            Exception: whatever `env_fn` raised, with its traceback.
        """
        settings = Settings(
            num_workers=num_workers,
            envs_per_worker=envs_per_worker,
            seed=seed,
            autoreset=autoreset,  # type: ignore[arg-type] # it may be a word
            on_error=on_error,
            deadline_s=deadline_s,
            start_limit_s=start_limit_s,
            close_limit_s=close_limit_s,
            pin=pin,
            info_bytes=info_bytes,
            observation_mode=observation_mode,
        )
        self.autoreset = settings.autoreset
        self.num_workers, self.envs_per_worker = settings.num_workers, settings.envs_per_worker
        self.num_envs = settings.num_envs
        context = find_context(start_method)
        given = one_each(env_fn, self.num_envs)
        check_system(self.num_workers)
        env_fns = portable(given, context)
        self.description = describe(env_fns[0], context, settings.start_limit_s)
        self.single_observation_space = settings.space(self.description.observation_space)
        self.single_action_space = self.description.action_space
        self._observations = Nest(self.single_observation_space, "observation")
        self._actions = Nest(self.single_action_space, "action")
        self._ticket = 0
        """Batches returned."""
        self._block: Block | None = None
        """Of the batch that is being received, or was when the call was interrupted."""
        self._in_call = False
        """Whether commands under way are those of a call."""
        self._closed = False
        self._start(settings, context, env_fns)
        if settings.observation_mode != "same" or any(env_fn is not given[0] for env_fn in given):
            self._make_all()

    def _start(self, settings: Settings, context: Context, env_fns: Sequence[EnvFn]) -> None:
        """Make the shared memory and start the workers."""
        nbytes = (self._actions.nbytes, self._observations.nbytes, settings.info_bytes)
        sizes = (self.num_workers, self.envs_per_worker, *nbytes)
        leaves = [(leaf.offset, leaf.nbytes) for leaf in self._observations.leaves]
        self._end = RolloutLearner(sizes, leaves, settings.seed, settings.deadline_s, int(DUMP_SIGNAL))
        self._blocks = Blocks(self._end.block_bytes, self._end.columns, self.num_envs, self._observations)
        overflow = new_file("overflow")
        common = Common(
            memory=Inherited(self._end.memory),
            overflow=overflow,
            sizes=sizes,
            observation_space=self.single_observation_space,
            action_space=self.single_action_space,
            are_spaces_equal=settings.observation_mode == "same",
            autoreset=self.autoreset,
            deadline_s=settings.deadline_s,
            start_limit_s=settings.start_limit_s,
            parent=os.getpid(),
            entropy=secrets.randbits(64) if settings.seed is None else settings.seed,
        )
        cores = cores_for(self.num_workers, settings.pin)
        self._crew = Crew(self._end, context, common, env_fns, cores, settings.close_limit_s)
        self._mail = Mail(Blobs(self._end), Parcels(overflow.number, settings.info_bytes, DOWN))
        self._news = News(self._end, self._crew, self._mail, self.num_envs, settings.on_error)

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
        self._check_ready()
        ids = self._ids(env_ids)
        self._end.check_held(ids)
        blobs = [] if options is None else [self._mail.pack(env, options) for env in np.asarray(ids).tolist()]
        if seeds is not None:
            self.seed_next(ids, seeds)
        self._end.send(ids, [], BEGIN, 0, blobs)

    def seed_next(self, env_ids: ArrayLike, seeds: Sequence[int | None]) -> None:
        """Fix the seeds of the episodes that environments begin next, by `reset` or by autoreset.

        A seed counts from the environment's next `send` on, so give it before the step that may end the
        episode. Once an episode has begun, the seed after it is again the pool's own choice (see `seed` of
        the constructor).
        """
        self._check_open()
        self._end.seed_next(self._ids(env_ids), [checked_seed(seed) for seed in seeds])

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
            DtypeError: actions of another kind than the action space's.
        """
        if self._closed or self._in_call or self._block is not None:
            self._check_ready()
        ids = self._ids(env_ids)
        if not self._actions.loose:
            try:
                rows = self._actions.rows(actions, len(ids))
            except Unfit:
                pass  # the environment is to judge it, as it does in gymnasium: it travels as it is
            else:
                self._end.send(ids, rows, STEP, version, ())
                return
        items = self._actions.items(actions, len(ids))
        self._end.check_held(ids)
        blobs = [self._mail.pack(env, item) for env, item in zip(ids.tolist(), items, strict=True)]
        self._end.send(ids, [], STEP, version, blobs)

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
            PoolClosedError: the pool was closed, perhaps by another thread during the call.
            Exception: what an environment raised, where `on_error` is "raise"; receive again for the others.
        """
        if self._closed or self._in_call:
            self._check_open()
            self._await_call()
        block = self._block
        if block is None:
            block = self._block = self._blocks.take()
        # What lies ready already is worth no look around.
        filled = self._end.recv(block.bytes, self._ticket, min_envs, SLICE_S if timeout is None else 0.0)
        if filled is None:
            filled = self._waited_for(block, min_envs, timeout)
        rows, finals, notable = filled
        batch = Batch(block, rows, finals, self._observations)
        if notable:
            self._see_to(batch)
        # Signals are looked after between calls, and there is none from here on: either both happen or
        # nothing does.
        self._block = None
        self._ticket += 1
        return batch

    # -- environments as objects

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every environment, or read an attribute; none may have a command under way.

        Returns:
            Results in the order of the environments.
        """
        return self.call_each(name, [(args, kwargs)] * self.num_envs)

    def call_each(
        self,
        name: str,
        arguments: Sequence[tuple[tuple[Any, ...], dict[str, Any]]],
        env_ids: Sequence[int] | None = None,
    ) -> tuple[Any, ...]:
        """As `call`, of `env_ids`, all by default, with arguments for each: positional ones and keywords."""
        self._check_open()
        self._await_call()
        if under_way := self.num_under_way:
            raise ProtocolError(f"`call`: expected no commands under way, found {under_way}")
        self._news.forget_call()
        asked = range(self.num_envs) if env_ids is None else env_ids
        told = dict(zip(asked, arguments, strict=True))
        ids = self._ids(None if env_ids is None else list(told))
        self._end.check_held(ids)
        blobs = [self._mail.pack(env, (name, *told[env])) for env in ids.tolist()]
        self._in_call = True
        self._end.send(ids, [], CALL, 0, blobs)
        self._await_call()
        results = self._news.results()
        return tuple(results.get(env) for env in asked)

    def _await_call(self) -> None:
        """Wait for the answers to a call, and to one that Ctrl-C interrupted, which nobody reads any more."""
        while self._in_call and self.num_under_way:
            # A call is answered by a notice alone, so a batch is never ready and this looks after notices and
            # deaths.
            self._end.wait(1, SLICE_S)
            self._check_open()
            self._see_to_news(during_call=True)
        self._in_call = False

    def _make_all(self) -> None:
        """Have all environments made, and their spaces compared, before anybody relies on them."""
        try:
            self.call(MAKE)
        except BaseException:
            self.close()
            raise

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
        return self._news.active.copy()

    @property
    def num_under_way(self) -> int:
        """Environments with a command whose answer has not been received."""
        return self._end.under_way(self._ticket)

    def reseed(self, seed: int | None) -> None:
        """Start the rule for seeds over, as if the pool had been made with this seed.

        It counts from the next `send` on.
        """
        self._check_open()
        self._end.reseed(checked_seed(seed))

    def close(self, limit_s: float | None = None) -> None:
        """End the workers and free the memory; batches stay as they are.

        May be called again, and by another thread, whose `recv` then ends with a `PoolClosedError`.

        Args:
            limit_s: most seconds for that, as `close_limit_s` of the constructor, which None means.
        """
        if limit_s is not None:
            seconds("limit_s", limit_s, is_zero_allowed=True)
        self._closed = True
        self._crew.close(limit_s)
        self._blocks.forget()

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
        try:
            state = "closed" if self._closed else f"{self.num_under_way} under way"
        except VhsError:
            state = "of another process"
        return f"RolloutPool({self.num_workers} workers x {self.envs_per_worker} environments, {state})"

    # -- waiting and repairing
    def _waited_for(self, block: Block, min_envs: int | None, timeout: float | None) -> tuple[int, int, int]:
        """Wait until a block is filled: rows, rows with a final observation, rows to look at."""
        wanted = under_way = self.num_under_way
        if min_envs is not None:
            wanted = min_envs
        if not 0 < wanted <= under_way:
            raise ProtocolError(
                f"`recv`: expected 1 to as many environments as have a command, found {under_way} under way"
            )
        limit_s = math.inf if timeout is None else max(timeout, 0.0)
        if math.isnan(limit_s):
            raise ArgumentError(f"`timeout`: expected seconds or None, got {timeout}")
        until = time.monotonic() + limit_s
        slice_s = 0.0
        while (filled := self._end.recv(block.bytes, self._ticket, wanted, slice_s)) is None:
            self._check_open()
            self._see_to_news()
            wanted = self._still_wanted(wanted, is_lockstep=min_envs is None)
            slice_s = min(SLICE_S, until - time.monotonic())
            if slice_s <= 0.0:
                # A death or a notice keeps back what lies ready: look once more now that it is seen to.
                filled = self._end.recv(block.bytes, self._ticket, wanted, 0.0)
                if filled is not None:
                    break
                raise AnswerTimeoutError(
                    f"expected {wanted} environments to answer within {timeout} s, found fewer"
                )
        return filled

    def _still_wanted(self, wanted: int, *, is_lockstep: bool) -> int:
        """How many answers to wait for: an environment that was dropped meanwhile will never answer."""
        under_way = self.num_under_way
        if wanted <= under_way:
            return wanted
        if under_way == 0 or not is_lockstep:
            raise WorkerError(f"expected {wanted} answers, but environments were dropped")
        return under_way

    def _see_to(self, batch: Batch) -> None:
        """Unpickle what came with the answers and report quarantines."""
        for row, env, flags, blob_bytes in batch.notable():
            if flags & BLOB:
                batch.add(row, self._content(env, flags, blob_bytes))
            if flags & OUTSIDE:
                space = self.single_observation_space
                _log.warning("environment %d: expected observations in %s, found one outside", env, space)
            if flags & QUARANTINED:
                report = batch.infos[row]["quarantine"]
                place = (
                    f"{report['where']} at step {report['step']} of the episode with seed {report['seed']}"
                )
                _log.warning("environment %d: NaN in %s; the episode is dropped", env, place)

    def _content(self, env: int, flags: int, blob_bytes: int) -> Any:
        """What was pickled with an answer; what cannot be read must not keep the batch back for good."""
        try:
            return self._mail.read(env, blob_bytes)
        except Exception as error:  # of a class that this process does not know
            _log.error("environment %d: what came with its answer cannot be read: %r", env, error)
            info, lost = {"unreadable": repr(error)}, [None] * len(self._observations.loose)
            return (info, lost, lost if flags & FINAL else None) if lost else info

    def _see_to_news(self, *, during_call: bool = False) -> None:
        """See to deaths and notices, if there are any, and raise what an environment raised."""
        try:
            self._news.see_to(during_call=during_call)
        except Exception:  # a worker was given up, or could not be replaced
            self.close()
            raise
        self._news.raise_error()

    # -- checks

    def _ids(self, env_ids: ArrayLike | None) -> NDArray[np.int64]:
        active = self._news.active
        if env_ids is None:
            return active
        ids = np.asarray(env_ids)
        if len(active) < self.num_envs:
            gone = np.setdiff1d(ids, active)
            if len(gone):
                raise LabelError(
                    f"`env_ids`: expected environments that were not dropped, got {gone.tolist()}"
                )
        return ids

    def _check_ready(self) -> None:
        """Refuse to ask anew as long as the answers before have not been returned."""
        self._check_open()
        self._await_call()
        if self._block is not None and self._end.is_filled(self._ticket):
            raise ProtocolError(
                "expected no batch to be received, found one: `recv` was interrupted, call it again"
            )

    def _check_open(self) -> None:
        if self._closed:
            raise PoolClosedError("expected an open pool, found a closed one")
