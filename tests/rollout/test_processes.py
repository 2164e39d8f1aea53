"""The processes of a pool: whose they are, how they start, what they may start, how they end."""

import contextlib
import logging
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from rollout_envs import Ledger, open_descriptors

from vhs import ArgumentError
from vhs.rollout import PoolClosedError, RolloutPool, WorkerError
from vhs.rollout.processes import cores_for, find_context

pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]


class Numbers(gym.Env):
    """Shows one number, that of `number()`, again with every step."""

    observation_space, action_space = gym.spaces.Box(0, 1e9, (), np.float64), gym.spaces.Discrete(2)

    def number(self) -> float:
        return 0.0

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return np.float64(self.number()), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return np.float64(self.number()), 0.0, False, False, {}


# -- forks of the learner


def test_a_forked_learner_is_refused_and_its_parent_goes_on() -> None:
    calls = (
        "send([0])",
        "recv()",
        "reset()",
        "call('render')",
        "stats",
        "seed_next([0], [1])",
        "num_under_way",
    )
    with RolloutPool(Ledger, 1, seed=1) as pool:
        pool.reset()
        pool.recv()
        ours, theirs = os.pipe()
        pid = os.fork()
        if pid == 0:
            for call in calls:
                try:
                    eval(f"pool.{call}", {"pool": pool})
                    said = "nothing"
                except ArgumentError as error:
                    said = str(error)
                os.write(theirs, f"{call}: {said}\n".encode())
            pool.close()
            os.write(theirs, f"{pool!r}\n".encode())
            os._exit(0)
        os.close(theirs)
        os.waitpid(pid, 0)
        with os.fdopen(ours) as file:
            told = file.read().splitlines()
        expected = f"expected a pool to be used by the process that made it, {os.getpid()}, got process {pid}"
        assert len(told) == len(calls) + 1
        assert all(expected in line for line in told[:-1]), told
        pool.send([0])
        assert pool.recv(timeout=10).steps.tolist() == [1]


def test_a_fork_while_another_thread_waits_is_refused_at_once() -> None:
    """The other thread holds the pool's lock when the process is forked."""
    with RolloutPool(Sleeping, 1) as pool:
        pool.reset()
        pool.recv()
        pool.send([0])
        thread = threading.Thread(target=pool.recv)
        thread.start()
        time.sleep(0.1)
        for _ in range(10):
            pid = os.fork()
            if pid == 0:
                signal.alarm(5)
                try:
                    pool.recv()
                except ArgumentError:
                    os._exit(0)
                os._exit(1)
            assert os.waitpid(pid, 0)[1] == 0
        thread.join()


class Sleeping(Numbers):
    """Takes long for a step."""

    def step(self, action: Any) -> Any:
        time.sleep(1.0)
        return super().step(action)


# -- the global random numbers


class Global(Numbers):
    def number(self) -> float:
        return float(np.random.rand())  # noqa: NPY002


def shown(pool: RolloutPool) -> list[float]:
    pool.reset()
    return [float(number) for number in pool.recv(timeout=20).observation]


def test_workers_draw_global_numbers_of_their_own() -> None:
    state = np.random.get_state()[1].tobytes()  # noqa: NPY002
    runs = []
    for seed in (0, 0, 1, None, None):
        with RolloutPool(Global, 3, seed=seed) as pool:
            runs.append(shown(pool))
    assert len({*runs[0], *runs[2], *runs[3], *runs[4]}) == 12
    assert runs[0] == runs[1], "a seed decides them too"
    assert np.random.get_state()[1].tobytes() == state, "the learner's stay as they are"  # noqa: NPY002


def test_a_worker_started_anew_does_not_repeat_its_past() -> None:
    with RolloutPool(Global, 1, seed=0) as pool:
        before = shown(pool)
        os.kill(pool.pids[0], signal.SIGKILL)
        pool.send([0])
        assert pool.recv(timeout=20).observation.tolist() != before


# -- what environments and learners may start


class Parent(Numbers):
    """Starts a process and counts the cores that it may use."""

    def number(self) -> float:
        process = multiprocessing.get_context("fork").Process(target=int)
        process.start()
        process.join()
        count = "import os; print(len(os.sched_getaffinity(0)))"
        return float(subprocess.check_output([sys.executable, "-c", count]))

    def step(self, action: Any) -> Any:
        number = self.number() if action else len(os.sched_getaffinity(0))
        return np.float64(number), 0.0, False, False, {}


def test_what_an_environment_starts_runs_on_all_cores_also_when_its_worker_is_tied() -> None:
    cores = len(os.sched_getaffinity(0))
    with RolloutPool(Parent, 1, pin=True) as pool:
        assert shown(pool) == [cores]
        until = time.monotonic() + 30.0
        own = cores
        while own > 1 and time.monotonic() < until:
            time.sleep(0.001)  # so that the worker has to wait
            pool.send([0])
            own = int(pool.recv().observation[0])
        assert own == 1, "by and by it is tied"
        pool.send([1])
        assert pool.recv().observation.tolist() == [cores]


def test_a_pool_can_be_made_by_a_worker_of_multiprocessing() -> None:
    with multiprocessing.get_context("fork").Pool(1) as outer:
        assert outer.map(steps_in_a_pool, [3]) == [[3, 3]]


def steps_in_a_pool(steps: int) -> list[int]:
    assert multiprocessing.current_process().daemon
    with RolloutPool(Numbers, 2) as pool:
        pool.reset()
        for _ in range(steps):
            pool.recv()
            pool.send([0, 0])
        taken: list[int] = pool.recv().steps.tolist()
    assert multiprocessing.current_process().daemon
    return taken


EXAMPLE = """
import multiprocessing
{before}
import gymnasium
from vhs import RolloutPool
with RolloutPool(lambda: gymnasium.make("CartPole-v1"), num_workers=2, seed=0{more}) as pool:
    pool.reset()
    print(pool.recv().observation.shape, multiprocessing.get_start_method(allow_none=True))
"""


@pytest.mark.parametrize(
    ("before", "more", "expected"),
    [
        ("", "", "(2, 4) None"),
        ("multiprocessing.set_start_method('forkserver')", "", "(2, 4) forkserver"),
        ("multiprocessing.set_start_method('spawn')", "", "needs its `if __name__ == '__main__':`"),
        ("", ", start_method='spawn'", "needs its `if __name__ == '__main__':`"),
    ],
)
def test_a_script_without_a_main_runs_or_is_told_why_not(
    before: str, more: str, expected: str, tmp_path: Path
) -> None:
    script = tmp_path / "script.py"
    script.write_text(EXAMPLE.format(before=before, more=more))
    result = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert expected in result.stdout + result.stderr


def test_looking_for_the_start_method_does_not_fix_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_context(None).get_start_method() == "fork"
    monkeypatch.setattr(multiprocessing, "get_start_method", lambda allow_none: "spawn")
    assert find_context(None).get_start_method() == "spawn"
    assert find_context("fork").get_start_method() == "fork"


def test_cores_are_given_where_they_fit_or_pin_insists(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {4, 7})
    assert cores_for(2, None) == [4, 7]
    assert cores_for(3, None) == [None] * 3
    assert cores_for(3, True) == [4, 7, 4]
    assert cores_for(1, False) == [None]


# -- what the system lacks


def test_too_few_descriptors_are_said_and_none_is_left_open() -> None:
    before = open_descriptors()
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (before + 20, limits[1]))
    try:
        with pytest.raises(OSError, match=r"4 workers: expected 28 free descriptors, found \d+") as caught:
            RolloutPool(Ledger, 4)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert caught.value.errno == 24
    assert open_descriptors() == before


def test_a_pool_needs_no_more_descriptors_than_it_asks_for() -> None:
    before = open_descriptors()
    with RolloutPool(Ledger, 4) as pool:
        pool.reset()
        pool.recv()
        assert open_descriptors() - before <= 28 - 4


def test_an_ignored_sigchld_is_said() -> None:
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        with pytest.raises(WorkerError, match="SIGCHLD: expected it to be heard, found it ignored"):
            RolloutPool(Ledger, 1)
    finally:
        signal.signal(signal.SIGCHLD, before)


WITHOUT_PIDFD = """
import ctypes, struct
def forbid(number, error):
    refuse = 0x00050000 | error
    rules = [(0x20, 0, 0, 0), (0x15, 0, 1, number), (0x06, 0, 0, refuse), (0x06, 0, 0, 0x7FFF0000)]
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *rule) for rule in rules))
    class Program(ctypes.Structure):
        _fields_ = [("len", ctypes.c_ushort), ("filter", ctypes.c_void_p)]
    libc = ctypes.CDLL(None)
    libc.prctl(38, 1, 0, 0, 0)
    assert libc.prctl(22, 2, ctypes.byref(Program(len(rules), ctypes.cast(code, ctypes.c_void_p)))) == 0
from rollout_envs import Ledger
from vhs.rollout import RolloutPool
forbid(434, 38)
try:
    RolloutPool(Ledger, 1)
except OSError as error:
    print(error.errno, error)
"""


def test_a_system_without_pidfds_is_said_with_what_is_needed() -> None:
    result = subprocess.run(
        [sys.executable, "-c", WITHOUT_PIDFD],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
    )
    assert result.stdout.startswith("38 [Errno 38] pidfd of process"), result.stderr
    assert "Linux 5.3 or newer, where no sandbox forbids pidfd_open" in result.stdout


# -- workers that stand still, and ends


def test_a_stopped_worker_is_replaced_although_it_never_took_its_command() -> None:
    with RolloutPool(Ledger, 2, 1, seed=1, deadline_s=0.5) as pool:
        pool.reset()
        pool.recv()
        time.sleep(1.0)  # who has nothing to do is not late
        assert pool.stats.restarts == 0
        os.kill(pool.pids[0], signal.SIGSTOP)
        pool.send([0, 0])
        batch = pool.recv(timeout=20)
        assert batch.is_cut.tolist() == [True, False]
        assert pool.stats.restarts == 1


def test_a_worker_with_many_environments_is_not_late_for_their_sum() -> None:
    with RolloutPool(partial(Slow, 0.1), 1, 6, deadline_s=0.3, seed=1) as pool:
        pool.reset()
        pool.recv()
        pool.send([0] * 6)
        pool.recv()
        assert pool.stats.restarts == 0


class Slow(Numbers):
    def __init__(self, pause_s: float) -> None:
        self.pause_s = pause_s

    def number(self) -> float:
        time.sleep(self.pause_s)
        return 0.0


def test_close_ends_a_recv_of_another_thread() -> None:
    pool = RolloutPool(Hanging, 2, close_limit_s=0.5)
    pool.reset()
    pool.recv()
    pool.send([0, 0])
    raised: list[BaseException] = []

    def wait() -> None:
        try:
            pool.recv()
        except PoolClosedError as error:
            raised.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    time.sleep(0.2)
    before = time.monotonic()
    pool.close()
    thread.join(5.0)
    assert time.monotonic() - before < 5.0
    assert len(raised) == 1


class Hanging(Numbers):
    def step(self, action: Any) -> Any:
        time.sleep(60)


class Writing(Numbers):
    """Needs time to close."""

    def __init__(self, file: Path, pause_s: float) -> None:
        self.file, self.pause_s = file, pause_s
        self.is_used = False

    def number(self) -> float:
        self.is_used = True
        return 0.0

    def close(self) -> None:
        if self.is_used:
            time.sleep(self.pause_s)
            self.file.write_text("all written")


@pytest.mark.parametrize("is_in_time", [True, False])
def test_environments_have_time_to_close_and_who_is_killed_is_named(
    is_in_time: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file, limit_s = tmp_path / "file", 10.0 if is_in_time else 0.2
    with (
        caplog.at_level(logging.WARNING),
        RolloutPool(partial(Writing, file, 1.0), 1, close_limit_s=limit_s) as pool,
    ):
        shown(pool)
    assert file.exists() == is_in_time
    told = (
        "worker 0 was killed: its environments were not closed 0.2 s after it was told to (`close_limit_s`)"
    )
    assert (told in caplog.text) == (not is_in_time)


def test_a_worker_replaced_within_a_passing_thread_lives_on() -> None:
    with RolloutPool(Ledger, 2, 1, seed=1) as pool:
        pool.reset()
        pool.recv()
        for _ in range(3):
            os.kill(pool.pids[0], signal.SIGKILL)
            pool.send([1, 1])
            thread = threading.Thread(target=pool.recv)
            thread.start()
            thread.join()
            time.sleep(0.1)
            pool.send([1, 1])
            assert len(pool.recv(timeout=20)) == 2
        assert pool.stats.restarts == 3


class Large(Numbers):
    observation_space = gym.spaces.Box(0, 255, (16 << 20,), np.uint8)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        return np.ones(16 << 20, np.uint8), {}


def test_close_gives_the_memory_back_and_batches_stay() -> None:
    pool = RolloutPool(Large, 1, 2)
    pool.reset()
    batch = pool.recv()
    assert shared_bytes() > 32 << 20
    pool.close()
    assert shared_bytes() < 1 << 20
    assert (batch.observation == 1).all()
    assert "closed" in repr(pool)


def shared_bytes() -> int:
    """Memory of this process's nameless files."""
    total = 0
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # the one of the listing itself
            total += link.stat().st_blocks * 512 if "memfd:vhs-rollout" in os.readlink(link) else 0
    return total
