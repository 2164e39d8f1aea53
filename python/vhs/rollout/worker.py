"""What a worker process does: take a command, step, answer. Every atomic is Rust's; envs are Python's.

Life of an environment: NEW (not made, or lost to an error) -> RUNNING -> ENDED -> RUNNING ...; a step on a
NEW one begins an episode, so that a learner that does not know of a restart yet finds its environment again.
"""

from __future__ import annotations

import contextlib
import enum
import faulthandler
import logging
import mmap
import pickle
import signal
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from vhs._core import RolloutWorker
from vhs.rollout.errors import Failure
from vhs.rollout.inherited import Inherited
from vhs.rollout.leaves import Nest, as_mapping

STEP, BEGIN, CALL = 0, 1, 2
TERMINATED, TRUNCATED, FIRST, FINAL, CUT, QUARANTINED, FAILED, BLOB, CALLED = (1 << bit for bit in range(9))
"""Codes and bits, as in `rust/vhs-rollout/src/flags.rs`."""

DUMP_SIGNAL = signal.SIGUSR2
"""Upon it a worker writes its Python stack down; sent to one that takes too long, before SIGKILL."""

WAIT_S = 0.5
"""How long a worker sleeps at most before it looks after signals, in seconds."""

Sizes = tuple[int, int, int, int, int]

_log = logging.getLogger(__name__)


class Autoreset(enum.Enum):
    """What follows the end of an episode; values and meaning are gymnasium's."""

    NEXT_STEP = "NextStep"
    SAME_STEP = "SameStep"
    DISABLED = "Disabled"


@dataclass(frozen=True)
class Common:
    """What all workers of a pool have to know at their start."""

    memory: Inherited
    sizes: Sizes
    observation_space: gymnasium.Space[Any]
    action_space: gymnasium.Space[Any]
    autoreset: Autoreset
    deadline_s: float | None
    start_limit_s: float
    parent: int
    """Process number of the learner."""
    ends_by_signal: bool


@dataclass(frozen=True)
class Setup:
    """What one worker has to know at its start; it travels to the process."""

    common: Common
    worker: int
    env_fns: list[Callable[[], gymnasium.Env[Any, Any]]]
    stack_file: Inherited
    cpu: int | None


class State(enum.Enum):
    """Where an environment is in its life."""

    NEW = enum.auto()
    RUNNING = enum.auto()
    ENDED = enum.auto()


@dataclass(slots=True)
class Env:
    """One environment and its running episode."""

    local: int
    number: int
    env_fn: Callable[[], gymnasium.Env[Any, Any]]
    action_views: list[Any]
    observation_views: list[Any]
    final_views: list[Any]
    blob: Any
    env: Any = None
    state: State = State.NEW
    seed: int | None = None
    step: int = 0


RUNNING = State.RUNNING
"""By itself, since looking it up in its enum takes as long as much of a step."""

Info = dict[str, Any] | None
Answer = tuple[int, float, int, Info]
"""What goes back to the learner: flags, reward, steps taken, info."""


def work(setup: Setup) -> None:
    """Be a worker until the pool closes; the target of the process."""
    # Ctrl-C, and the end of a service or a batch job, go to every process and are the learner's to handle.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave_it)  # not ignored: what an environment starts would inherit that
    # A learner that was killed takes its workers with it, even from the middle of a step.
    RolloutWorker.end_with(setup.common.parent, setup.common.ends_by_signal)
    faulthandler.register(DUMP_SIGNAL, file=setup.stack_file.number, all_threads=True)
    loop = _Loop(setup)
    try:
        loop.run()
    finally:
        loop.close()


def _leave_it(_signal: int, _frame: object) -> None:
    """The learner closes its workers, and if it dies they end with it."""


class _Loop:
    def __init__(self, setup: Setup) -> None:
        self._setup, self._common = setup, setup.common
        self._rolls = setup.common.autoreset is Autoreset.SAME_STEP
        self._observations = Nest(setup.common.observation_space, "observation")
        self._actions = Nest(setup.common.action_space, "action")
        self._end = RolloutWorker(
            setup.common.memory.number, setup.common.sizes, setup.worker, setup.common.deadline_s, setup.cpu
        )
        payloads, stride, observation, final, blobs, blob_stride, total = self._end.offsets
        # A mapping of its own, so that arrays over it keep it alive, whatever becomes of the Rust end.
        memory = np.frombuffer(mmap.mmap(setup.common.memory.number, total), np.uint8)
        first, blob_bytes = setup.worker * len(setup.env_fns), setup.common.sizes[4]
        self._envs = []
        for local, env_fn in enumerate(setup.env_fns):
            number = first + local
            start, blob_start = payloads + number * stride, blobs + number * blob_stride
            self._envs.append(
                Env(
                    local,
                    number,
                    env_fn,
                    self._actions.views(memory, start),
                    self._observations.views(memory, start + observation),
                    self._observations.views(memory, start + final),
                    memory[blob_start : blob_start + blob_bytes],
                )
            )

    def run(self) -> None:
        """Answer commands until the pool closes."""
        take = self._end.next
        while True:
            local, code, version, next_seed, blob_bytes = take(WAIT_S)
            if local == -1:
                continue
            if local == -2:
                return
            self._answer(self._envs[local], code, version, next_seed, blob_bytes)

    def close(self) -> None:
        """Close every environment, whatever each of them does about it."""
        for env in self._envs:
            _discard(env)

    def _answer(self, env: Env, code: int, version: int, next_seed: int | None, blob_bytes: int) -> None:
        blob = b""
        try:
            flags, reward, step, info = self._do(env, code, next_seed, blob_bytes)
            if info:
                blob = self._packed(info)
        except Exception as error:  # whatever a user's environment raises travels to the learner
            flags, reward, step = FAILED, 0.0, env.step
            blob = self._failure(env, code, error)
        if blob:
            env.blob[: len(blob)] = np.frombuffer(blob, np.uint8)
            flags |= BLOB
        self._end.commit(env.local, flags, reward, step, env.seed or 0, len(blob), version)

    def _do(self, env: Env, code: int, next_seed: int | None, blob_bytes: int) -> Answer:
        if code == STEP and env.state is RUNNING:
            return self._step(env, next_seed)
        if code == CALL:
            return self._call(env, blob_bytes)
        if code == STEP and env.state is State.ENDED and self._common.autoreset is Autoreset.DISABLED:
            raise gymnasium.error.ResetNeeded(
                "step: expected a running episode, found one that has ended: call reset first"
            )
        options = pickle.loads(env.blob[:blob_bytes]) if blob_bytes else None
        info = self._begin(env, next_seed, options)
        return FIRST, 0.0, 0, info

    def _begin(self, env: Env, seed: int | None, options: dict[str, Any] | None) -> dict[str, Any]:
        if env.env is None:
            self._end.allow(self._common.start_limit_s)
            env.seed, env.step = seed, 0
            env.env = env.env_fn()
        env.seed, env.step = seed, 0
        observation, info = env.env.reset(seed=seed, options=options)
        self._observations.write(env.observation_views, observation)
        where = self._find_nan(env.observation_views)
        if where is not None:
            raise ValueError(f"reset: expected numbers, found NaN in {where}")
        env.state = State.RUNNING
        return dict(as_mapping(info))

    def _step(self, env: Env, next_seed: int | None) -> Answer:
        action = self._actions.read(env.action_views)
        env.step += 1
        observation, reward, terminated, truncated, info = env.env.step(action)
        reward = float(reward)
        flags = (TERMINATED if terminated else 0) | (TRUNCATED if truncated else 0)
        is_rolled = flags and self._rolls
        views = env.final_views if is_rolled else env.observation_views
        self._observations.write(views, observation)
        # NaN is the one number that differs from itself.
        where = "the reward" if reward != reward else None
        if where is None and self._observations.floats:
            where = self._find_nan(views)
        if where is not None:
            return self._quarantine(env, where, next_seed)
        if not is_rolled:
            if flags:
                env.state = State.ENDED
            return flags, reward, env.step, info
        step = env.step
        first_info = self._begin(env, next_seed, None)
        infos = {"final_info": dict(as_mapping(info)), **first_info}
        return flags | FINAL | FIRST, reward, step, infos

    def _quarantine(self, env: Env, where: str, next_seed: int | None) -> Answer:
        """Drop the episode that showed a NaN and begin the next."""
        report = {"where": where, "seed": env.seed, "step": env.step}
        info = self._begin(env, next_seed, None)
        return FIRST | CUT | QUARANTINED, 0.0, 0, {"quarantine": report, **info}

    def _call(self, env: Env, blob_bytes: int) -> Answer:
        name, arguments, keywords = pickle.loads(env.blob[:blob_bytes])
        if env.env is None:
            self._end.allow(self._common.start_limit_s)
            env.env = env.env_fn()
        # Every wrapper has the setter itself; looking it up by name would find the innermost.
        is_setter = name == "set_wrapper_attr"
        found = env.env.set_wrapper_attr if is_setter else env.env.get_wrapper_attr(name)
        result = found(*arguments, **keywords) if callable(found) else found
        return CALLED, 0.0, 0, {"result": result}

    def _failure(self, env: Env, code: int, error: Exception) -> bytes:
        call = {STEP: "step", BEGIN: "reset", CALL: "call"}[code]
        failure = Failure.of(
            error, worker=self._setup.worker, env=env.number, seed=env.seed, step=env.step, call=call
        )
        if code != CALL:
            # Who raised once may be broken: the next episode gets a new one.
            _discard(env)
        return failure.packed(len(env.blob))

    def _find_nan(self, views: list[Any]) -> str | None:
        for index in self._observations.floats:
            if np.isnan(views[index]).any():
                return f"observation{self._observations.leaves[index].name}"
        return None

    def _packed(self, info: dict[str, Any]) -> bytes:
        packed = pickle.dumps(info, protocol=pickle.HIGHEST_PROTOCOL)
        limit = self._common.sizes[4]
        if len(packed) > limit:
            raise ValueError(f"info_bytes: expected room for an info of {len(packed)} bytes, found {limit}")
        return packed


def _discard(env: Env) -> None:
    """Close an environment and forget it; one that is broken may raise once more."""
    if env.env is not None:
        with contextlib.suppress(Exception):
            env.env.close()
    env.env, env.state = None, State.NEW
