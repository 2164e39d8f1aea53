"""Finished episodes of one buffer in another, and batches of both: against the episodes themselves."""

import contextlib
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vhs

from .recorded import MAX_STEPS, Recording, make_episode, record


def check(recording: Recording, batch: vhs.EpisodeBatch, expected: list[tuple[int, int]]) -> None:
    """Check that a batch has these episodes of a recording, each as far as so many steps."""
    assert batch.lengths.tolist() == [steps for _, steps in expected]
    for row, (number, steps) in enumerate(expected):
        episode, first = recording.episodes[number], int(batch.offsets[row])
        stack = recording.buffer.frame_stack
        for t in range(steps + 1):
            np.testing.assert_array_equal(batch.observations[first + t], episode.observation(t, stack))
            if batch.achieved_goals is not None:
                np.testing.assert_array_equal(batch.achieved_goals[first + t], episode.achieved[t])
        np.testing.assert_array_equal(batch.actions[row, :steps], episode.actions[:steps])
        np.testing.assert_array_equal(batch.rewards[row, :steps], episode.rewards[:steps])
        np.testing.assert_array_equal(batch.values[row, :steps], 0.5 * np.arange(steps))
        assert (batch.goals[row], batch.outcomes[row]) == (episode.label, episode.outcome)
        assert batch.terminated[row] == (episode.terminated and steps == len(episode))
        if batch.desired_goals is not None and recording.buffer.goals == "vectors":
            np.testing.assert_array_equal(batch.desired_goals[row], episode.desired)


@settings(deadline=None)
@given(
    lengths=st.lists(st.integers(1, MAX_STEPS), min_size=1, max_size=8),
    cuts=st.lists(st.integers(1, MAX_STEPS), max_size=12),
    goals=st.sampled_from(["labels", "observations", "vectors"]),
    stack=st.integers(1, 3),
    backings=st.tuples(*[st.sampled_from(["memory", "lz4"])] * 2),
    capacity=st.integers(MAX_STEPS, 20),
)
def test_what_is_collected_is_what_was_played(
    lengths: list[int],
    cuts: list[int],
    goals: str,
    stack: int,
    backings: tuple[str, str],
    capacity: int,
) -> None:
    lived = record(lengths, goals, stack, backing=backings[0])
    kept = record([], goals, stack, capacity=capacity, backing=backings[1])
    ids = np.array([place % len(lengths) for place in range(len(cuts))], np.int64)
    steps = np.minimum(cuts, np.array(lengths)[ids]).astype(np.int64)
    found = kept.buffer.collect(lived.buffer, ids, steps=steps)
    assert found.tolist() == list(range(len(cuts)))
    stored = kept.buffer.ids.tolist()
    fitting = [i for i in found.tolist() if steps[i:].sum() <= capacity]
    assert stored == fitting
    if stored:
        expected = [(int(ids[i]), int(steps[i])) for i in stored]
        check(lived, kept.buffer.gather(stored), expected)
        both = lived.buffer.gather([0], also=(kept.buffer, stored))
        check(lived, both, [(0, lengths[0]), *expected])
        out = np.zeros((len(both.observations) + 1, *lived.buffer.observation_shape), np.uint8)
        again = lived.buffer.gather([0], also=(kept.buffer, stored), out=out)
        np.testing.assert_array_equal(again.observations, both.observations)
        rule = vhs.relabel(both, rng=0, on=tuple(vhs.Outcome), probability=1.0)
        assert rule.goal_rows.tolist() == (both.offsets + both.lengths).tolist()


def test_fields_come_along() -> None:
    fields = {"compass": vhs.Field((2,), "float32"), "cost": vhs.Field((), "float32", per="step")}
    lived, kept = (
        vhs.EpisodeBuffer((3,), num_streams=1, max_episode_steps=4, capacity_steps=8, fields=fields)
        for _ in range(2)
    )
    frame = np.zeros(3, np.uint8)
    lived.begin(0, frame, fields={"compass": np.array([0, 1], np.float32)})
    for step in range(3):
        told = {"compass": np.full(2, step, np.float32), "cost": np.float32(0.5 + step)}
        lived.append(0, 0, 0.0, 0.0, frame, fields=told)
    kept.collect(lived, [lived.finish(0, "success")], steps=[2])
    batch = kept.gather([0])
    assert batch.fields["compass"].tolist() == [[0, 1], [0, 0], [1, 1]]
    assert batch.fields["cost"].tolist() == [[0.5, 1.5]]


def test_sample_ids_draws_as_sample_episodes_does() -> None:
    one, other = record([2, 3, 4], seed=5), record([2, 3, 4], seed=5)
    assert one.buffer.sample_ids(20).tolist() == other.buffer.sample_episodes(20).ids.tolist()
    assert one.buffer.sample_ids(20).tolist() == other.buffer.sample_episodes(20).ids.tolist()
    with pytest.raises(vhs.EmptyError):
        record([]).buffer.sample_ids(1)


def test_bad_calls_copy_nothing() -> None:
    lived, kept = record([3, 4]), record([5])

    def refused(error: type[Exception], words: str, *args: object, **named: object) -> None:
        with pytest.raises(error, match=words):
            kept.buffer.collect(*args, **named)
        assert kept.buffer.ids.tolist() == [0]
        assert not kept.buffer.open.any()

    refused(vhs.ArgumentError, "expected another buffer, got this one", kept.buffer, [0])
    refused(vhs.ArgumentError, "another `frame_stack`", record([3], stack=1).buffer, [0])
    refused(vhs.ArgumentError, "another `goals`", record([3], goals="labels").buffer, [0])
    refused(vhs.EpisodeError, "7", lived.buffer, [0, 7])
    refused(vhs.ArgumentError, "1 to 4 of an episode of 4 steps, got 5", lived.buffer, [0, 1], steps=[3, 5])
    refused(vhs.ArgumentError, "1 to 3 of an episode of 3 steps, got 0", lived.buffer, [0], steps=[0])
    refused(vhs.ShapeError, "steps", lived.buffer, [0, 1], steps=[3])
    refused(vhs.LabelError, "stream", lived.buffer, [0], stream=1)
    with pytest.raises(vhs.ArgumentError, match="another `frame_stack`"):
        kept.buffer.gather([0], also=(record([3], stack=1).buffer, [0]))
    with pytest.raises(vhs.ArgumentError, match="expected another buffer"):
        kept.buffer.gather([0], also=(kept.buffer, [0]))
    nowhere = np.zeros(3, np.float32)
    kept.buffer.begin(0, np.zeros(5, np.uint8), desired_goal=nowhere, achieved_goal=nowhere)
    with pytest.raises(vhs.ProtocolError, match="open episode"):
        kept.buffer.collect(lived.buffer, [0])


def test_an_episode_longer_than_one_may_be_here_is_refused() -> None:
    sizes = {"frame_shape": (5,), "num_streams": 1, "capacity_steps": 9}
    lived, kept = (vhs.EpisodeBuffer(**sizes, max_episode_steps=most) for most in (6, 2))
    episode = make_episode(0, 3)
    lived.begin(0, episode.frames[0])
    for t in range(3):
        lived.append(0, 1, 0.0, 0.0, episode.frames[t + 1])
    id = lived.finish(0, "success")
    with pytest.raises(vhs.ProtocolError):
        kept.collect(lived, [id])
    assert kept.collect(lived, [id], steps=[2]).tolist() == [0]


def test_two_buffers_that_copy_from_each_other_do_not_wait_in_a_circle() -> None:
    one, other = record([3] * 8, capacity=60), record([4] * 8, capacity=60)

    def copy(here: vhs.EpisodeBuffer, there: vhs.EpisodeBuffer) -> None:
        for _ in range(300):
            with contextlib.suppress(vhs.EpisodeError):  # the other thread's copies may have evicted it
                here.collect(there, there.ids[-1:])
                there.gather(there.ids[-1:], also=(here, here.ids[-1:]))

    pairs = [(one.buffer, other.buffer), (other.buffer, one.buffer)]
    threads = [threading.Thread(target=copy, args=pair, daemon=True) for pair in pairs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not any(thread.is_alive() for thread in threads)
