"""Signals that raise in the middle of a call, as Ctrl-C does: nothing is lost, whenever they come."""

import os
import random
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from gymnasium.error import AlreadyPendingCallError
from rollout_envs import Ledger
from test_faults import Auditor

from vhs import ProtocolError
from vhs.rollout import RolloutPool, RolloutVectorEnv
from vhs.rollout.signals import undisturbed

pytestmark = pytest.mark.slow


class Alarm(BaseException):
    """What the handler raises, out of nowhere."""


@pytest.fixture
def alarms() -> Iterator[None]:
    """A handler of SIGALRM that raises."""

    def ring(*_: object) -> None:
        raise Alarm

    before = signal.signal(signal.SIGALRM, ring)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


def insist(call: Any, chance: random.Random, counts: list[int]) -> Any:
    """Call until it returns, an alarm ringing after a random time."""
    while True:
        try:
            try:
                signal.setitimer(signal.ITIMER_REAL, chance.uniform(1e-6, 6e-4))
                result = call()
                break
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
        except Alarm:
            counts[0] += 1
    return result


@pytest.mark.usefixtures("alarms")
@pytest.mark.parametrize("wanted", [None, 1])
def test_interrupted_calls_lose_tear_and_double_nothing(wanted: int | None) -> None:
    chance, counts, auditor = random.Random(1), [0], Auditor()
    with RolloutPool(Ledger, 2, 2, seed=3) as pool:

        def send(ids: np.ndarray) -> None:
            # What was sent before the alarm is not sent again: the pool says which have a command.
            try:
                pool.send(np.zeros(len(ids), np.int64), ids)
            except ProtocolError as error:
                assert "expected an environment that waits" in str(error)  # noqa: PT017

        pool.reset()
        for _ in range(400):
            # Bound to a name within the call: between both an alarm may ring, which no pool can help.
            held: list[Any] = []
            insist(lambda held=held: held or held.append(pool.recv(wanted, timeout=20)), chance, counts)
            auditor.audit(held[0])
            insist(lambda ids=held[0].env_ids: send(ids), chance, counts)
        auditor.audit(pool.recv(timeout=20))
        assert pool.num_under_way == 0
        assert pool.stats.cut_episodes == 0
        assert len(auditor.ended) == pool.stats.episodes
    assert counts[0] > 20, "alarms did ring"


@pytest.mark.usefixtures("alarms")
def test_workers_that_die_while_alarms_ring_are_all_replaced() -> None:
    chance, counts, auditor = random.Random(2), [0], Auditor()
    with RolloutPool(Ledger, 2, 1, seed=3) as pool:
        pool.reset()
        auditor.audit(pool.recv())
        for kill in range(6):
            pid = pool.pids[kill % 2]
            assert pid is not None
            os.kill(pid, signal.SIGKILL)
            pool.send([0, 0])
            held: list[Any] = []
            insist(lambda held=held: held or held.append(pool.recv(timeout=20)), chance, counts)
            auditor.audit(held[0])
        assert pool.stats.restarts == 6
    assert counts[0] > 6


def test_a_batch_that_was_filled_and_not_returned_is_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    with RolloutPool(Ledger, 1, 2, seed=0) as pool:
        pool.reset(options={"some": "info"})
        with monkeypatch.context() as patch:
            patch.setattr(pool, "_see_to", interrupt)
            with pytest.raises(KeyboardInterrupt):
                pool.recv()
        assert pool.num_under_way == 2
        with pytest.raises(ProtocolError, match="`recv` was interrupted, call it again"):
            pool.send([0, 0])
        batch = pool.recv()
        assert batch.is_first.all()
        assert batch.infos[1] == {"options": {"some": "info"}}
        assert pool.num_under_way == 0
        pool.send([0, 0])
        assert pool.recv().steps.tolist() == [1, 1]


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_an_interrupted_step_of_a_vector_is_pending(monkeypatch: pytest.MonkeyPatch) -> None:
    with RolloutVectorEnv(Ledger, 1, 2) as env:
        env.reset(seed=0)
        with monkeypatch.context() as patch:
            patch.setattr(env.pool, "recv", interrupt)
            with pytest.raises(KeyboardInterrupt):
                env.step([1, 2])
        with pytest.raises(
            AlreadyPendingCallError, match="`step_async` while waiting for a pending call to `step`"
        ):
            env.step([1, 2])
        assert env.step_wait()[1].tolist() == [1.0, 2.0]
        assert env.step([3, 4])[1].tolist() == [3.0, 4.0]


def test_undisturbed_work_is_done_once_and_the_interrupt_comes_after() -> None:
    done: list[str] = []

    def work() -> None:
        signal.raise_signal(signal.SIGUSR1)
        time.sleep(0.05)
        done.append(threading.current_thread().name)

    def ring(*_: object) -> None:
        raise Alarm

    before = signal.signal(signal.SIGUSR1, ring)
    try:
        with pytest.raises(Alarm):
            undisturbed(work)
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert len(done) == 1


def test_undisturbed_work_raises_what_it_raised() -> None:
    def work() -> None:
        raise ValueError("a deed")

    with pytest.raises(ValueError, match="a deed"):
        undisturbed(work)
