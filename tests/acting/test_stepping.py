"""Who steps the environments makes no difference: this process, one worker, two, or one that is killed."""

import os
import signal
import sys
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import torch
from debug import debug_config

from vhs.acting.setup import make_stepping, task_of
from vhs.acting.stepping import PooledStepping, Stepping
from vhs.runs.checkpoint import load_checkpoint
from vhs.runs.rows import read_log
from vhs.train import train

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="worker processes need Linux")


def stepped(workers: int, count: int) -> Stepping:
    config = debug_config(f"env.num_workers={workers}")
    task = task_of(config)
    return make_stepping(config, task, task.spec(), count)


@pytest.mark.slow
def test_lock_step_gives_the_same_weights_for_any_number_of_workers(tmp_path: Path) -> None:
    weights = []
    for workers in (0, 1, 2):
        run = tmp_path / str(workers)
        train(debug_config(f"env.num_workers={workers}", "train.episodes=40"), run, StringIO())
        state, _ = load_checkpoint(run)
        weights.append(state["learner"]["agent"])
    for other in weights[1:]:
        for name, value in weights[0].items():
            assert torch.equal(value, other[name]), name


def test_first_ready_trains_too(tmp_path: Path) -> None:
    assert train(
        debug_config("env.num_workers=2", "env.min_ready=1", "train.episodes=40"),
        tmp_path / "run",
        StringIO(),
    )
    (row,) = read_log(tmp_path / "run")
    assert row["episodes"] == 40
    assert row["episodes_cut"] == 0


def test_a_killed_worker_is_announced_and_its_environments_begin_anew() -> None:
    stepping = stepped(2, 4)
    assert isinstance(stepping, PooledStepping)
    try:
        streams = np.arange(4)
        stepping.reset(range(4), [1, 2, 3, 4])
        assert stepping.recv().is_first.all()
        victim = stepping.pids[0]
        assert victim is not None
        os.kill(victim, signal.SIGKILL)
        stepping.send(streams, np.ones(4, dtype=np.int64))
        batch = stepping.recv()
        assert batch.streams.tolist() == [0, 1, 2, 3]
        assert batch.is_cut.tolist() == [True, True, False, False]
        assert batch.is_first.tolist() == [True, True, False, False]
        # What a checkpoint needs to repeat them.
        again = stepped(0, 2)
        again.reset([0, 1], batch.seeds[:2])
        np.testing.assert_array_equal(again.recv().frames, batch.frames[:2])
    finally:
        stepping.close()


def test_workers_leave_the_end_of_a_service_to_the_learner() -> None:
    stepping = stepped(2, 4)
    assert isinstance(stepping, PooledStepping)
    try:
        stepping.reset(range(4), [1, 2, 3, 4])
        stepping.recv()
        for process in stepping.pids:
            assert process is not None
            os.kill(process, signal.SIGTERM)
        stepping.send(np.arange(4), np.ones(4, dtype=np.int64))
        assert not stepping.recv().is_cut.any()
    finally:
        stepping.close()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["env.num_envs=4", "env.num_workers=3"], "env.num_envs: expected a multiple of env.num_workers = 3"),
        (["env.num_envs=4", "env.min_ready=5"], "env.min_ready: expected at most env.num_envs = 4, found 5"),
    ],
)
def test_workers_that_cannot_share_the_rooms_are_refused(overrides: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        debug_config(*overrides)
