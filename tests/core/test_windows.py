"""Windows with burn-in and padded episodes, against the recorded episodes they were drawn from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import vhs

from .recorded import record
from .test_transitions import KINDS, STRATEGIES, lengths


@given(
    lengths,
    st.sampled_from(KINDS),
    st.sampled_from([None, *STRATEGIES]),
    st.integers(1, 7),
    st.integers(0, 7),
)
def test_a_window_is_a_part_of_its_episode(
    lengths: list[int], kind: str, strategy: str | None, length: int, burn_in: int
) -> None:
    recording = record(lengths, kind)
    batch = recording.buffer.sample_windows(
        12, length, burn_in, strategy, probability=0.6 if strategy else None
    )
    width = length + burn_in
    assert batch.actions.shape[:2] == batch.mask.shape == batch.rewards.shape == (12, width)
    for row in range(len(batch)):
        episode = recording.episodes[batch.ids[row]]
        start, used = int(batch.steps[row]), int(batch.lengths[row])
        first = start + int(batch.burn_in[row])
        learned = start + used - first
        assert start == max(first - burn_in, 0)
        assert 1 <= learned <= length
        # Fewer learned steps than asked for only where the window hangs over an end of its episode.
        assert learned == length or first == 0 or start + used == len(episode)
        steps = np.arange(start, start + used)
        frames = np.stack([episode.observation(t, 2) for t in range(start, start + used + 1)])
        np.testing.assert_array_equal(batch.observations[row, : used + 1], frames)
        np.testing.assert_array_equal(batch.actions[row, :used], episode.actions[steps])
        np.testing.assert_array_equal(batch.values[row, :used], 0.5 * steps)
        np.testing.assert_array_equal(batch.mask[row, :used], steps >= first)
        padding = [batch.observations[row, used + 1 :], batch.actions[row, used:], batch.rewards[row, used:]]
        padding += [batch.values[row, used:], batch.mask[row, used:], batch.terminated[row, used:]]
        assert not any(part.any() for part in padding)
        assert batch.labels[row] == episode.label
        is_last = steps + 1 == len(episode)
        if not batch.relabelled[row]:
            np.testing.assert_array_equal(batch.rewards[row, :used], episode.rewards[steps])
            np.testing.assert_array_equal(batch.terminated[row, :used], is_last & episode.terminated)
            np.testing.assert_array_equal(batch.truncated[row, :used], is_last & (not episode.terminated))
            if batch.goals is not None:
                np.testing.assert_array_equal(batch.goals[row], recording.told(int(batch.ids[row])))
            continue
        goal = recording.goal(int(batch.goal_ids[row]), int(batch.goal_steps[row]))
        np.testing.assert_array_equal(batch.goals[row], goal)
        own = batch.goal_ids[row] == batch.ids[row]
        reached = (steps + 1 == batch.goal_steps[row]) & own
        np.testing.assert_array_equal(batch.rewards[row, :used], np.where(reached, 0.0, -1.0))
        np.testing.assert_array_equal(batch.terminated[row, :used], reached)
        np.testing.assert_array_equal(batch.truncated[row, :used], is_last & ~reached)


@pytest.mark.parametrize("length", [1, 3, 4, 9])
def test_every_step_is_learned_from_as_often_as_any_other(length: int) -> None:
    lengths, n = [1, 6, 3, 2], 40_000
    batch = record(lengths).buffer.sample_windows(n, length, 2)
    counts = [np.zeros(steps) for steps in lengths]
    for row in range(n):
        first = int(batch.steps[row] + batch.burn_in[row])
        counts[batch.ids[row]][first : int(batch.steps[row] + batch.lengths[row])] += 1
    windows = sum(steps + length - 1 for steps in lengths)
    expected = n * length / windows
    for count in np.concatenate(counts):
        assert abs(count - expected) < 6 * np.sqrt(expected), counts


def test_strict_windows_are_full_and_equally_likely() -> None:
    recording = record([1, 6, 3, 2, 4])
    batch = recording.buffer.sample_windows(30_000, 3, 2, strict=True)
    assert (batch.mask.sum(axis=1) == 3).all()
    starts = list(zip(batch.ids.tolist(), (batch.steps + batch.burn_in).tolist(), strict=True))
    expected = {(1, 0), (1, 1), (1, 2), (1, 3), (2, 0), (4, 0), (4, 1)}
    assert set(starts) == expected
    for start in expected:
        assert abs(starts.count(start) - 30_000 / 7) < 6 * np.sqrt(30_000 / 7)
    with pytest.raises(vhs.EmptyError, match="finished episode with as many steps as a window"):
        recording.buffer.sample_windows(2, 7, strict=True)


def test_a_window_goes_on_beyond_its_goal_and_says_where_that_was_reached() -> None:
    batch = record([6]).buffer.sample_windows(200, 6, 0, "future", probability=1.0)
    beyond = 0
    for row in range(200):
        reached = int(batch.goal_steps[row] - batch.steps[row] - 1)
        if 0 <= reached < batch.lengths[row]:
            assert np.flatnonzero(batch.terminated[row]).tolist() == [reached]
            beyond += int(batch.lengths[row]) - reached - 1
    assert beyond > 0


def test_a_function_judges_every_step_of_every_window_in_one_call() -> None:
    recording = record([4, 6, 5])
    calls = []

    def reward(achieved: np.ndarray, goals: np.ndarray) -> np.ndarray:
        assert achieved.shape == goals.shape == (9, 5, 3)
        calls.append(1)
        return -np.linalg.norm(achieved - goals, axis=-1)

    batch = recording.buffer.sample_windows(9, 3, 2, "future", probability=1.0, reward=reward)
    assert len(calls) == 1
    for row in range(9):
        used = int(batch.lengths[row])
        reached = batch.achieved_goals[row, 1 : used + 1]
        expected = -np.linalg.norm(reached - batch.goals[row], axis=-1)
        np.testing.assert_array_equal(batch.rewards[row, :used], expected)
        assert not batch.rewards[row, used:].any()


def test_a_function_says_where_windows_end_too() -> None:
    recording = record([4, 6, 5])

    def judge(achieved: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rewards = np.arange(achieved.shape[0] * achieved.shape[1]).reshape(achieved.shape[:2])
        return rewards, rewards % 2 == 1

    batch = recording.buffer.sample_windows(9, 3, 2, "future", probability=0.5, reward=judge)
    assert 0 < batch.relabelled.sum() < 9
    rewards, ends = judge(np.zeros((9, 5, 3)), np.zeros((9, 5, 3)))
    for row in range(9):
        used, episode = int(batch.lengths[row]), recording.episodes[batch.ids[row]]
        steps = np.arange(batch.steps[row], batch.steps[row] + used)
        if batch.relabelled[row]:
            expected = rewards[row, :used], ends[row, :used]
        else:
            expected = episode.rewards[steps], (steps + 1 == len(episode)) & episode.terminated
        np.testing.assert_array_equal(batch.rewards[row, :used], expected[0])
        np.testing.assert_array_equal(batch.terminated[row, :used], expected[1])
        assert not batch.rewards[row, used:].any()
        assert not batch.terminated[row, used:].any()


def test_windows_go_into_out() -> None:
    first, second = (record([4, 6, 5]).buffer for _ in range(2))
    out = np.full((7, 6, 2, 5), 9, np.uint8)
    batch = first.sample_windows(7, 3, 2, out=out)
    assert batch.observations is out
    np.testing.assert_array_equal(out, second.sample_windows(7, 3, 2).observations)
    with pytest.raises(vhs.ShapeError, match="expected shape"):
        first.sample_windows(8, 3, 2, out=out)


@pytest.mark.parametrize(("length", "burn_in"), [(0, 1), (-1, 0), (1, -1), (2**40, 0)])
def test_a_window_needs_a_size_that_can_be(length: int, burn_in: int) -> None:
    with pytest.raises(vhs.ArgumentError):
        record([3]).buffer.sample_windows(2, length, burn_in)


@given(lengths, st.sampled_from(KINDS), st.booleans())
def test_padded_episodes_are_a_rectangle(lengths: list[int], kind: str, into_out: bool) -> None:
    recording = record(lengths, kind)
    ids = recording.stored
    longest = max(len(recording.episodes[number]) for number in ids)
    out = np.full((len(ids) * (longest + 1) + 2, 2, 5), 9, np.uint8) if into_out else None
    batch = recording.buffer.gather(ids, padded=True, out=out)
    assert batch.observations.shape == (len(ids), longest + 1, 2, 5)
    assert not into_out or (np.shares_memory(batch.observations, out) and (out[-2:] == 9).all())
    rows = batch.observations.reshape(-1, 2, 5)
    for place, number in enumerate(ids):
        episode = recording.episodes[number]
        used = len(episode) + 1
        frames = np.stack([episode.observation(t, 2) for t in range(used)])
        np.testing.assert_array_equal(batch.observations[place, :used], frames)
        assert not batch.observations[place, used:].any()
        np.testing.assert_array_equal(rows[batch.offsets[place] + batch.lengths[place]], frames[-1])
        assert batch.terminated[place] == episode.terminated
        if kind == "vectors":
            np.testing.assert_array_equal(batch.achieved_goals[place, :used], episode.achieved)
        if kind != "labels":
            np.testing.assert_array_equal(batch.desired_goals[place], recording.told(number))


def test_hindsight_rows_hold_in_both_layouts() -> None:
    recording = record([2, 6, 3, 4])
    for padded in (False, True):
        batch = recording.buffer.sample_episodes(6, "final", on=tuple(vhs.Outcome), padded=padded)
        goals = batch.achieved_goals.reshape(-1, 3)[batch.hindsight.goal_rows]
        expected = np.stack([recording.episodes[number].achieved[-1] for number in batch.ids])
        np.testing.assert_array_equal(goals, expected)
