"""Speed of the storage calls beside numpy copying the same bytes, in the same process.

Each case checks its result before it is timed. A ratio is memcpy time / our time: 1.0 is the speed of memory.
The copy reads from, or writes to, an array as large as the structure it stands beside, a stretch further each
time, so that neither side profits from a cache that the other cannot use. "fresh" cases let the call allocate
its result.

    python benchmarks/bench_core.py                    # a table
    python benchmarks/bench_core.py --json out.json    # and the numbers as JSON
    python benchmarks/bench_core.py --quick            # a smoke test: few repeats
"""

from __future__ import annotations

import argparse
import itertools
import json
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import vhs

FRAME = (84, 84, 3)
OBSERVATION = (2, *FRAME)
STREAMS, STEPS, CLASSES = 16, 20, 5


@dataclass(frozen=True)
class Case:
    """What is timed, and how many bytes of images it moves."""

    name: str
    call: Callable[[], object]
    # numpy moving the same bytes.
    copy: Callable[[], object]
    megabytes: float
    # Calls in one repeat: small cases need many to be timed well.
    calls: int = 4


@dataclass(frozen=True)
class Result:
    """Times are of one call, in microseconds; medians over the repeats."""

    name: str
    microseconds: float
    memcpy_microseconds: float
    ratio: float
    megabytes: float


def random_images(*shape: int) -> NDArray[np.uint8]:
    """Images with content: pages of zeros may be one page."""
    return np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)


def copy_from(large: NDArray[np.uint8], small: NDArray[np.uint8]) -> Callable[[], None]:
    """Copies of the next rows of a large array into a small one."""
    starts = itertools.cycle(range(0, len(large) - len(small) + 1, len(small)))

    def copy() -> None:
        start = next(starts)
        np.copyto(small, large[start : start + len(small)])

    return copy


def copy_into(large: NDArray[np.uint8], small: NDArray[np.uint8]) -> Callable[[], None]:
    """Copies of a small array over the next rows of a large one."""
    starts = itertools.cycle(range(0, len(large) - len(small) + 1, len(small)))

    def copy() -> None:
        start = next(starts)
        np.copyto(large[start : start + len(small)], small)

    return copy


def goal_cases() -> list[Case]:
    """Balanced batches of 64 from 5 x 2,000 images, and pushes into full rings."""
    store = vhs.GoalStore(CLASSES, OBSERVATION, 2000)
    images = random_images(64, *OBSERVATION)
    for index in range(CLASSES * 2000):
        store.push(images[index % 64], index % CLASSES)
    known = {image.tobytes() for image in images}
    sampled, labels = store.sample(64)
    assert all(image.tobytes() in known for image in sampled)
    assert sorted(np.bincount(labels, minlength=CLASSES)) == [12, 13, 13, 13, 13]

    out = np.ones((64, *OBSERVATION), np.uint8)
    stored = np.tile(images, (CLASSES * 2000 // 64, 1, 1, 1, 1))
    read, write = copy_from(stored, out), copy_into(stored, images)
    size = out.nbytes / 1e6

    def push() -> None:
        for index in range(64):
            store.push(images[index], index % CLASSES)

    return [
        Case("GoalStore.push, 64 images", push, write, size),
        Case("GoalStore.sample 64 balanced, out", lambda: store.sample(64, out=out), read, size),
        Case("GoalStore.sample 64 balanced, fresh", lambda: store.sample(64), read, size),
        Case("GoalStore.sample_class 64, out", lambda: store.sample_class(1, 64, out=out), read, size),
    ]


def filled_buffer(frames: NDArray[np.uint8]) -> vhs.EpisodeBuffer:
    """A buffer that wraps: 5,000 steps in episodes of 20, on 16 streams at once."""
    buffer = vhs.EpisodeBuffer(
        FRAME,
        num_streams=STREAMS,
        max_episode_steps=STEPS,
        capacity_steps=5000,
        num_goals=CLASSES,
        num_interactions=1,
    )
    for _ in range(20):
        play_episodes(buffer, frames)
    return buffer


def play_episodes(buffer: vhs.EpisodeBuffer, frames: NDArray[np.uint8]) -> list[int]:
    """One episode on every stream."""
    streams, zeros = np.arange(STREAMS), np.zeros(STREAMS, np.float32)
    actions = np.zeros(STREAMS, np.int64)
    for stream in range(STREAMS):
        buffer.begin(stream, frames[0, stream], 0, 0)
    for step in range(STEPS):
        buffer.append_batch(streams, actions, zeros, zeros, frames[step + 1])
    return [buffer.finish(stream, "failure") for stream in range(STREAMS)]


def episode_cases() -> list[Case]:
    """Steps in, batches of 16 whole episodes out."""
    frames = random_images(STEPS + 1, STREAMS, *FRAME)
    buffer = filled_buffer(frames)
    ids = play_episodes(buffer, frames)
    out = np.ones((STREAMS * (STEPS + 1), *OBSERVATION), np.uint8)
    batch = buffer.gather(ids, out=out)
    for place in range(STREAMS):
        rows = batch.observations[batch.offsets[place] : batch.offsets[place] + STEPS + 1]
        np.testing.assert_array_equal(rows[:, 1], frames[:, place])
        np.testing.assert_array_equal(rows[1:, 0], frames[:-1, place])
        np.testing.assert_array_equal(rows[0, 0], frames[0, place])

    seen = np.ones((STREAMS, *OBSERVATION), np.uint8)
    acting = vhs.EpisodeBuffer(
        FRAME,
        num_streams=STREAMS,
        max_episode_steps=1,
        capacity_steps=STREAMS,
        num_goals=1,
        num_interactions=1,
    )
    for stream in range(STREAMS):
        acting.begin(stream, frames[0, stream], 0, 0)

    one = vhs.EpisodeBuffer(
        FRAME, num_streams=1, max_episode_steps=STEPS, capacity_steps=5000, num_goals=1, num_interactions=1
    )

    def one_episode() -> None:
        one.begin(0, frames[0, 0], 0, 0)
        for step in range(STEPS):
            one.append(0, 0, 0.0, 0.0, frames[step + 1, 0])
        one.finish(0, "failure")

    for _ in range(300):
        one_episode()
    episode = (STEPS + 1) * frames[0, 0].nbytes / 1e6
    stored = random_images(5000 + 250, *FRAME)
    # Every frame is read once and written twice, once in each of the two observations that show it.
    pairs = stored[:5200].reshape(-1, *OBSERVATION)
    every = frames.reshape(-1, *FRAME)
    write_one, write_all = copy_into(stored, frames[:, 0].copy()), copy_into(stored, every)
    read, acted = copy_from(pairs, out), copy_from(every[:32].reshape(-1, *OBSERVATION), seen)

    def gather(into: NDArray[np.uint8] | None = None) -> vhs.EpisodeBatch:
        return buffer.gather(buffer.ids[-16:], out=into)

    def play() -> list[int]:
        return play_episodes(buffer, frames)

    batch_size = out.nbytes / 1e6
    return [
        Case("EpisodeBuffer, one episode by append", one_episode, write_one, episode),
        Case("EpisodeBuffer, 16 episodes by append_batch", play, write_all, 16 * episode),
        Case("EpisodeBuffer.observe 16, out", lambda: acting.observe(out=seen), acted, seen.nbytes / 1e6),
        Case("EpisodeBuffer.gather 16 x 20, out", lambda: gather(out), read, batch_size),
        Case("EpisodeBuffer.gather 16 x 20, fresh", gather, read, batch_size),
    ]


def small_cases() -> list[Case]:
    """Calls on a few kilobytes, where the way in and out of Python is what counts."""
    rng = np.random.default_rng(0)
    prototypes = vhs.Prototypes(CLASSES, 256)
    features = rng.normal(size=(64, 256)).astype(np.float32)
    labels = np.arange(64) % CLASSES
    prototypes.update(features, labels)
    means = np.stack([features[labels == label].mean(0) for label in range(CLASSES)])
    np.testing.assert_allclose(prototypes.table, means, atol=1e-6)
    rewards, lengths = rng.normal(size=(16, 20)).astype(np.float32), np.full(16, 20)
    wide, narrow, padded = features.copy(), features[:16].copy(), rewards.copy()

    def update() -> None:
        prototypes.update(features, labels)

    def embed() -> NDArray[np.float32]:
        return prototypes.embed(labels[:16])

    def returns() -> NDArray[np.float32]:
        return vhs.discounted_returns(rewards, lengths, 0.99)

    return [
        Case("Prototypes.update 64 x 256", update, lambda: np.copyto(wide, features), wide.nbytes / 1e6, 100),
        Case("Prototypes.embed 16", embed, lambda: np.copyto(narrow, wide[:16]), narrow.nbytes / 1e6, 100),
        Case(
            "discounted_returns 16 x 20",
            returns,
            lambda: np.copyto(padded, rewards),
            padded.nbytes / 1e6,
            100,
        ),
    ]


def seconds(call: Callable[[], object], calls: int) -> float:
    """Seconds of one call, over so many."""
    start = time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - start) / calls


def measure(case: Case, repeats: int) -> Result:
    """Times the case and a copy of as many bytes in turns, so that both meet the same machine."""
    ours, memcpy = [], []
    for _ in range(repeats):
        ours.append(seconds(case.call, case.calls))
        memcpy.append(seconds(case.copy, case.calls))
    best, copy = statistics.median(ours) * 1e6, statistics.median(memcpy) * 1e6
    return Result(case.name, best, copy, copy / best, case.megabytes)


def commit() -> str:
    """The commit that was measured."""
    here = Path(__file__).parent
    done = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=here, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() or "unknown"


def main() -> None:
    """Run all cases, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("--quick", action="store_true", help="few repeats: shows that it runs, not how fast")
    arguments = parser.parse_args()
    cases = [*goal_cases(), *episode_cases(), *small_cases()]
    results = [measure(case, 3 if arguments.quick else 60) for case in cases]
    print(f"{'case':44} {'us':>10} {'memcpy us':>10} {'ratio':>6}")
    for result in results:
        times = f"{result.microseconds:10.1f} {result.memcpy_microseconds:10.1f}"
        print(f"{result.name:44} {times} {result.ratio:6.2f}")
    if arguments.json:
        machine = {
            "processor": platform.processor() or platform.machine(),
            "python": platform.python_version(),
        }
        report = {"commit": commit(), **machine, "results": [asdict(result) for result in results]}
        arguments.json.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
