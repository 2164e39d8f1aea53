"""Writers and readers at the same time: nothing tears, nothing is lost, nothing waits for ever."""

from __future__ import annotations

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
