"""Speed of the storage calls beside numpy copying the same bytes, in the same process.

Each case checks its result before it is timed. A ratio is memcpy time / our time: 1.0 is the speed of memory.
The copy reads from, or writes to, an array as large as the structure it stands beside, a stretch further each
time, so that neither side profits from a cache that the other cannot use. "fresh" cases let the call allocate
its result.

Transitions are drawn from 10,000 steps in 20-step episodes of 84 x 84 frames, two stacked, the goal an image,
strategy "future", 4 to 1; beside the same draws by numpy `take(out=)` from arrays that store every image of
every step, and by other libraries where they are installed (`rivals.py`). `--sizes` draws from growing
buffers: of images up to 10^5 steps, which fit memory, and of frames of 64 bytes up to 10^6.
`--neighbour` repeats the table's first rows while another process copies memory without end.

    python benchmarks/bench_buffers.py                    # a table
    python benchmarks/bench_buffers.py --rivals           # with the other libraries: needs 8 GB
    python benchmarks/bench_buffers.py --sizes --neighbour
    python benchmarks/bench_buffers.py --json out.json    # and the numbers as JSON
    python benchmarks/bench_buffers.py --quick            # a smoke test: few repeats
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import rivals
import vhs

FRAME = (84, 84, 3)
OBSERVATION = (2, *FRAME)
STREAMS, STEPS, CLASSES = 16, 20, 5
RNG = np.random.default_rng(0)


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


def filled_buffer(frames: NDArray[np.uint8], stacking: str = "frames") -> vhs.EpisodeBuffer:
    """A buffer that wraps: 5,000 steps in episodes of 20, on 16 streams at once."""
    buffer = vhs.EpisodeBuffer(
        FRAME,
        num_streams=STREAMS,
        max_episode_steps=STEPS,
        capacity_steps=5000,
        stacking=stacking,
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


def channel_cases() -> list[Case]:
    """As for episodes, frames stacked as the channels of one picture."""
    frames = random_images(STEPS + 1, STREAMS, *FRAME)
    buffer = filled_buffer(frames, "channels")
    ids = play_episodes(buffer, frames)
    out = np.ones((STREAMS * (STEPS + 1), *buffer.observation_shape), np.uint8)
    batch = buffer.gather(ids, out=out)
    rows = batch.observations[: STEPS + 1].reshape(STEPS + 1, *FRAME[:2], 2, FRAME[2])
    np.testing.assert_array_equal(rows[..., 1, :], frames[:, 0])
    np.testing.assert_array_equal(rows[1:, ..., 0, :], frames[:-1, 0])
    for stream in range(STREAMS):
        buffer.begin(stream, frames[0, stream])
    seen = np.ones((STREAMS, *buffer.observation_shape), np.uint8)
    stored = random_images(5200, *FRAME).reshape(-1, *buffer.observation_shape)
    read, acted = copy_from(stored, out), copy_from(stored[:16], seen)
    newest = buffer.ids[-16:]
    return [
        Case("observe 16, channels, out", lambda: buffer.observe(out=seen), acted, seen.nbytes / 1e6),
        Case("gather 16 x 20, channels, out", lambda: buffer.gather(newest, out=out), read, out.nbytes / 1e6),
    ]


def transition_buffer(steps: int, frame: tuple[int, ...] = FRAME, **more: object) -> vhs.EpisodeBuffer:
    """So many steps in episodes of 20, frames with content."""
    buffer = vhs.EpisodeBuffer(
        frame, num_streams=1, max_episode_steps=STEPS, capacity_steps=steps, seed=1, **more
    )
    frames = random_images(997, *frame)
    numbers = itertools.cycle(range(len(frames)))
    for _ in range(steps // STEPS):
        buffer.begin(0, frames[next(numbers)])
        for _ in range(STEPS):
            buffer.append(0, 0, -1.0, 0.0, frames[next(numbers)])
        buffer.finish(0, "timeout")
    return buffer


def check_transitions(batch: vhs.TransitionBatch) -> None:
    """Images of a step overlap by a frame, and the goal of a step that reached it is what it saw."""
    np.testing.assert_array_equal(batch.observations[:, 1], batch.next_observations[:, 0])
    reached = batch.relabelled & (batch.goal_steps == batch.steps + 1)
    np.testing.assert_array_equal(batch.goals[reached], batch.next_observations[reached])
    assert (batch.rewards[reached] == 0).all()


def transition_cases() -> list[Case]:
    """Batches of single steps, and whole episodes, from 10,000 steps."""
    buffer = transition_buffer(10_000)
    cases = []
    for n in (64, 256):
        batch = buffer.sample_transitions(n, "future", ratio=4)
        check_transitions(batch)
        names = ("observations", "next_observations", "goals")
        out = {name: np.ones((n, *OBSERVATION), np.uint8) for name in names}
        stored = np.tile(random_images(997, *OBSERVATION), (10, 1, 1, 1, 1))
        together = np.ones((3 * n, *OBSERVATION), np.uint8)
        megabytes = together.nbytes / 1e6

        def take(
            n: int = n, stored: NDArray[np.uint8] = stored, out: dict[str, NDArray[np.uint8]] = out
        ) -> None:
            for array in out.values():
                np.take(stored, RNG.integers(0, len(stored), n), axis=0, out=array, mode="clip")

        def into(n: int = n, out: dict[str, NDArray[np.uint8]] = out) -> object:
            return buffer.sample_transitions(n, "future", ratio=4, out=out)

        def recycled(n: int = n) -> object:
            return buffer.sample_transitions(n, "future", ratio=4)

        read = copy_from(stored, together)
        cases += [
            Case(f"sample_transitions {n}, recycled", recycled, read, megabytes),
            Case(f"sample_transitions {n}, out", into, read, megabytes),
            Case(f"numpy take(out=) {n}", take, read, megabytes),
        ]
    episodes = buffer.sample_episodes(16)
    np.testing.assert_array_equal(episodes.observations[1:, 0][:20], episodes.observations[:-1, 1][:20])
    out = np.ones((16 * 21, *OBSERVATION), np.uint8)
    read, megabytes = copy_from(stored, out), out.nbytes / 1e6
    return [
        *cases,
        Case("sample_episodes 16 x 20 + mask, recycled", lambda: buffer.sample_episodes(16), read, megabytes),
        Case(
            "sample_episodes 16 x 20, padded",
            lambda: buffer.sample_episodes(16, padded=True),
            read,
            megabytes,
        ),
        # Full windows, as many bytes as the copy beside them.
        Case(
            "sample_windows 16 x (15 + 5)",
            lambda: buffer.sample_windows(16, 15, 5, strict=True),
            read,
            megabytes,
        ),
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
    many, classes = np.tile(features, (5, 1)), np.tile(labels, 5)
    copied = many.copy()
    wide, narrow, padded = features.copy(), features[:16].copy(), rewards.copy()

    def update() -> None:
        prototypes.update(features, labels)

    def embed() -> NDArray[np.float32]:
        return prototypes.embed(labels[:16])

    def returns() -> NDArray[np.float32]:
        return vhs.discounted_returns(rewards, lengths, 0.99)

    return [
        Case("Prototypes.update 64 x 256", update, lambda: np.copyto(wide, features), wide.nbytes / 1e6, 100),
        Case(
            "Prototypes.update 5 x 64 x 256",
            lambda: prototypes.update(many, classes),
            lambda: np.copyto(copied, many),
            many.nbytes / 1e6,
            100,
        ),
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


def size_cases() -> list[Case]:
    """Draws from buffers of growing size, beside numpy taking as many images from an array of that size.

    The ratio is what stays flat: both miss the caches more as the size grows. Frames of 64 bytes, whose
    copies cost nothing, show the way to a step alone.
    """
    cases = []
    for frame, sizes in [(FRAME, (10_000, 100_000)), ((64,), (10_000, 100_000, 1_000_000))]:
        for steps in sizes:
            buffer = transition_buffer(steps, frame)
            check_transitions(buffer.sample_transitions(64, "future", ratio=4))
            stored = np.ones((steps * 21 // 40, 2, *frame), np.uint8)
            out = np.ones((3 * 64, 2, *frame), np.uint8)

            def draw(buffer: vhs.EpisodeBuffer = buffer) -> object:
                return buffer.sample_transitions(64, "future", ratio=4)

            def take(stored: NDArray[np.uint8] = stored, out: NDArray[np.uint8] = out) -> object:
                return np.take(stored, RNG.integers(0, len(stored), len(out)), axis=0, out=out, mode="clip")

            name = f"64 of 10^{len(str(steps)) - 1} steps, {np.prod(frame)} bytes a frame"
            cases.append(Case(name, draw, take, out.nbytes / 1e6, 4))
    return cases


def rival_cases() -> list[Case]:
    """64 transitions by other libraries, beside a copy of the same bytes."""
    images = random_images(997, *rivals.IMAGE)
    stored = np.tile(images.reshape(-1, *OBSERVATION), (10, 1, 1, 1, 1))
    together = np.ones((3 * 64, *OBSERVATION), np.uint8)
    cases = []
    for name, make in rivals.RIVALS.items():
        draw = make(10_000, STEPS, images)
        if draw is None:
            print(f"{name} is not installed: left out")
            continue
        call = lambda draw=draw: draw(64)  # noqa: E731 - binds the draw of this library
        read = copy_from(stored, together)
        cases.append(Case(f"{name}, 64 transitions", call, read, together.nbytes / 1e6, 1))
    return cases


def disk_table() -> None:
    """A buffer of 400 MB: bytes a step, and the times of saving, loading, mapping."""
    buffer = transition_buffer(19_000)
    print(f"\nbytes a transition: {buffer.nbytes / buffer.num_steps:.0f}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "buffer"
        for name, call in [
            ("save", lambda: buffer.save(path)),
            ("load", lambda: vhs.EpisodeBuffer.load(path)),
            ("load, mmap", lambda: vhs.EpisodeBuffer.load(path, mmap=True)),
            ("verify", lambda: vhs.EpisodeBuffer.verify(path)),
        ]:
            times = [seconds(call, 1) for _ in range(5)]
            print(
                f"{name:12} {statistics.median(times) * 1e3:8.1f} ms for {path.stat().st_size / 1e6:.0f} MB"
            )


NEIGHBOUR = "import numpy as np\na = np.ones(2**26, np.uint8)\nb = a.copy()\nwhile True: np.copyto(a, b)"


def neighbour_table(cases: list[Case], quiet: list[Result], repeats: int) -> None:
    """The cases again while another process copies memory: how much slower each is."""
    other = subprocess.Popen([sys.executable, "-c", NEIGHBOUR])
    try:
        time.sleep(1)
        busy = [measure(case, repeats) for case in cases]
    finally:
        other.kill()
        other.wait()
    print(f"\n{'beside a busy neighbour':44} {'us':>10} {'loss':>6} {'memcpy':>6}")
    for before, after in zip(quiet, busy, strict=True):
        loss = after.microseconds / before.microseconds
        copy = after.memcpy_microseconds / before.memcpy_microseconds
        print(f"{after.name:44} {after.microseconds:10.1f} {loss:6.2f} {copy:6.2f}")


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
    parser.add_argument("--rivals", action="store_true", help="compare with other libraries")
    parser.add_argument("--sizes", action="store_true", help="draw from 10^4, 10^5 and 10^6 steps")
    parser.add_argument("--neighbour", action="store_true", help="repeat beside a busy process")
    parser.add_argument("--quick", action="store_true", help="few repeats: shows that it runs, not how fast")
    arguments = parser.parse_args()
    repeats = 3 if arguments.quick else 60
    print(f"load average {os.getloadavg()[0]:.1f} of {os.cpu_count()} cores; commit {commit()}")
    cases = [*transition_cases(), *goal_cases(), *episode_cases(), *channel_cases(), *small_cases()]
    if arguments.sizes:
        cases += size_cases()
    if arguments.rivals:
        cases += rival_cases()
    results = [measure(case, repeats) for case in cases]
    print(f"{'case':44} {'us':>10} {'memcpy us':>10} {'ratio':>6}")
    for result in results:
        times = f"{result.microseconds:10.1f} {result.memcpy_microseconds:10.1f}"
        print(f"{result.name:44} {times} {result.ratio:6.2f}")
    if not arguments.quick:
        disk_table()
    if arguments.neighbour:
        neighbour_table(cases[:9], results[:9], repeats)
    if arguments.json:
        machine = {
            "processor": platform.processor() or platform.machine(),
            "python": platform.python_version(),
        }
        report = {"commit": commit(), **machine, "results": [asdict(result) for result in results]}
        arguments.json.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
