"""Forks: a child draws of its own, whatever its parent's threads were doing, and the same when run again."""

from __future__ import annotations

import subprocess
import sys

import pytest

OBJECTS = """
import os, sys, threading, time
import numpy as np, vhs

def buffer():
    made = vhs.EpisodeBuffer((200, 200), num_streams=1, max_episode_steps=20, capacity_steps=400)
    for number in range(20):
        made.begin(0, np.full((200, 200), number, np.uint8))
        for _ in range(20):
            made.append(0, 0, 0.0, 0.0, np.full((200, 200), number, np.uint8))
        made.finish(0, "failure")
    return made

def store():
    made = vhs.GoalStore(3, (200, 200), 50)
    for number in range(60):
        made.push(np.full((200, 200), number, np.uint8), number % 3)
    return made

class Generator:
    def __init__(self):
        self.rng, self.batch = vhs.Rng(), buffer().gather(range(20))
    def draw(self, n):
        return vhs.relabel(self.batch, rng=self.rng, probability=0.5).selected[:n]

made = {
    "buffer": buffer, "store": store, "prototypes": lambda: vhs.Prototypes(5, 32), "rng": Generator,
}[sys.argv[1]]()
draw = {
    "buffer": lambda n: made.sample_transitions(n).steps,
    "store": lambda n: made.sample(n, balanced=False)[0][:, 0, 0],
    "prototypes": lambda n: made.embed([0] * n)[:, 0],
    "rng": lambda n: made.draw(n),
}[sys.argv[1]]
"""

DRAWN = (
    OBJECTS
    + """
def child(then=None):
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        lines = [repr(draw(16).tolist())] + ([then()] if then else [])
        os.write(write, "|".join(lines).encode())
        os._exit(0)
    os.close(write)
    told = os.fdopen(read).read()
    assert os.waitpid(pid, 0)[1] == 0
    return told

draw(16)
drawn = [child(), child(), *child(child).split("|"), repr(draw(16).tolist()), child()]
assert len(set(drawn)) == 6, drawn
print(drawn)
"""
)

ALONE = (
    OBJECTS
    + """
draw(16)
print(repr(draw(16).tolist()))
"""
)

BUSY = (
    OBJECTS
    + """
def work():
    while True:
        draw(16)
        if sys.argv[1] == "buffer":
            made.begin(0, np.zeros((200, 200), np.uint8))
            made.append(0, 0, 0.0, 0.0, np.zeros((200, 200), np.uint8))
            made.finish(0, "failure")
        if sys.argv[1] == "store":
            made.push(np.zeros((200, 200), np.uint8), 0)

for _ in range(2):
    threading.Thread(target=work, daemon=True).start()
for number in range(60):
    pid = os.fork()
    if pid == 0:
        import signal
        signal.alarm(20)
        draw(8), draw(8)
        os._exit(0)
    assert os.waitpid(pid, 0)[1] == 0, f"child {number} hung"
    time.sleep(0.002)
print("done", flush=True)
os._exit(0)
"""
)


def run(program: str, kind: str) -> str:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program, kind], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


KINDS = ("buffer", "store", "prototypes", "rng")


@pytest.mark.parametrize("kind", KINDS)
def test_children_draw_of_their_own_and_the_same_when_the_program_is_repeated(kind: str) -> None:
    first = run(DRAWN, kind)
    assert run(DRAWN, kind) == first
    assert run(ALONE, kind).strip() in first, "the parent draws what it would have drawn without children"


@pytest.mark.parametrize("kind", KINDS)
def test_a_fork_while_threads_draw_hangs_nobody(kind: str) -> None:
    assert run(BUSY, kind) == "done\n"
