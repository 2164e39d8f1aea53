"""Checkpoints under real kills: the newest complete one is always there to go on from."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from vhs import GoalStore
from vhs.errors import CheckpointError
from vhs.train.checkpoint import has_checkpoint, load_checkpoint, save_checkpoint

WRITER = """
import sys, torch, numpy as np
from itertools import count
from pathlib import Path
from vhs import GoalStore
from vhs.train.checkpoint import save_checkpoint
store = GoalStore(1, (64, 64, 3), 50, seed=0)
for _ in range(50):
    store.push(np.zeros((64, 64, 3), dtype=np.uint8), 0)
for episode in count(1):
    state = {"episode": episode, "weights": torch.full((200_000,), float(episode))}
    save_checkpoint(Path(sys.argv[1]), episode, state, store, keep=2)
    print(episode, flush=True)
"""


def store_with(images: int) -> GoalStore:
    store = GoalStore(2, (4, 4, 3), 10, seed=0)
    for index in range(images):
        store.push(np.full((4, 4, 3), index, dtype=np.uint8), index % 2)
    return store


def test_the_newest_is_loaded_and_the_oldest_leave(tmp_path: Path) -> None:
    for episode in (1, 2, 10):
        save_checkpoint(tmp_path, episode, {"value": torch.tensor(episode)}, store_with(episode), keep=2)
    state, store = load_checkpoint(tmp_path)
    assert state["value"].item() == 10
    assert len(store) == 10
    assert [path.name for path in sorted((tmp_path / "checkpoints").iterdir())] == [
        "episode-000000002",
        "episode-000000010",
    ]


def test_no_checkpoint_is_an_error_that_names_the_place(tmp_path: Path) -> None:
    assert not has_checkpoint(tmp_path)
    with pytest.raises(CheckpointError, match=r"expected a checkpoint in .*checkpoints, found none"):
        load_checkpoint(tmp_path)


def test_saving_the_same_episode_again_touches_nothing(tmp_path: Path) -> None:
    first = save_checkpoint(tmp_path, 5, {"value": 1}, store_with(1), keep=2)
    before = {path.name: path.stat().st_mtime_ns for path in first.iterdir()}
    assert save_checkpoint(tmp_path, 5, {"value": 2}, store_with(2), keep=2) == first
    assert {path.name: path.stat().st_mtime_ns for path in first.iterdir()} == before


def test_a_kill_at_any_moment_leaves_a_whole_checkpoint(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for turn in range(5):
        run = tmp_path / str(turn)
        process = subprocess.Popen([sys.executable, "-c", WRITER, str(run)], stdout=subprocess.PIPE)
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(float(rng.uniform(0, 0.05)))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        process.stdout.close()
        state, store = load_checkpoint(run)
        assert torch.all(state["weights"] == state["episode"])
        assert len(store) == 50
