"""Buffers that stay on the disk: appended to, left in every way, reopened and gone on with."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vhs

SIZES: dict[str, Any] = {"num_streams": 1, "max_episode_steps": 5, "capacity_steps": 60, "frame_stack": 1}
FIELDS = {"compass": vhs.Field((2,))}


def new_buffer(path: Path | str, **given: Any) -> vhs.EpisodeBuffer:
    return vhs.EpisodeBuffer((300,), backing=path, persistent=True, fields=FIELDS, **(SIZES | given))


def play(buffer: vhs.EpisodeBuffer, number: int) -> int:
    """An episode of 1 to 5 steps whose frames and compasses follow from its number."""
    compass = {"compass": np.full(2, number, np.float32)}
    buffer.begin(0, np.full(300, number % 251, np.uint8), fields=compass)
    for step in range(1, number % 5 + 2):
        frame = np.full(300, (number + step) % 251, np.uint8)
        buffer.append(0, step, float(number), None, frame, fields=compass)
    return buffer.finish(0, "failure")


def check(buffer: vhs.EpisodeBuffer) -> None:
    """Every stored episode is whole."""
    for id in buffer.ids.tolist():
        batch = buffer.gather([id])
        frames = [(id + step) % 251 for step in range(id % 5 + 2)]
        np.testing.assert_array_equal(batch.observations, np.array(frames)[:, None, None].repeat(300, 2))
        assert batch.rewards.tolist() == [[id] * (id % 5 + 1)]
        assert set(batch.fields["compass"].ravel().tolist()) == {id}


WRITER = """
import sys
from test_persistent import new_buffer, play, vhs
buffer = vhs.EpisodeBuffer.reopen(sys.argv[1])
number = int(buffer.ids[-1]) + 1 if len(buffer) else 0
while True:
    assert play(buffer, number) == number
    print(number, flush=True)
    number += 1
"""


def killed_writer(path: Path, episodes: int) -> int:
    """Another process goes on until so many episodes are told, and is killed; returns the last one told."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    command = [sys.executable, "-c", WRITER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env) as writer:
        assert writer.stdout is not None
        for _ in range(episodes):
            last = writer.stdout.readline()
        time.sleep(0.003 * (episodes % 7))  # somewhere in the middle of what it does
        writer.send_signal(signal.SIGKILL)
        told = [last, *writer.stdout.read().split("\n")]
    # A kill may leave a part of a line.
    return max(int(line) for line in told[:-1] if line.strip()) if len(told) > 1 else int(last)


@pytest.mark.slow
def test_what_was_finished_outlives_a_kill(tmp_path: Path) -> None:
    path, ended = tmp_path / "buffer", 0
    new_buffer(path)
    for episodes in (1, 40, 9):
        told = killed_writer(path, episodes)
        buffer = vhs.EpisodeBuffer.reopen(path)
        assert int(buffer.ids[-1]) >= told > ended - 1
        assert buffer.num_steps <= 60
        assert not buffer.open.any()
        check(buffer)
        ended = play(buffer, int(buffer.ids[-1]) + 1)
        check(buffer)
        del buffer


def test_a_reopened_buffer_goes_on_and_copies_nothing(tmp_path: Path) -> None:
    buffer = new_buffer(tmp_path, seed=3, num_goals=4)
    for number in range(40):
        play(buffer, number)
    stored = buffer.ids.tolist()
    size = {file.name: file.stat().st_size for file in tmp_path.iterdir()}
    assert set(size) == {"journal", "lock", "frames", "field-1"}
    del buffer
    buffer = vhs.EpisodeBuffer.reopen(tmp_path, check=False)
    assert buffer.ids.tolist() == stored
    assert (buffer.num_goals, buffer.fields, buffer.capacity_steps) == (4, FIELDS, 60)
    assert {file.name: file.stat().st_size for file in tmp_path.iterdir()} == size
    check(buffer)
    first = buffer.sample_transitions(8).ids.tolist()
    del buffer
    # The same again draws the same: the generator follows from the seed and the episodes so far.
    assert vhs.EpisodeBuffer.reopen(tmp_path).sample_transitions(8).ids.tolist() == first


def test_a_torn_tail_is_cut_and_damage_is_told(tmp_path: Path) -> None:
    buffer = new_buffer(tmp_path)
    for number in range(4):
        play(buffer, number)
    del buffer
    journal = tmp_path / "journal"
    whole = journal.read_bytes()
    journal.write_bytes(whole[:-5])
    assert vhs.EpisodeBuffer.reopen(tmp_path).ids.tolist() == [0, 1, 2]
    assert len(journal.read_bytes()) < len(whole) - 5
    damaged = bytearray(whole)
    damaged[len(whole) // 2] ^= 1
    journal.write_bytes(damaged)
    with pytest.raises(vhs.DamagedFileError, match="journal: `"):
        vhs.EpisodeBuffer.reopen(tmp_path)
    assert journal.read_bytes() == damaged


def test_a_folder_belongs_to_one_buffer(tmp_path: Path) -> None:
    buffer = new_buffer(tmp_path)
    with pytest.raises(vhs.ArgumentError, match="`backing`: expected a folder that no other buffer uses"):
        vhs.EpisodeBuffer.reopen(tmp_path)
    del buffer
    with pytest.raises(vhs.ArgumentError, match="`backing`: expected a folder without a buffer"):
        new_buffer(tmp_path)
    with pytest.raises(vhs.ArgumentError, match="`backing`: expected a folder where persistent is true"):
        new_buffer("memory")
    with pytest.raises(FileNotFoundError):
        vhs.EpisodeBuffer.reopen(tmp_path / "missing")
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        new_buffer(tmp_path / "file")


def test_a_saved_buffer_is_one_of_memory_and_disk_alike(tmp_path: Path) -> None:
    buffer = new_buffer(tmp_path / "buffer")
    for number in range(30):
        play(buffer, number)
    buffer.save(tmp_path / "saved")
    loaded = vhs.EpisodeBuffer.load(tmp_path / "saved")
    check(loaded)
    assert loaded.ids.tolist() == buffer.ids.tolist()


@pytest.mark.parametrize("where", ["memory", "scratch", "persistent"])
def test_clear_forgets_what_is_finished(where: str, tmp_path: Path) -> None:
    backing = "memory" if where == "memory" else tmp_path / "buffer"
    sizes = {**SIZES, "num_streams": 2, "priority_exponent": 0.5}
    buffer = vhs.EpisodeBuffer(
        (300,), backing=backing, persistent=where == "persistent", fields=FIELDS, **sizes
    )
    for number in range(3):
        play(buffer, number)
    buffer.begin(1, np.zeros(300, np.uint8), fields={"compass": np.zeros(2, np.float32)})
    used = buffer.nbytes
    buffer.clear()
    assert (len(buffer), buffer.num_steps, buffer.open.tolist()) == (0, 0, [False, True])
    with pytest.raises(vhs.EmptyError):
        buffer.sample_transitions(1)
    with pytest.raises(vhs.EpisodeError):
        buffer.gather([0])
    buffer.clear()
    for number in range(3, 6):
        assert play(buffer, number) == number
    check(buffer)
    assert set(buffer.sample_transitions(50, beta=1.0).ids.tolist()) == {3, 4, 5}
    assert buffer.nbytes <= 2 * used
    if where == "persistent":
        del buffer
        assert vhs.EpisodeBuffer.reopen(tmp_path / "buffer").ids.tolist() == [3, 4, 5]
