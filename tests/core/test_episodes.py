"""The episode buffer against lists of episodes that own their frames, driven by random calls."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

import vhs

from .naive import FRAME_SHAPE, INTERACTIONS, STACK, Buffer, Episode, FrameSource

STREAMS, MAX_STEPS, CAPACITY = 3, 4, 14
streams = st.integers(0, STREAMS - 1)
numbers = st.floats(-10, 10, width=32)


def make_buffer(**changes: int) -> vhs.EpisodeBuffer:
    settings = {
        "num_streams": STREAMS,
        "max_episode_steps": MAX_STEPS,
        "capacity_steps": CAPACITY,
        "frame_stack": STACK,
        "num_goals": 5,
        "num_interactions": 3,
        "num_actions": 6,
        "interactions": INTERACTIONS,
        "seed": 1,
    }
    return vhs.EpisodeBuffer(FRAME_SHAPE, **(settings | changes))


def check_batch(batch: vhs.EpisodeBatch, episodes: list[Episode], ids: list[int]) -> None:
    """Every array of a batch, episode by episode."""
    longest = max(len(episode) for episode in episodes)
    assert batch.actions.shape == batch.mask.shape == (len(episodes), longest)
    row = 0
    for place, episode in enumerate(episodes):
        length = len(episode)
        assert (batch.offsets[place], batch.lengths[place]) == (row, length)
        np.testing.assert_array_equal(batch.observations[row : row + length + 1], episode.observations())
        for found, expected in [
            (batch.actions, episode.actions),
            (batch.rewards, episode.rewards),
            (batch.values, episode.values),
            (batch.mask, [True] * length),
        ]:
            padded = np.zeros(longest, found.dtype)
            padded[:length] = expected
            np.testing.assert_array_equal(found[place], padded)
        assert (batch.goals[place], batch.interactions[place]) == (episode.goal, episode.interaction)
        assert batch.outcomes[place] == episode.outcome
        row += length + 1
    assert batch.observations.shape == (row, STACK, *FRAME_SHAPE)
    assert batch.ids.tolist() == ids
    assert len(batch) == len(ids)


class BufferMachine(RuleBasedStateMachine):
    """Allowed calls change both alike; forbidden ones raise and change neither."""

    def __init__(self) -> None:
        super().__init__()
        self.buffer = make_buffer()
        self.naive = Buffer(STREAMS, MAX_STEPS, CAPACITY)
        self.frames = FrameSource()

    @rule(stream=streams, goal=st.integers(0, 4), interaction=st.integers(0, 2))
    def begin(self, stream: int, goal: int, interaction: int) -> None:
        frame = self.frames.next()
        if self.naive.open[stream] is not None:
            with pytest.raises(vhs.ProtocolError):
                self.buffer.begin(stream, frame, goal, interaction)
            return
        self.buffer.begin(stream, frame, goal, interaction)
        self.naive.open[stream] = Episode(goal, interaction, [frame])

    @rule(stream=streams, action=st.integers(0, 5), reward=numbers, value=numbers)
    def append(self, stream: int, action: int, reward: float, value: float) -> None:
        frame, episode = self.frames.next(), self.naive.open[stream]
        if episode is None or len(episode) == MAX_STEPS:
            with pytest.raises(vhs.ProtocolError):
                self.buffer.append(stream, action, reward, value, frame)
            return
        self.buffer.append(stream, action, reward, value, frame)
        self.naive.evict_for(1)
        self.naive.append(stream, action, reward, value, frame)

    @rule(rows=st.lists(st.tuples(streams, st.integers(0, 5), numbers, numbers), min_size=0, max_size=4))
    def append_batch(self, rows: list[tuple[int, int, float, float]]) -> None:
        frames = [self.frames.next() for _ in rows]
        chosen = [row[0] for row in rows]
        columns = [np.array([row[i] for row in rows]) for i in range(4)]
        stacked = np.stack(frames) if rows else np.zeros((0, *FRAME_SHAPE), np.uint8)
        open_episodes = [self.naive.open[stream] for stream in chosen]
        fits = all(episode is not None and len(episode) < MAX_STEPS for episode in open_episodes)
        if not fits or len(set(chosen)) < len(chosen):
            with pytest.raises((vhs.ProtocolError, vhs.ArgumentError)):
                self.buffer.append_batch(*columns, stacked)
            return
        self.buffer.append_batch(*columns, stacked)
        self.naive.evict_for(len(rows))
        for row, frame in zip(rows, frames, strict=True):
            self.naive.append(*row, frame)

    @rule(stream=streams, outcome=st.sampled_from(vhs.Outcome), by_name=st.booleans())
    def finish(self, stream: int, outcome: vhs.Outcome, by_name: bool) -> None:
        argument = outcome.name.lower() if by_name else outcome
        if not self.naive.open[stream]:  # None, or without a step
            with pytest.raises(vhs.ProtocolError):
                self.buffer.finish(stream, argument)
            return
        assert self.buffer.finish(stream, argument) == self.naive.finish(stream, outcome)

    @rule(stream=streams)
    def abort(self, stream: int) -> None:
        if self.naive.open[stream] is None:
            with pytest.raises(vhs.ProtocolError):
                self.buffer.abort(stream)
            return
        self.buffer.abort(stream)
        self.naive.open[stream] = None

    @precondition(lambda self: self.naive.finished)
    @rule(data=st.data())
    def gather(self, data: st.DataObject) -> None:
        stored = sorted(self.naive.finished)
        ids = data.draw(st.lists(st.sampled_from(stored), min_size=1, max_size=6))
        episodes = [self.naive.finished[i] for i in ids]
        check_batch(self.buffer.gather(ids), episodes, ids)

    @rule()
    def gather_evicted_or_unknown(self) -> None:
        gone = [i for i in range(self.naive.next_id) if i not in self.naive.finished]
        for missing in [*gone, self.naive.next_id, -1]:
            with pytest.raises(vhs.EpisodeError):
                self.buffer.gather([missing])

    @precondition(lambda self: self.naive.finished)
    @rule(n=st.integers(1, 8))
    def sample(self, n: int) -> None:
        batch = self.buffer.sample_episodes(n)
        episodes = [self.naive.finished[i] for i in batch.ids.tolist()]
        assert batch.hindsight is None
        check_batch(batch, episodes, batch.ids.tolist())

    @invariant()
    def sizes_agree(self) -> None:
        assert self.buffer.ids.tolist() == sorted(self.naive.finished)
        assert len(self.buffer) == len(self.naive.finished)
        assert self.buffer.num_steps == self.naive.num_steps() <= CAPACITY
        assert self.buffer.open.tolist() == [episode is not None for episode in self.naive.open]

    @invariant()
    def the_newest_observations_agree(self) -> None:
        acting = [stream for stream in range(STREAMS) if self.naive.open[stream] is not None]
        newest = [self.naive.open[stream].observations()[-1] for stream in acting]
        expected = np.stack(newest) if acting else np.zeros((0, STACK, *FRAME_SHAPE), np.uint8)
        np.testing.assert_array_equal(self.buffer.observe(acting), expected)
        if len(acting) == STREAMS:
            np.testing.assert_array_equal(self.buffer.observe(), expected)


TestBuffer = BufferMachine.TestCase
TestBuffer.settings = settings(stateful_step_count=60)


def add_episode(buffer: vhs.EpisodeBuffer, frames: FrameSource, length: int = 2, **said: int) -> int:
    stream = said.get("stream", 0)
    buffer.begin(stream, frames.next(), said.get("goal", 0), said.get("interaction", 0))
    for _ in range(length):
        buffer.append(stream, said.get("action", 0), 0.5, 0.25, frames.next())
    return buffer.finish(stream, said.get("outcome", vhs.Outcome.FAILURE))


def test_same_seed_same_batches_also_after_restoring_the_generator() -> None:
    buffers = [make_buffer(capacity_steps=60, seed=5) for _ in range(2)]
    for buffer in buffers:
        frames = FrameSource()
        for goal in range(5):
            add_episode(buffer, frames, goal=goal)
    first, second = (buffer.sample_episodes(20, relabel="final", probability=0.5) for buffer in buffers)
    np.testing.assert_array_equal(first.ids, second.ids)
    np.testing.assert_array_equal(first.hindsight.selected, second.hindsight.selected)
    state = buffers[0].rng_state
    ahead = buffers[0].sample_episodes(20).ids
    other = make_buffer(capacity_steps=60, seed=99)
    frames = FrameSource()
    for goal in range(5):
        add_episode(other, frames, goal=goal)
    other.rng_state = state
    np.testing.assert_array_equal(other.sample_episodes(20).ids, ahead)


def test_a_frame_is_stored_once_although_observations_stack_two() -> None:
    shape = (84, 84, 3)
    buffer = vhs.EpisodeBuffer(
        shape, num_streams=1, max_episode_steps=20, capacity_steps=1000, num_goals=5, num_interactions=1
    )
    frame = np.zeros(shape, np.uint8)
    for _ in range(50):
        buffer.begin(0, frame, 0, 0)
        for _ in range(20):
            buffer.append(0, 0, 0.0, 0.0, frame)
        buffer.finish(0, "timeout")
    assert buffer.num_steps == 1000
    # 21 frames for 20 steps, and less than one unfilled huge page.
    assert buffer.nbytes <= 1050 * frame.nbytes + 2**21


def test_properties_say_what_the_buffer_was_built_from() -> None:
    buffer = make_buffer()
    assert buffer.frame_shape == FRAME_SHAPE
    assert buffer.observation_shape == (STACK, *FRAME_SHAPE)
    assert (buffer.num_streams, buffer.max_episode_steps, buffer.capacity_steps) == (3, 4, 14)
    assert (buffer.frame_stack, buffer.num_goals, buffer.num_interactions) == (2, 5, 3)
    assert (buffer.num_actions, buffer.interactions) == (6, {3: 0, 4: 1, 5: 2})
    assert repr(buffer) == "EpisodeBuffer(0 episodes, 0 of 14 steps)"


def test_numbers_in_another_order_of_bytes_are_read_as_what_they_are() -> None:
    swapped = np.dtype(np.float32).newbyteorder()
    buffer = vhs.EpisodeBuffer(
        (2,), num_streams=1, max_episode_steps=3, capacity_steps=30, frame_stack=1, dtype=np.float32
    )
    buffer.begin(0, np.array([1, 2], swapped), 0)
    buffer.append(0, 0, 0.0, 0.0, np.array([3, 4], swapped))
    np.testing.assert_array_equal(buffer.observe([0])[0, 0], [3, 4])
    with pytest.raises(vhs.DtypeError, match="`out`: expected an array of float32"):
        buffer.observe([0], out=np.zeros((1, 1, 2), swapped))
    id = buffer.finish(0, vhs.Outcome.TIMEOUT)
    np.testing.assert_array_equal(buffer.gather([id]).observations[:, 0], [[1, 2], [3, 4]])
