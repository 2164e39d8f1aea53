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
from vhs.errors import CheckpointError, OutputError
from vhs.runs.checkpoint import (
    has_checkpoint,
    load_checkpoint,
    newest_checkpoint,
    remove_partial_checkpoints,
    save_checkpoint,
)

WRITER = """
import sys, torch, numpy as np
from itertools import count
from pathlib import Path
from vhs import GoalStore
from vhs.runs.checkpoint import save_checkpoint
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


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (PermissionError(13, "Permission denied"), "cannot be read: Permission denied"),
        (OSError(24, "Too many open files"), "cannot be read: Too many open files"),
        (MemoryError(), "cannot be read: not enough memory"),
    ],
)
def test_a_checkpoint_that_cannot_be_read_is_not_called_damaged(
    error: Exception, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    for episode in (1, 2):
        save_checkpoint(tmp_path, episode, {"value": 1}, store_with(1), keep=2)
    monkeypatch.setattr("vhs.runs.checkpoint.decode_state", fail)
    with pytest.raises(CheckpointError, match=f"episode-000000002: {message}$"):
        load_checkpoint(tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="the limit is one of Unix")
def test_a_full_disk_is_said_and_the_checkpoint_before_stays(tmp_path: Path) -> None:
    import resource

    save_checkpoint(tmp_path, 1, {"value": 1}, store_with(1), keep=1)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.raises(OutputError, match=r"episode-000000002: cannot write: File too large$"):
            save_checkpoint(tmp_path, 2, {"value": torch.zeros(100_000)}, store_with(1), keep=1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert load_checkpoint(tmp_path)[0] == {"value": 1}


def test_every_flipped_bit_of_a_checkpoint_is_refused_and_the_older_one_named(tmp_path: Path) -> None:
    state = {
        "weights": torch.arange(9.0),
        "rng": torch.tensor([2**63], dtype=torch.uint64),
        "at": {3: [1, 0.5]},
    }
    for episode in (1, 2):
        save_checkpoint(tmp_path, episode, state, store_with(1), keep=2)
    newest = tmp_path / "checkpoints" / "episode-000000002"
    assert sorted(path.name for path in newest.iterdir()) == [
        "goals.vhs",
        "manifest.json",
        "state.json",
        "state.safetensors",
    ]
    told = "damaged checkpoint: (.|\n)*; move it away to go on from episode-000000001$"
    rng = np.random.default_rng(0)
    for path in newest.iterdir():
        content = path.read_bytes()
        for position in rng.choice(len(content), 40, replace=False):
            flipped = bytearray(content)
            flipped[position] ^= 1 << rng.integers(8)
            path.write_bytes(flipped)
            if path.name == "manifest.json" and b" " in (
                content[position : position + 1],
                bytes([flipped[position]]),
            ):
                continue  # white space says nothing
            with pytest.raises(CheckpointError, match=told):
                load_checkpoint(tmp_path)
        path.write_bytes(content)
    found, _ = load_checkpoint(tmp_path)
    assert found["at"] == {3: [1, 0.5]}
    assert found["rng"].dtype == torch.uint64
    assert torch.equal(found["rng"], state["rng"])


def test_foreign_names_neither_crash_nor_win_nor_leave(tmp_path: Path) -> None:
    save_checkpoint(tmp_path, 5, {"value": 5}, store_with(1), keep=1)
    root = tmp_path / "checkpoints"
    for name in ("episode-best", "episode-000000099.bak", "episode-9", ".partial-mine", "notes"):
        (root / name).mkdir()
    (root / "episode-000000999").write_text("a file")
    assert newest_checkpoint(tmp_path) == 5
    remove_partial_checkpoints(tmp_path)
    save_checkpoint(tmp_path, 6, {"value": 6}, store_with(1), keep=1)
    assert load_checkpoint(tmp_path)[0] == {"value": 6}
    assert len(list(root.iterdir())) == 7


def test_a_pickle_of_an_earlier_version_is_refused_unread(tmp_path: Path) -> None:
    checkpoint = tmp_path / "checkpoints" / "episode-000000004"
    checkpoint.mkdir(parents=True)
    (checkpoint / "state.pt").write_bytes(b"cos\nsystem\n(S'touch executed'\ntR.")
    with pytest.raises(
        CheckpointError, match=r"expected a checkpoint of format vhs-checkpoint-2, found state"
    ):
        load_checkpoint(tmp_path)


def test_what_is_no_plain_value_is_named_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"a plain value at learner\.rng, found ndarray"):
        save_checkpoint(tmp_path, 1, {"learner": {"rng": np.zeros(2)}}, store_with(1), keep=1)
    assert not has_checkpoint(tmp_path)


def test_no_checkpoint_is_an_error_that_names_the_place(tmp_path: Path) -> None:
    assert not has_checkpoint(tmp_path)
    with pytest.raises(CheckpointError, match=r"expected a checkpoint in .*checkpoints, found none"):
        load_checkpoint(tmp_path)


def test_saving_the_same_episode_again_touches_nothing(tmp_path: Path) -> None:
    first = save_checkpoint(tmp_path, 5, {"value": 1}, store_with(1), keep=2)
    before = {path.name: path.stat().st_mtime_ns for path in first.iterdir()}
    assert save_checkpoint(tmp_path, 5, {"value": 2}, store_with(2), keep=2) == first
    assert {path.name: path.stat().st_mtime_ns for path in first.iterdir()} == before


@pytest.mark.slow
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
