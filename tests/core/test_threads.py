"""Writers and readers at the same time: nothing tears, nothing is lost, nothing waits for ever."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import numpy as np

import vhs

# Large enough that a copy takes long enough to be interrupted.
SHAPE = (64, 64, 3)


def uniform_images(images: np.ndarray) -> bool:
    """Whether each image has one value throughout, as every image of these tests has."""
    flat = images.reshape(len(images), -1)
    return bool((flat == flat[:, :1]).all())


def small_buffer() -> vhs.EpisodeBuffer:
    """Room for six long episodes, fed by two streams."""
    return vhs.EpisodeBuffer(
        SHAPE, num_streams=2, max_episode_steps=4, capacity_steps=24, num_goals=256, num_interactions=1
    )


def test_readers_of_a_goal_store_never_see_half_an_image() -> None:
    store, done = vhs.GoalStore(3, SHAPE, 4), Event()
    for label in range(3):
        store.push(np.zeros(SHAPE, np.uint8), label)

    def write() -> None:
        for value in range(2000):
            store.push(np.full(SHAPE, value % 256, np.uint8), value % 3)
        done.set()

    def read() -> int:
        batches = 0
        while not done.is_set() or batches == 0:
            assert uniform_images(store.sample(8)[0])
            batches += 1
        return batches

    with ThreadPoolExecutor(3) as pool:
        readers = [pool.submit(read) for _ in range(2)]
        pool.submit(write).result(timeout=60)
        assert all(reader.result(timeout=60) > 0 for reader in readers)
    assert store.counts.tolist() == [4, 4, 4]


def test_readers_of_episodes_see_whole_ones_while_others_are_evicted() -> None:
    buffer, done = small_buffer(), Event()

    def write(stream: int) -> int:
        """Plays until the reader has seen enough, and at least long enough to evict."""
        episodes = 0
        while not done.is_set() or episodes < 100:
            goal = (2 * episodes + stream) % 256
            frame = np.full(SHAPE, goal, np.uint8)
            buffer.begin(stream, frame, goal, 0)
            for _ in range(1 + episodes % 4):
                buffer.append(stream, 0, 0.0, 0.0, frame)
            buffer.finish(stream, "success")
            episodes += 1
        return episodes

    def read() -> None:
        batches = 0
        while batches < 300:
            try:
                batch = buffer.sample_episodes(3)
            except vhs.EmptyError:  # the writers have not come to their first episode yet
                continue
            rows = np.repeat(batch.goals, batch.lengths + 1)
            assert uniform_images(batch.observations)
            assert (batch.observations[:, 0, 0, 0, 0] == rows).all()
            batches += 1

    with ThreadPoolExecutor(3) as pool:
        writers = [pool.submit(write, stream) for stream in range(2)]
        try:
            pool.submit(read).result(timeout=60)
        finally:
            done.set()
        written = sum(writer.result(timeout=60) for writer in writers)
    assert buffer.ids[-1] == written - 1
    assert len(buffer) < written


def check_steps(buffer: vhs.EpisodeBuffer) -> None:
    batch = buffer.sample_transitions(8, "future", ratio=4)
    new = batch.relabelled
    assert uniform_images(batch.observations)
    assert uniform_images(batch.next_observations)
    assert uniform_images(batch.goals[new])
    np.testing.assert_array_equal(batch.observations[:, 0, 0, 0, 0], batch.labels)
    np.testing.assert_array_equal(batch.goals[new, 0, 0, 0, 0], batch.labels[new])
    np.testing.assert_array_equal(batch.rewards[~new], batch.ids[~new])


def check_windows(buffer: vhs.EpisodeBuffer) -> None:
    batch = buffer.sample_windows(4, 2, 2)
    for row, used in enumerate(batch.lengths + 1):
        assert (batch.observations[row, :used] == batch.labels[row]).all()


def check_episodes(buffer: vhs.EpisodeBuffer) -> None:
    batch = buffer.sample_episodes(3, padded=True)
    for row, used in enumerate(batch.lengths + 1):
        assert (batch.observations[row, :used] == batch.goals[row]).all()
        assert (batch.rewards[row, : used - 1] == batch.ids[row]).all()


def write_until(buffer: vhs.EpisodeBuffer, done: Event) -> int:
    """Episodes whose frames, labels and rewards all say the episode's number."""
    episodes = 0
    while not done.is_set() or episodes < 200:
        frame = np.full(SHAPE, episodes % 256, np.uint8)
        buffer.begin(0, frame, episodes % 256, 0)
        for _ in range(1 + episodes % 4):
            buffer.append(0, 0, float(episodes), 0.0, frame)
        assert buffer.finish(0, "failure") == episodes
        episodes += 1
    return episodes


def read_often(buffer: vhs.EpisodeBuffer, check: Callable[[vhs.EpisodeBuffer], None]) -> None:
    drawn = 0
    while drawn < 150:
        try:
            check(buffer)
        except vhs.EmptyError:  # the writer has not come to its first episode yet
            continue
        drawn += 1


def test_one_writer_and_four_readers_of_every_kind_never_meet_a_torn_episode() -> None:
    buffer, done = small_buffer(), Event()
    checks = (check_steps, check_steps, check_windows, check_episodes)
    with ThreadPoolExecutor(5) as pool:
        writer = pool.submit(write_until, buffer, done)
        try:
            for reader in [pool.submit(read_often, buffer, check) for check in checks]:
                reader.result(timeout=60)
        finally:
            done.set()
        assert writer.result(timeout=60) > len(buffer)


def test_collecting_and_writing_do_not_wait_for_each_other() -> None:
    buffer = vhs.EpisodeBuffer(
        SHAPE, num_streams=1, max_episode_steps=2, capacity_steps=50, num_goals=3, num_interactions=1
    )
    store, frame = vhs.GoalStore(3, (2, *SHAPE), 10), np.ones(SHAPE, np.uint8)

    def play() -> None:
        for episode in range(300):
            buffer.begin(0, frame, episode % 3, 0)
            buffer.append(0, 0, 0.0, 0.0, frame)
            store.collect(buffer, [buffer.finish(0, "success")])

    def draw() -> None:
        for _ in range(300):
            if len(store):
                store.sample(4)
            len(buffer)

    with ThreadPoolExecutor(2) as pool:
        for task in [pool.submit(play), pool.submit(draw)]:
            task.result(timeout=60)
    assert store.counts.tolist() == [10, 10, 10]


def test_an_array_that_another_thread_changes_is_appended_whole_or_refused() -> None:
    shape, n, most, done = (512, 512), 8, 1000, Event()
    buffer = vhs.EpisodeBuffer(shape, num_streams=n, max_episode_steps=most, capacity_steps=n * most)
    frames, zeros = np.zeros((n, *shape), np.uint8), np.zeros(n, np.float32)
    streams, actions = np.arange(n), np.zeros(n, np.int64)
    for stream in range(n):
        buffer.begin(stream, frames[0])

    def disturb() -> None:
        while not done.is_set():
            for stream in (1 << 40, n - 1):
                streams[-1] = stream
                time.sleep(0.0003)

    appended = refused = 0
    with ThreadPoolExecutor(1) as pool:
        disturber = pool.submit(disturb)
        try:
            for _ in range(most):
                if min(appended, refused) >= 20:
                    break
                try:
                    # The copy of two megabytes leaves the other thread time.
                    buffer.append_batch(streams, actions, zeros, zeros, frames)
                    appended += 1
                except vhs.LabelError:
                    refused += 1
        finally:
            done.set()
        disturber.result(timeout=60)
    assert buffer.num_steps == n * appended
