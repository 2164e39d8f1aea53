"""Faults with real processes: nothing is lost, torn or doubled, and everything is told."""

import logging
import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rollout_envs import Floats, Ledger, Misbehaved, Mortal, length_of, mark_of

from vhs.rollout import Batch, RemoteTraceback, RolloutPool, WorkerError

KILLS = int(os.environ.get("VHS_KILLS", "50"))
"""The suite's long mode: VHS_KILLS=1000."""
pytestmark = [pytest.mark.slow, pytest.mark.timeout(60 + KILLS)]


class Auditor:
    """Follows every environment's episodes and finds each that is lost, torn or doubled."""

    def __init__(self) -> None:
        self.running: dict[int, tuple[int, int]] = {}
        self.ended: list[int] = []
        self.cut = 0

    def audit(self, batch: Batch) -> None:
        assert len(set(batch.env_ids.tolist())) == len(batch)
        observation, final = batch.observation, batch.final_observation
        finals = {row: place for place, row in enumerate(batch.final_rows.tolist())}
        for row, env in enumerate(batch.env_ids.tolist()):
            has_ended = bool(batch.terminated[row] or batch.truncated[row])
            if has_ended:
                self.end(env, {name: leaf[finals[row]] for name, leaf in final.items()})
                assert batch.infos[row]["final_info"]["last"] == self.ended[-1]
            now = {name: leaf[row] for name, leaf in observation.items()}
            if batch.is_first[row]:
                if batch.is_cut[row]:
                    self.cut += 1
                    assert self.running.pop(env, None), "only a running episode can be cut"
                assert env not in self.running, "an episode vanished without a word"
                self.check(now, int(batch.seeds[row]), 0)
                self.running[env] = (int(batch.seeds[row]), 0)
            else:
                self.step(env, now)

    def step(self, env: int, now: dict[str, np.ndarray]) -> None:
        seed, step = self.running[env]
        self.check(now, seed, step + 1)
        self.running[env] = (seed, step + 1)

    def end(self, env: int, last: dict[str, np.ndarray]) -> None:
        self.step(env, last)
        seed, step = self.running.pop(env)
        assert step == length_of(seed)
        self.ended.append(seed)

    def check(self, now: dict[str, np.ndarray], seed: int, step: int) -> None:
        assert int(now["seed"]) == seed
        assert int(now["step"]) == step, "a step is lost or doubled"
        assert (now["bytes"] == mark_of(seed, step)).all(), "an observation is torn"


def act(pool: RolloutPool, batch: Batch) -> None:
    pool.send(np.zeros(len(batch), np.int64), batch.env_ids)


def test_killed_workers_return_and_no_episode_is_lost_torn_or_doubled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The kills here come so fast that some hit a worker before its first answer, again and again.
    monkeypatch.setattr("vhs.rollout.crew.MOST_BARREN_DEATHS", KILLS)
    chance = random.Random(0)
    auditor = Auditor()
    with RolloutPool(Ledger, 3, 2, seed=1) as pool:
        stop = threading.Event()
        killed: set[int] = set()

        def kill() -> None:
            while len(killed) < KILLS and not stop.is_set():
                time.sleep(chance.uniform(0.0, 0.04))
                pid = pool.pids[chance.randrange(3)]
                if pid is None or pid in killed:
                    continue  # it has not been replaced yet
                os.kill(pid, signal.SIGKILL)
                killed.add(pid)

        thread = threading.Thread(target=kill)
        pool.reset()
        auditor.audit(first := pool.recv())
        act(pool, first)
        thread.start()
        try:
            after = 0
            while thread.is_alive() or after < 200:
                batch = pool.recv(1, timeout=20)
                auditor.audit(batch)
                act(pool, batch)
                after += not thread.is_alive()
        finally:
            stop.set()
            thread.join()
        auditor.audit(pool.recv())
        stats = pool.stats
    assert len(killed) == KILLS
    assert stats.restarts == KILLS
    assert stats.episodes == len(auditor.ended)
    assert stats.cut_episodes == auditor.cut
    assert len(set(auditor.ended)) == len(auditor.ended), "every episode has a seed of its own"
    assert len(auditor.running) == 6


def test_a_death_is_noticed_within_10_ms_while_the_others_go_on() -> None:
    delays = []
    # Spawned workers are small: the kernel takes 10 ms and more to end a fork of a process that holds torch.
    with RolloutPool(Ledger, 2, 1, seed=1, start_method="spawn") as pool:
        pool.reset()
        pool.recv()
        for _ in range(15):
            before = time.perf_counter()
            os.kill(pool.pids[0], signal.SIGKILL)
            pool.send([0], [0])
            pool._end.wait(1, 5.0)  # returns when the alarm rings
            deaths = pool._end.take_deaths()
            delays.append(time.perf_counter() - before)
            assert deaths == [(0, False)]
            pool._crew.replace(0, was_overdue=False, again=True)
            # The other one is served while the new process starts.
            pool.send([0], [1])
            ids = pool.recv(1, timeout=10).env_ids.tolist()
            if len(ids) < 2:
                ids += pool.recv(1, timeout=10).env_ids.tolist()
            assert sorted(ids) == [0, 1]
    # The dying itself is part of it, and on a busy machine that takes as long as it takes.
    assert min(delays) < 0.010, delays


def test_a_pool_goes_on_after_workers_have_died_of_a_call() -> None:
    with RolloutPool(Mortal, 3, 2, seed=1) as pool:
        pool.reset()
        pool.recv()
        dies = [True, False, False, False, True, False]
        with pytest.raises(
            WorkerError, match=r"worker 0 died .* during a call; worker 2 died|worker 2 .*0 died"
        ):
            pool.call_each("answer", [((), {"dies": dead}) for dead in dies])
        assert pool.num_under_way == 0
        assert pool.call("answer", dies=False) == ("alive",) * 6
        pool.reset()
        assert len(pool.recv(timeout=20)) == 6


def test_a_pool_goes_on_after_a_call_was_interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    with RolloutPool(Mortal, 2, 2, seed=1) as pool:
        pool.reset()
        pool.recv()
        with monkeypatch.context() as patch:
            patch.setattr(pool._news, "_attend", interrupt)
            with pytest.raises(KeyboardInterrupt):
                pool.call("answer", dies=False)
        assert pool.num_under_way == 4
        pool.send(np.zeros(4, np.int64))
        assert pool.recv(timeout=20).steps.tolist() == [1] * 4
        assert pool.call("double", 2) == (4,) * 4


def interrupt(**_: object) -> None:
    raise KeyboardInterrupt


def test_a_hanging_environment_is_killed_and_its_stack_is_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    auditor = Auditor()
    with RolloutPool(partial(Misbehaved, "hang", tmp_path), 1, 1, seed=1, deadline_s=0.3) as pool:
        pool.reset()
        with caplog.at_level(logging.WARNING):
            while auditor.cut < 2:
                batch = pool.recv(1, timeout=20)
                auditor.audit(batch)
                act(pool, batch)
        assert pool.stats.restarts == 2
    assert "it took longer than allowed" in caplog.text
    assert "hang_for_good" in caplog.text


def test_an_error_arrives_as_it_was_with_its_traceback_and_its_place(tmp_path: Path) -> None:
    with RolloutPool(partial(Misbehaved, "raise", tmp_path, 1), 1, 2, seed=1) as pool:
        pool.reset()
        pool.send([0, 0], pool.recv().env_ids)
        pool.send([0, 0], pool.recv().env_ids)
        with pytest.raises(ZeroDivisionError, match="a deed") as caught:
            pool.recv()
        assert "worker 0" in caught.value.__notes__[0]
        assert re.search(r"environment [01], .*seed \d+, step 2", caught.value.__notes__[0])
        assert isinstance(caught.value.__cause__, RemoteTraceback)
        assert "rollout_envs.py" in str(caught.value.__cause__)
        # The pool is still of use.
        while pool.num_under_way:
            with pytest.raises(ZeroDivisionError):
                pool.recv()
        pool.reset()
        assert pool.recv().is_first.all()


def test_an_error_that_cannot_be_pickled_is_named(tmp_path: Path) -> None:
    with RolloutPool(partial(Misbehaved, "odd", tmp_path, 1), 1, 1, seed=1) as pool:
        pool.reset()
        pool.send([0], pool.recv().env_ids)
        pool.send([0], pool.recv().env_ids)
        with pytest.raises(WorkerError, match="OddError in `step` of environment 0, worker 0") as caught:
            pool.recv()
        assert "a deed" not in str(caught.value.__cause__)
        assert 'raise OddError("a", "b")' in str(caught.value.__cause__)


def test_the_others_answers_survive_an_error(tmp_path: Path) -> None:
    fns = [partial(Misbehaved, "raise", tmp_path, 1), Ledger]
    with RolloutPool(fns, 2, 1, seed=4) as pool:
        pool.reset()
        batch = pool.recv()
        for _ in range(2):
            pool.send([0, 5], batch.env_ids)
            with pytest.raises(ZeroDivisionError) if _ else _nothing():
                batch = pool.recv()
        batch = pool.recv()
        assert batch.env_ids.tolist() == [1]
        assert batch.rewards.tolist() == [5.0]


class _nothing:
    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...


@pytest.mark.parametrize("deed", ["raise", "die", "nan"])
def test_a_restarted_environment_tells_that_its_episode_is_cut(deed: str, tmp_path: Path) -> None:
    auditor = Auditor()
    with RolloutPool(partial(Misbehaved, deed, tmp_path), 2, 1, seed=1, on_error="restart") as pool:
        pool.reset()
        while auditor.cut < 5:
            batch = pool.recv(1, timeout=20)
            auditor.audit(batch)
            act(pool, batch)
        auditor.audit(pool.recv())
        stats = pool.stats
    assert stats.cut_episodes == auditor.cut
    assert stats.episodes == len(auditor.ended)
    assert stats.quarantined_episodes == (auditor.cut if deed == "nan" else 0)
    assert (stats.restarts > 0) == (deed == "die")


def test_a_dropped_environment_is_gone_and_the_rest_go_on(tmp_path: Path) -> None:
    fns = [partial(Misbehaved, "raise", tmp_path, 1), Ledger, Ledger]
    with RolloutPool(fns, 1, 3, seed=1, on_error="drop") as pool:
        pool.reset()
        for _ in range(10):
            batch = pool.recv()
            act(pool, batch)
        assert pool.active_env_ids.tolist() == [1, 2]
        assert batch.env_ids.tolist() == [1, 2]
        with pytest.raises(IndexError, match="not dropped"):
            pool.send([0], [0])


def test_nan_in_a_float_field_ends_the_episode_and_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    with RolloutPool(Floats, 1, 2) as pool, caplog.at_level(logging.WARNING):
        pool.reset(seeds=[7, 8])
        batch = pool.recv()
        assert np.isinf(batch.observation).all(), "infinity is a number"
        for _ in range(3):
            pool.send(np.zeros((2, 2), np.float32), batch.env_ids)
            batch = pool.recv()
        assert batch.is_quarantined.tolist() == [True, False]
        assert batch.is_cut.tolist() == [True, False]
        assert batch.infos[0]["quarantine"] == {"where": "observation", "seed": 7, "step": 3}
        assert not np.isnan(batch.observation).any()
        assert pool.stats.quarantined_episodes == 1
    assert "NaN in observation at step 3 of the episode with seed 7" in caplog.text


def test_a_worker_that_dies_at_once_is_given_up(tmp_path: Path) -> None:
    fns = [partial(_die_in_a_worker, os.getpid(), tmp_path)]
    with RolloutPool(fns, 1, 1) as pool:
        pool.reset()
        with pytest.raises(WorkerError, match=r"died 3 times without an answer \(exit code -9\)"):
            pool.recv(timeout=20)
        assert pool.closed


def _die_in_a_worker(learner: int, folder: Path) -> Ledger:
    """The first call comes from the process that asks for the spaces."""
    if (folder / "asked").exists():
        os.kill(os.getpid(), signal.SIGKILL)
    (folder / "asked").touch()
    return Ledger()


def test_an_env_fn_that_hangs_in_its_worker_is_given_up(tmp_path: Path) -> None:
    fns = [partial(_hang_in_a_worker, tmp_path)]
    with RolloutPool(fns, 1, 1, start_limit_s=2.0) as pool:
        pool.reset()
        with pytest.raises(WorkerError, match=r"died 3 times without an answer \(it took longer"):
            pool.recv(timeout=20)


def _hang_in_a_worker(folder: Path) -> Ledger:
    """The first call comes from the process that asks for the spaces."""
    if (folder / "asked").exists():
        time.sleep(60)
    (folder / "asked").touch()
    return Ledger()


def test_an_env_fn_that_raises_is_told_by_the_constructor() -> None:
    def raises() -> Ledger:
        raise KeyError("no such world")

    with pytest.raises(KeyError, match="no such world") as caught:
        RolloutPool(raises, 2)
    assert "in `env_fn`" in caught.value.__notes__[0]


LEARNER = """
import sys, time
sys.path.insert(0, {tests!r})
from rollout_envs import Ledger, Misbehaved
from functools import partial
from pathlib import Path
from vhs.rollout import RolloutPool
if __name__ == "__main__":
    env_fns = [partial(Misbehaved, "hang", Path({folder!r}), 1), Ledger, Ledger]
    pool = RolloutPool(env_fns, 3, start_method={method!r}, seed=0)
    pool.reset()
    for _ in range(2):
        pool.send([0, 0, 0], pool.recv().env_ids)
    print(*pool.pids, flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.parametrize("in_thread", [False, True])
def test_no_worker_outlives_a_killed_learner(method: str, in_thread: bool, tmp_path: Path) -> None:
    text = LEARNER.format(tests=str(Path(__file__).parent), folder=str(tmp_path), method=method)
    if in_thread:
        # The thread that starts the workers ends; its process does not, so neither may they until it is
        # killed.
        text = text.replace("    time.sleep(60)\n", "")
        head, body = text.split('if __name__ == "__main__":\n')
        text = f"{head}import threading\ndef main():\n    global pool\n{body}"
        text += 'if __name__ == "__main__":\n    t = threading.Thread(target=main); t.start(); t.join()\n'
        text += "    time.sleep(0.5); pool.recv(2); print('alive', flush=True); time.sleep(60)\n"
    script = tmp_path / "learner.py"
    script.write_text(text)
    shared_before = set(os.listdir("/dev/shm"))
    learner = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    assert learner.stdout is not None
    pids = [int(word) for word in learner.stdout.readline().split()]
    assert len(pids) == 3
    if in_thread:
        assert learner.stdout.readline() == "alive\n"
    learner.kill()
    learner.wait()
    learner.stdout.close()
    until = time.monotonic() + 10.0
    while time.monotonic() < until and any(_is_alive(pid) for pid in pids):
        time.sleep(0.01)
    assert not any(_is_alive(pid) for pid in pids), "one of them hangs in a step, two sleep"
    # Others may use the folder meanwhile; these are names that Python gives shared memory and semaphores.
    left = set(os.listdir("/dev/shm")) - shared_before
    assert not [name for name in left if name.startswith(("psm_", "pymp-", "sem.", "vhs-rollout"))]


def _is_alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Python's own handler, also where the tests were started to ignore Ctrl-C, as by a shell's `&`."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_ends_a_wait_at_once() -> None:
    with RolloutPool(Ledger, 1, seed=0) as pool:
        pool.reset()
        pool.recv()
        main = threading.main_thread()
        os.kill(pool.pids[0], signal.SIGSTOP)  # so that no answer comes
        pool.send([0])
        timer = threading.Timer(0.2, signal.pthread_kill, (main.ident, signal.SIGINT))
        timer.start()
        before = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            pool.recv()
        assert time.monotonic() - before < 10.0
        timer.join()
        os.kill(pool.pids[0], signal.SIGCONT)
        assert pool.recv(timeout=10).steps.tolist() == [1]


def test_answers_that_lie_ready_are_given_in_no_time_although_a_worker_died() -> None:
    with RolloutPool(Ledger, 2, 1, seed=0) as pool:
        pool.reset()
        pool.recv()
        os.kill(pool.pids[0], signal.SIGSTOP)
        pool.send([1, 2])
        pool.recv(1)
        pool.send([2], [1])
        os.kill(pool.pids[0], signal.SIGKILL)
        time.sleep(1.0)  # the answer of the second lies there, and the death of the first is told
        assert pool.recv(1, timeout=0).env_ids.tolist() == [1]
        assert pool.recv(timeout=20).is_cut.tolist() == [True]


DYING_LEARNER = """
import multiprocessing
from rollout_envs import Ledger
from vhs.rollout import RolloutPool

def learn():
    pool = RolloutPool(Ledger, 2, seed=0)
    pool.reset()
    raise SystemExit(7)

learner = multiprocessing.get_context("fork").Process(target=learn)
learner.start()
learner.join()
print(learner.exitcode)
"""


def test_a_learner_that_ends_with_an_open_pool_ends() -> None:
    """multiprocessing sends its processes SIGTERM, which workers leave to the learner, and waits for them."""
    result = subprocess.run(
        [sys.executable, "-c", DYING_LEARNER],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parent)},
    )
    assert result.stdout == "7\n", result.stderr
