"""What a worker process does: take a command, step, answer. Every atomic is Rust's; envs are Python's.

Life of an environment: NEW (not made, or lost to an error) -> RUNNING -> ENDED -> RUNNING ...; a step on a
NEW one begins an episode, so that a learner that does not know of a restart yet finds its environment again.

Invariant: whatever an environment returned is copied or pickled before it is called again: it may use its
arrays and dictionaries anew.
"""

from __future__ import annotations

import enum
import faulthandler
import logging
import mmap
import random
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from vhs._core import RolloutWorker
from vhs.rollout.errors import Failure
from vhs.rollout.inherited import Inherited
from vhs.rollout.leaves import Nest, as_mapping
from vhs.rollout.parcels import UP, Parcels, frozen

STEP, BEGIN, CALL = 0, 1, 2
TERMINATED, TRUNCATED, FIRST, FINAL, CUT, QUARANTINED, FAILED, BLOB, CALLED, OUTSIDE = (
    1 << bit for bit in range(10)
)
"""Codes and bits, as in `rust/vhs-rollout/src/flags.rs`."""

DUMP_SIGNAL = signal.SIGUSR2
"""Upon it a worker writes its Python stack down; sent to one that takes too long, before SIGKILL."""

WAIT_S = 0.5
"""How long a worker sleeps at most before it looks after signals, in seconds."""

MAKE = ""
"""The name in a call that only makes the environment, where there is none yet."""

STARTS = {
    "os.fork",
    "os.forkpty",
    "os.posix_spawn",
    "os.system",
    "subprocess.Popen",
    "_thread.start_new_thread",
}
"""Events of Python's audit upon which something starts that inherits the cores of its parent."""

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
    overflow: Inherited
    """The file for pickled things that need more room than the memory has."""
    sizes: Sizes
    observation_space: gymnasium.Space[Any]
    action_space: gymnasium.Space[Any]
    are_spaces_equal: bool
    """Whether all observation spaces are to be this one, or only of its shape and type."""
    autoreset: Autoreset
    deadline_s: float | None
    start_limit_s: float
    parent: int
    """Process number of the learner."""
    entropy: int
    """From which the global random numbers of each process follow."""


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
    looks: int = 0
    """Observations still to be looked at whether they are in their space."""
    noted: int = 0
    """Bits that the next answer with a first observation has."""


RUNNING = State.RUNNING
"""By itself, since looking it up in its enum takes as long as much of a step."""

Answer = tuple[int, float, int, Any]
"""What goes back to the learner: flags, reward, steps taken, what is pickled."""


def work(setup: Setup, ends_by_signal: bool) -> None:
    """Be a worker until the pool closes; the target of the process."""
    # Ctrl-C, and the end of a service or a batch job, go to every process and are the learner's to handle.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave_it)  # not ignored: what an environment starts would inherit that
    # A learner that was killed takes its workers with it, even from the middle of a step.
    RolloutWorker.end_with(setup.common.parent, ends_by_signal)
    faulthandler.register(DUMP_SIGNAL, file=setup.stack_file.number, all_threads=True)
    loop = _Loop(setup)
    try:
        loop.run()
    finally:
        loop.close()


def _leave_it(_signal: int, _frame: object) -> None:
    """The learner closes its workers, and if it dies they end with it."""


def _reseed_global_numbers(entropy: int, worker: int, epoch: int) -> None:
    """Give a process global random numbers of its own: forked ones would all draw those of the learner."""
    words = np.random.SeedSequence([entropy, worker, epoch]).generate_state(4)
    np.random.seed(words)  # noqa: NPY002 # it is the global one that environments draw from
    random.seed(words.tobytes())
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(int(words[0]))


class _Loop:
    def __init__(self, setup: Setup) -> None:
        self._setup, self._common = setup, setup.common
        self._rolls = setup.common.autoreset is Autoreset.SAME_STEP
        self._observations = Nest(setup.common.observation_space, "observation")
        self._actions = Nest(setup.common.action_space, "action")
        # Looked up once, not with every step.
        self._write, self._read = self._observations.write, self._actions.read
        self._is_any_loose, self._is_any_float = (
            bool(self._observations.loose),
            bool(self._observations.floats),
        )
        self._end = RolloutWorker(
            setup.common.memory.number, setup.common.sizes, setup.worker, setup.common.deadline_s, setup.cpu
        )
        self._commit = self._end.commit
        if setup.cpu is not None:
            sys.addaudithook(self._untie)
        _reseed_global_numbers(setup.common.entropy, setup.worker, self._end.epoch)
        payloads, stride, observation, final, blobs, blob_stride, total = self._end.offsets
        # A mapping of its own, so that arrays over it keep it alive, whatever becomes of the Rust end.
        memory = np.frombuffer(mmap.mmap(setup.common.memory.number, total), np.uint8)
        first, blob_bytes = setup.worker * len(setup.env_fns), setup.common.sizes[4]
        self._parcels = Parcels(setup.common.overflow.number, blob_bytes, UP)
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

    def _untie(self, event: str, _arguments: object) -> None:
        """Let this thread run anywhere before something starts that would inherit its one core."""
        if event in STARTS and threading.current_thread() is threading.main_thread():
            self._end.untie()

    def _answer(self, env: Env, code: int, version: int, next_seed: int | None, blob_bytes: int) -> None:
        blob = b""
        try:
            flags, reward, step, content = self._do(env, code, next_seed, blob_bytes)
            if content:
                blob = self._parcels.pack(env.number, content)
        except Exception as error:  # whatever a user's environment raises travels to the learner
            flags, reward, step = FAILED, 0.0, env.step
            blob = self._failure(env, code, error)
        if blob:
            env.blob[: len(blob)] = np.frombuffer(blob, np.uint8)
            flags |= BLOB
        self._commit(env.local, flags, reward, step, env.seed or 0, len(blob), version)

    def _do(self, env: Env, code: int, next_seed: int | None, blob_bytes: int) -> Answer:
        if code == STEP and env.state is RUNNING:
            return self._step(env, next_seed, blob_bytes)
        if code == CALL:
            return self._call(env, blob_bytes)
        if code == STEP and env.state is State.ENDED and self._common.autoreset is Autoreset.DISABLED:
            raise gymnasium.error.ResetNeeded(
                "step: expected a running episode, found one that has ended: call reset first"
            )
        options = self._told(env, blob_bytes) if code == BEGIN and blob_bytes else None
        info, loose = self._begin(env, next_seed, options)
        return FIRST | env.noted, 0.0, 0, self._content(info, loose)

    def _told(self, env: Env, blob_bytes: int) -> Any:
        """What came pickled with a command."""
        return self._parcels.unpack(env.number, memoryview(env.blob)[:blob_bytes])

    def _content(self, info: Any, loose: Sequence[Any], final: Any = None) -> Any:
        """What is pickled of an answer: the info, and the parts of observations that are no arrays."""
        return (info, loose, final) if self._is_any_loose else info

    def _make(self, env: Env) -> None:
        self._end.allow(self._common.start_limit_s)
        self._end.untie()
        made = env.env_fn()
        try:
            self._check_spaces(made.observation_space, made.action_space)
        except RuntimeError:
            made.close()
            raise
        env.env, env.looks = made, 2

    def _check_spaces(self, observations: gymnasium.Space[Any], actions: gymnasium.Space[Any]) -> None:
        """Refuse an environment whose values would be taken for others; begins as gymnasium's refusals do."""
        common = self._common
        if common.are_spaces_equal and observations != common.observation_space:
            raise RuntimeError(
                "observation_mode='same', but the sub-environments observation spaces are not equivalent. "
                f"Expected {common.observation_space}, found {observations}. "
                "If this is intentional, use `observation_mode='different'` instead."
            )
        if not Nest(observations, "observation").is_like(self._observations):
            raise RuntimeError(
                "the sub-environments observation spaces do not share a common shape and dtype: "
                f"expected those of {common.observation_space}, found {observations}"
            )
        if actions != common.action_space:
            raise RuntimeError(
                f"the action spaces are not equal: expected {common.action_space}, found {actions}"
            )

    def _begin(self, env: Env, seed: int | None, options: Any) -> tuple[dict[str, Any], Sequence[Any]]:
        env.seed, env.step = seed, 0
        if env.env is None:
            self._make(env)
        observation, info = env.env.reset(seed=seed, options=options)
        loose = self._observations.write(env.observation_views, observation)
        env.noted = self._look(env, observation) if env.looks else 0
        where = self._find_nan(env.observation_views)
        if where is not None:
            raise ValueError(f"reset: expected numbers, found NaN in {where}")
        env.state = State.RUNNING
        return dict(as_mapping(info)), loose

    def _look(self, env: Env, observation: Any) -> int:
        """The bit that one of the first observations is outside its space; to look at all takes time."""
        env.looks -= 1
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a number where an array of one is meant
                if env.env.observation_space.contains(observation):
                    return 0
        except Exception:  # a space of one's own, whose values it cannot tell from others
            return 0
        env.looks = 0
        return OUTSIDE

    def _step(self, env: Env, next_seed: int | None, blob_bytes: int) -> Answer:
        action = self._told(env, blob_bytes) if blob_bytes else self._read(env.action_views)
        env.step += 1
        observation, reward, terminated, truncated, info = env.env.step(action)
        reward = float(reward)
        flags = (TERMINATED if terminated else 0) | (TRUNCATED if truncated else 0)
        has_ended = flags != 0
        is_rolled = has_ended and self._rolls
        views = env.final_views if is_rolled else env.observation_views
        loose = self._write(views, observation)
        if env.looks:
            flags |= self._look(env, observation)
        # NaN is the one number that differs from itself.
        where = "the reward" if reward != reward else None
        if where is None and self._is_any_float:
            where = self._find_nan(views)
        if where is not None:
            return self._quarantine(env, where, next_seed)
        if not is_rolled:
            if has_ended:
                env.state = State.ENDED
            return flags, reward, env.step, self._content(info, loose) if self._is_any_loose else info
        step = env.step
        final_info, final_loose = frozen(dict(as_mapping(info))), frozen(loose) if loose else None
        first_info, loose = self._begin(env, next_seed, None)
        infos = {"final_info": final_info, **first_info}
        return flags | env.noted | FINAL | FIRST, reward, step, self._content(infos, loose, final_loose)

    def _quarantine(self, env: Env, where: str, next_seed: int | None) -> Answer:
        """Drop the episode that showed a NaN and begin the next."""
        report = {"where": where, "seed": env.seed, "step": env.step}
        info, loose = self._begin(env, next_seed, None)
        return (
            FIRST | env.noted | CUT | QUARANTINED,
            0.0,
            0,
            self._content({"quarantine": report, **info}, loose),
        )

    def _call(self, env: Env, blob_bytes: int) -> Answer:
        name, arguments, keywords = self._told(env, blob_bytes)
        if env.env is None:
            self._make(env)
        if name == MAKE:
            return CALLED, 0.0, 0, {"result": None}
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
        try:
            return self._parcels.pack(env.number, failure)
        except Exception:  # there is no memory for it
            return self._parcels.pack(env.number, failure.bare())

    def _find_nan(self, views: list[Any]) -> str | None:
        for index in self._observations.floats:
            if np.isnan(views[index]).any():
                return self._observations.name(self._observations.leaves[index])
        return None


def _discard(env: Env) -> None:
    """Close an environment and forget it; one that is broken may raise once more."""
    if env.env is not None:
        try:
            env.env.close()
        except Exception as error:
            _log.warning("environment %d: `close` raised %r", env.number, error)
    env.env, env.state = None, State.NEW
