"""Who steps the rooms makes no difference: this process, one worker, two, or a worker that is killed."""

import os
import signal
import sys
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import torch

from vhs.acting.stepping import PooledRooms
from vhs.config import Config, load_config
from vhs.runs.checkpoint import load_checkpoint
from vhs.runs.rows import read_log
from vhs.train import train
from vhs.train.build import make_rooms

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="worker processes need Linux")
CONFIGS = Path(__file__).parents[2] / "configs"


def debug_config(*overrides: str) -> Config:
    return load_config([CONFIGS / "debug.yaml"], ["train.episodes=40", *overrides])


def test_lock_step_gives_the_same_weights_for_any_number_of_workers(tmp_path: Path) -> None:
    weights = []
    for workers in (0, 1, 2):
        run = tmp_path / str(workers)
        train(debug_config(f"env.num_workers={workers}"), run, StringIO())
        state, _ = load_checkpoint(run)
        weights.append(state["learner"]["agent"])
    for other in weights[1:]:
        for name, value in weights[0].items():
            assert torch.equal(value, other[name]), name


def test_first_ready_trains_too(tmp_path: Path) -> None:
    assert train(debug_config("env.num_workers=2", "env.min_ready=1"), tmp_path / "run", StringIO())
    (row,) = read_log(tmp_path / "run")
    assert row["episodes"] == 40
    assert row["episodes_cut"] == 0


def test_a_killed_worker_is_announced_and_its_room_begins_anew() -> None:
    rooms = make_rooms(debug_config("env.num_workers=2"), 4)
    assert isinstance(rooms, PooledRooms)
    try:
        streams = np.arange(4)
        rooms.reset(range(4), [1, 2, 3, 4])
        assert rooms.recv().is_first.all()
        victim = rooms._pool.pids[0]
        assert victim is not None
        os.kill(victim, signal.SIGKILL)
        rooms.send(streams, np.ones(4, dtype=np.int64))
        answers = rooms.recv()
        assert answers.streams.tolist() == [0, 1, 2, 3]
        assert answers.is_cut.tolist() == [True, True, False, False]
        assert answers.is_first.tolist() == [True, True, False, False]
        # What a checkpoint needs to repeat them.
        again = make_rooms(debug_config("env.num_workers=0"), 2)
        again.reset([0, 1], answers.seeds[:2])
        np.testing.assert_array_equal(again.recv().images, answers.images[:2])
    finally:
        rooms.close()


def test_workers_leave_the_end_of_a_service_to_the_learner() -> None:
    rooms = make_rooms(debug_config("env.num_workers=2"), 4)
    assert isinstance(rooms, PooledRooms)
    try:
        rooms.reset(range(4), [1, 2, 3, 4])
        rooms.recv()
        for process in rooms._pool.pids:
            assert process is not None
            os.kill(process, signal.SIGTERM)
        rooms.send(np.arange(4), np.ones(4, dtype=np.int64))
        assert not rooms.recv().is_cut.any()
    finally:
        rooms.close()


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
