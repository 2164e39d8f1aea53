"""Who steps the environments makes no difference: this process, one worker, two, or one that is killed."""

import os
import signal
import sys
from contextlib import closing
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from debug import debug_config
from toy import Toy

from vhs.acting.setup import make_stepping, task_of
from vhs.acting.stepping import PooledStepping, StepBatch, Stepping
from vhs.errors import ReplayError
from vhs.runs.checkpoint import load_checkpoint
from vhs.runs.rows import read_log
from vhs.task import Task
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


def received(stepping: Stepping) -> StepBatch:
    while (batch := stepping.recv()) is None:
        pass
    return batch


def kill_first_worker(stepping: Stepping, kind: signal.Signals = signal.SIGKILL) -> None:
    assert isinstance(stepping, PooledStepping)
    victim = stepping.pids[0]
    assert victim is not None
    os.kill(victim, kind)


def test_episodes_of_a_killed_worker_go_on_as_if_nothing_had_happened() -> None:
    alone, pooled = stepped(0, 4), stepped(2, 4)
    with closing(pooled):
        for stepping in (alone, pooled):
            stepping.reset(range(4), [1, 2, 3, 4])
        for step, actions in enumerate(([0, 1, 2, 0], [1, 1, 0, 2], [0, 0, 0, 0])):
            expected, found = received(alone), received(pooled)
            for name in ("streams", "frames", "goals", "rewards", "is_first", "terminated", "truncated"):
                np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)
            assert found.seeds == [1, 2, 3, 4]
            assert not found.is_cut.any()
            if step != 1:
                kill_first_worker(pooled)
            for stepping in (alone, pooled):
                stepping.send(np.arange(4), np.array(actions))
        np.testing.assert_array_equal(received(pooled).frames, received(alone).frames)


def test_an_episode_that_cannot_be_repeated_is_cut() -> None:
    config = debug_config("env.num_workers=2")
    task = replace(task_of(config), replayable=False)
    with closing(make_stepping(config, task, task.spec(), 4)) as stepping:
        stepping.reset(range(4), [1, 2, 3, 4])
        assert received(stepping).is_first.all()
        kill_first_worker(stepping)
        stepping.send(np.arange(4), np.ones(4, dtype=np.int64))
        batch = received(stepping)
        assert batch.streams.tolist() == [0, 1, 2, 3]
        assert batch.is_cut.tolist() == [True, True, False, False]
        assert batch.is_first.tolist() == [True, True, False, False]
        # What a checkpoint needs to repeat them.
        again = stepped(0, 2)
        again.reset([0, 1], batch.seeds[:2])
        np.testing.assert_array_equal(received(again).frames, batch.frames[:2])


class Unsteady(Toy):
    """Pays by the process that steps it."""

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        observation, _, terminated, truncated, info = super().step(action)
        return observation, float(os.getpid()), terminated, truncated, info


def test_an_episode_that_goes_otherwise_when_it_is_played_again_is_said() -> None:
    config = debug_config("env.num_workers=1")
    task = Task(name="unsteady", make=Unsteady, max_steps=6, interactions={3: 0, 4: 1})
    with closing(make_stepping(config, task, task.spec(), 1)) as stepping:
        stepping.reset([0], [5])
        for _ in range(2):
            received(stepping)
            stepping.send(np.array([0]), np.array([0]))
        received(stepping)
        kill_first_worker(stepping)
        stepping.send(np.array([0]), np.array([0]))
        with pytest.raises(ReplayError, match=r"episode of seed 5 again: expected reward .* after 1 steps"):
            received(stepping)


def test_a_worker_that_hangs_is_replaced_and_its_episode_goes_on() -> None:
    config = debug_config("env.num_workers=1", "env.deadline_s=1")
    task = task_of(config)
    alone = stepped(0, 2)
    with closing(make_stepping(config, task, task.spec(), 2)) as stepping:
        for each in (alone, stepping):
            each.reset(range(2), [1, 2])
            received(each)
            each.send(np.arange(2), np.array([0, 1]))
            received(each)
        kill_first_worker(stepping, signal.SIGSTOP)
        for each in (alone, stepping):
            each.send(np.arange(2), np.array([0, 1]))
        assert stepping.recv() is None, "nothing comes in the first moment"
        np.testing.assert_array_equal(received(stepping).frames, received(alone).frames)


def test_workers_leave_the_end_of_a_service_to_the_learner() -> None:
    stepping = stepped(2, 4)
    assert isinstance(stepping, PooledStepping)
    try:
        stepping.reset(range(4), [1, 2, 3, 4])
        received(stepping)
        for process in stepping.pids:
            assert process is not None
            os.kill(process, signal.SIGTERM)
        stepping.send(np.arange(4), np.ones(4, dtype=np.int64))
        assert not received(stepping).is_cut.any()
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
