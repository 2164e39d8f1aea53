"""Saves: where they write, who goes on meanwhile, and how they are given up."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import vhs

from .recorded import make_episode, play, record


def store_of(images: int) -> vhs.GoalStore:
    store = vhs.GoalStore(1, (1,), 9)
    for _ in range(images):
        store.push(np.zeros(1, np.uint8), 0)
    return store


def saved(kind: str, size: int, path: Path) -> int:
    """Saves a store or a buffer of this size, and gives the size that is read back."""
    if kind == "store":
        store_of(size).save(path)
        return len(vhs.GoalStore.load(path))
    record([2] * size).buffer.save(path)
    return len(vhs.EpisodeBuffer.load(path))


KINDS = pytest.mark.parametrize("kind", ["store", "buffer"])


@KINDS
def test_links_lead_to_what_is_written(kind: str, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    real, link, chain, dangling = (tmp_path / name for name in ("disk/real", "latest", "chain", "dangling"))
    saved(kind, 1, real)
    link.symlink_to(Path("disk") / "real")
    chain.symlink_to(link)
    dangling.symlink_to(Path("disk") / "new")
    assert saved(kind, 2, link) == saved(kind, 2, real) == 2
    assert saved(kind, 3, chain) == 3
    assert saved(kind, 4, dangling) == 4
    assert all(path.is_symlink() for path in (link, chain, dangling))
    assert sorted(path.name for path in (tmp_path / "disk").iterdir()) == ["new", "real"]
    circle = tmp_path / "circle"
    circle.symlink_to("circle")
    with pytest.raises(OSError, match="symbolic links"):
        saved(kind, 1, circle)


@KINDS
@pytest.mark.parametrize("mode", [0o600, 0o660, 0o644])
def test_a_file_keeps_its_mode(kind: str, mode: int, tmp_path: Path) -> None:
    path = tmp_path / "file"
    saved(kind, 1, path)
    path.chmod(mode)
    assert saved(kind, 2, path) == 2
    assert stat.S_IMODE(path.stat().st_mode) == mode


@KINDS
def test_what_is_no_file_is_refused_and_stays(kind: str, tmp_path: Path) -> None:
    pipe, link, folder = tmp_path / "pipe", tmp_path / "link", tmp_path / "folder"
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    folder.mkdir()
    for path in (pipe, link):
        with pytest.raises(OSError, match="something that is no file, such as a device or a pipe"):
            saved(kind, 1, path)
        for load in (vhs.GoalStore.load, vhs.EpisodeBuffer.load, vhs.EpisodeBuffer.verify):
            with pytest.raises(OSError, match="something that is no file"):
                load(path)
    with pytest.raises(IsADirectoryError):
        saved(kind, 1, folder)
    assert stat.S_ISFIFO(pipe.lstat().st_mode)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "link", "pipe"]


@KINDS
@pytest.mark.parametrize("name", ["n" * 255, "\N{SNOWMAN}" * 85])
def test_a_name_may_be_as_long_as_the_system_allows(kind: str, name: str, tmp_path: Path) -> None:
    assert saved(kind, 1, tmp_path / name) == 1
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.slow
def test_a_buffer_is_saved_as_it_was_while_others_record_and_draw(tmp_path: Path) -> None:
    recording = record([3] * 10, capacity=30)
    recording.buffer.save(tmp_path / "before")
    started, is_over = threading.Event(), threading.Event()

    def record_more() -> None:
        number = 100
        while not is_over.is_set():
            recording.episodes.append(episode := make_episode(number, 1 + number % 6))
            play(recording, episode)
            number += 1
            started.set()

    thread = threading.Thread(target=record_more)
    thread.start()
    started.wait()
    try:
        for number in range(40):
            path = tmp_path / f"save-{number}"
            recording.buffer.save(path)
            vhs.EpisodeBuffer.verify(path)
            loaded = vhs.EpisodeBuffer.load(path)
            batch = loaded.gather(loaded.ids)
            for place, episode in enumerate(batch.ids.tolist()):
                own = recording.episodes[episode]
                rows = slice(batch.offsets[place], batch.offsets[place] + len(own) + 1)
                np.testing.assert_array_equal(batch.observations[rows, 1], own.frames)
                np.testing.assert_array_equal(batch.achieved_goals[rows], own.achieved)
    finally:
        is_over.set()
        thread.join()
    assert recording.buffer.nbytes < 2_000_000, "slots are used again once a save is over"


# A buffer of 400 MB, a thread that samples single rows while another saves it, and how long the longest took.
BESIDE = """
import sys, threading, time
import numpy as np, vhs
buffer = vhs.EpisodeBuffer((1024, 1024), num_streams=1, max_episode_steps=50, capacity_steps=400)
frame = np.zeros((1024, 1024), np.uint8)
for _ in range(8):
    buffer.begin(0, frame)
    for _ in range(49):
        buffer.append(0, 1, 0, 0, frame)
    buffer.finish(0, "failure")
thread = threading.Thread(target=buffer.save, args=(sys.argv[1],))
thread.start()
drawn = 0
while thread.is_alive():
    buffer.sample_transitions(1)
    buffer.begin(0, frame), buffer.append(0, 1, 0, 0, frame), buffer.abort(0)
    drawn += 1
print(drawn)
"""


@pytest.mark.slow
def test_readers_and_writers_go_on_beside_a_save(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", BESIDE, str(tmp_path / "buffer")], capture_output=True, text=True, check=True
    )
    assert int(done.stdout) >= 5, "one would have waited for the end"


# Calls that take long, and a signal shortly after each begins; prints how long it took to be heard.
INTERRUPTED = """
import os, signal, sys, threading, time
import numpy as np, vhs
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background has it ignored
path = sys.argv[1]
frame = np.zeros((1024, 1024), np.uint8)
buffer = vhs.EpisodeBuffer((1024, 1024), num_streams=1, max_episode_steps=50, capacity_steps=400)
for _ in range(8):
    buffer.begin(0, frame)
    for _ in range(49):
        buffer.append(0, 1, 0, 0, frame)
    buffer.finish(0, "failure")
store = vhs.GoalStore(1, (1024, 1024), 400)
for _ in range(400):
    store.push(frame, 0)
buffer.save(path + "-buffer"), store.save(path + "-store")
def files():
    found = [os.stat(path + kind) for kind in ("-buffer", "-store")]
    return [(each.st_ino, each.st_size, each.st_mtime_ns) for each in found]
old = files()
out = np.empty((8 * 400, 2, 1024, 1024), np.uint8)  # of address space: pages come as they are written
calls = {
    "save": lambda: buffer.save(path + "-buffer"), "load": lambda: vhs.EpisodeBuffer.load(path + "-buffer"),
    "verify": lambda: vhs.EpisodeBuffer.verify(path + "-buffer"),
    "gather": lambda: buffer.gather([0] * 60, out=out),
    "save goals": lambda: store.save(path + "-store"),
    "load goals": lambda: vhs.GoalStore.load(path + "-store"),
    "verify goals": lambda: vhs.GoalStore.verify(path + "-store"),
}
for name, call in calls.items():
    signalled = []
    def interrupt():
        signalled.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)
    timer = threading.Timer(0.01, interrupt)
    timer.start()
    try:
        call()
        time.sleep(10)
        sys.exit(f"{name}: not heard")
    except KeyboardInterrupt:
        print(name, time.perf_counter() - signalled[0])
    assert files() == old, name
"""


@pytest.mark.slow
def test_long_calls_hear_ctrl_c_and_change_nothing(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, str(tmp_path / "file")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    heard = {line.rsplit(" ", 1)[0]: float(line.rsplit(" ", 1)[1]) for line in done.stdout.splitlines()}
    assert len(heard) == 7
    assert max(heard.values()) < 5, heard
    assert len(list(tmp_path.iterdir())) == 2, "no temporary file is left"
