"""Single steps with hindsight goals, against the recorded episodes they were drawn from."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import vhs

from .recorded import GOAL_DIM, Recording, record

KINDS = ("labels", "observations", "vectors")
STRATEGIES = ("final", "future", "episode", "random")
lengths = st.lists(st.integers(1, 6), min_size=1, max_size=25)


def check_rows(recording: Recording, batch: vhs.TransitionBatch, strategy: str | None) -> None:
    """Every array of a batch, row by row."""
    stack = recording.buffer.frame_stack
    for row in range(len(batch)):
        number, t = int(batch.ids[row]), int(batch.steps[row])
        episode = recording.episodes[number]
        assert number in recording.stored
        assert 0 <= t < len(episode)
        np.testing.assert_array_equal(batch.observations[row], episode.observation(t, stack))
        np.testing.assert_array_equal(batch.next_observations[row], episode.observation(t + 1, stack))
        np.testing.assert_array_equal(batch.actions[row], episode.actions[t])
        assert batch.labels[row] == episode.label
        if batch.achieved_goals is not None:
            np.testing.assert_array_equal(batch.achieved_goals[row], episode.achieved[t + 1])
            np.testing.assert_array_equal(batch.previous_achieved_goals[row], episode.achieved[t])
        check_goal(recording, batch, row, strategy)


def check_goal(recording: Recording, batch: vhs.TransitionBatch, row: int, strategy: str | None) -> None:
    """The goal of a row, and what follows from it."""
    number, t = int(batch.ids[row]), int(batch.steps[row])
    episode, is_last = recording.episodes[number], t + 1 == len(recording.episodes[number])
    flags = bool(batch.terminated[row]), bool(batch.truncated[row])
    source, step = int(batch.goal_ids[row]), int(batch.goal_steps[row])
    if not batch.relabelled[row]:
        assert (source, step) == (number, -1)
        assert batch.rewards[row] == episode.rewards[t]
        assert flags == (is_last and episode.terminated, is_last and not episode.terminated)
        if batch.goals is not None:
            np.testing.assert_array_equal(batch.goals[row], recording.told(number))
        return
    low = {"final": len(episode), "future": t + 1}.get(strategy, 1)
    assert low <= step <= len(recording.episodes[source])
    assert source == number or strategy == "random"
    np.testing.assert_array_equal(batch.goals[row], recording.goal(source, step))
    reached = (source, step) == (number, t + 1)
    assert batch.rewards[row] == (0.0 if reached else -1.0)
    assert flags == (reached, is_last and not reached)


@given(lengths, st.sampled_from(KINDS), st.sampled_from([None, *STRATEGIES]), st.integers(1, 3))
def test_every_row_is_a_recorded_step_with_its_goal(
    lengths: list[int], kind: str, strategy: str | None, stack: int
) -> None:
    recording = record(lengths, kind, stack)
    batch = recording.buffer.sample_transitions(40, strategy, probability=0.7 if strategy else None)
    assert (batch.goals is None) == (kind == "labels" and strategy is None)
    check_rows(recording, batch, strategy)


@given(lengths, st.sampled_from(STRATEGIES))
def test_same_seed_same_batches(lengths: list[int], strategy: str) -> None:
    first, second = (record(lengths).buffer for _ in range(2))
    for _ in range(3):
        one, two = (buffer.sample_transitions(9, strategy, ratio=2) for buffer in (first, second))
        np.testing.assert_array_equal(one.observations, two.observations)
        np.testing.assert_array_equal(one.goals, two.goals)


def test_every_step_is_equally_likely_and_so_is_every_goal() -> None:
    recording = record([1, 2, 4])
    batch = recording.buffer.sample_transitions(60_000, "future", probability=1.0)
    seen: dict[tuple[int, int, int], int] = {}
    for key in zip(batch.ids.tolist(), batch.steps.tolist(), batch.goal_steps.tolist(), strict=True):
        seen[key] = seen.get(key, 0) + 1
    expected = {
        (episode, t, goal): 60_000 / 7 / (length - t)
        for episode, length in enumerate([1, 2, 4])
        for t in range(length)
        for goal in range(t + 1, length + 1)
    }
    assert seen.keys() == expected.keys()
    for key, count in expected.items():
        assert abs(seen[key] - count) < 6 * np.sqrt(count), key


def test_a_ratio_is_exact_and_a_probability_is_met() -> None:
    buffer = record([5, 6, 4, 3]).buffer
    for ratio in (0, 1, 4):
        relabelled = buffer.sample_transitions(60, "future", ratio=ratio).relabelled
        assert relabelled.sum() == 60 * ratio // (ratio + 1)
    share = buffer.sample_transitions(40_000, "final", probability=0.3).relabelled.mean()
    assert abs(share - 0.3) < 6 * np.sqrt(0.21 / 40_000)
    assert abs(buffer.sample_transitions(40_000, "final").relabelled.mean() - 0.8) < 0.013


def test_only_chosen_outcomes_are_relabelled() -> None:
    recording = record([2] * 9)
    batch = recording.buffer.sample_transitions(500, "episode", probability=1.0, on=("failure",))
    failed = [recording.episodes[number].outcome == vhs.Outcome.FAILURE for number in batch.ids]
    assert batch.relabelled.tolist() == failed
    assert any(failed)
    assert not all(failed)


def test_the_interaction_of_the_goal_comes_with_it() -> None:
    buffer = vhs.EpisodeBuffer(
        (1,),
        num_streams=1,
        max_episode_steps=4,
        capacity_steps=8,
        frame_stack=1,
        interactions={3: 0, 4: 1, 5: 2},
    )
    buffer.begin(0, np.zeros(1, np.uint8), 0, 2)
    for t, action in enumerate([0, 4, 3]):  # a move, interaction 1, interaction 0
        buffer.append(0, action, 0.0, 0.0, np.full(1, t + 1, np.uint8))
    buffer.finish(0, "failure")
    batch = buffer.sample_transitions(200, "episode", probability=0.8)
    done = {1: 2, 2: 1, 3: 0, -1: 2}
    assert batch.interactions.tolist() == [done[step] for step in batch.goal_steps.tolist()]


def test_a_function_judges_a_whole_batch_in_one_call() -> None:
    recording = record([4, 6, 5])
    calls = []

    def reward(achieved: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        calls.append((achieved.copy(), goals.copy()))
        distance = np.linalg.norm(achieved - goals, axis=-1)
        return -distance, distance < 0.01

    batch = recording.buffer.sample_transitions(50, "future", probability=0.5, reward=reward)
    ((achieved, goals),) = calls
    np.testing.assert_array_equal(achieved, batch.achieved_goals)
    np.testing.assert_array_equal(goals, batch.goals)
    expected = -np.linalg.norm(achieved - goals, axis=-1)
    np.testing.assert_array_equal(batch.rewards[batch.relabelled], expected[batch.relabelled])
    for row in np.flatnonzero(~batch.relabelled):
        check_goal(recording, batch, row, "future")
    ended = batch.steps + 1 == [len(recording.episodes[number]) for number in batch.ids]
    new = batch.relabelled
    np.testing.assert_array_equal(batch.terminated[new], expected[new] > -0.01)
    np.testing.assert_array_equal(batch.truncated[new], (ended & (expected <= -0.01))[new])


def test_a_function_that_gives_rewards_alone_leaves_the_ends_as_recorded() -> None:
    recording = record([3, 3, 3, 3])
    batch = recording.buffer.sample_transitions(
        80, "final", probability=1.0, reward=lambda achieved, _: np.full(len(achieved), 7)
    )
    assert (batch.rewards == 7).all()
    episodes = [recording.episodes[number] for number in batch.ids]
    ends = batch.steps == 2
    np.testing.assert_array_equal(batch.terminated, ends & [e.terminated for e in episodes])
    np.testing.assert_array_equal(batch.truncated, ends & [not e.terminated for e in episodes])


def test_a_function_is_not_asked_where_nothing_was_relabelled() -> None:
    buffer = record([3]).buffer
    batch = buffer.sample_transitions(5, "final", probability=0.0, reward=lambda *_: 1 / 0)
    assert not batch.relabelled.any()


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (np.zeros(3), vhs.ShapeError, "`reward`: expected shape [4], got [3]"),
        (np.array([0, np.nan, 0, 0]), vhs.NonFiniteError, "`reward`: expected a finite number"),
        ((np.zeros(4), np.zeros(4)), vhs.DtypeError, "`terminated`: expected bool, got float64"),
        ((np.zeros(4), np.zeros(2, bool)), vhs.ShapeError, "`terminated`: expected shape [4], got [2]"),
        (("a", "b", "c"), vhs.DtypeError, "`reward`: expected rewards, or (rewards, terminated)"),
    ],
)
def test_an_answer_that_does_not_fit_changes_nothing(
    answer: object, error: type[Exception], message: str
) -> None:
    buffer, twin = record([3]).buffer, record([3]).buffer
    with pytest.raises(error) as caught:
        buffer.sample_transitions(4, "final", probability=1.0, reward=lambda *_: answer)
    assert message in str(caught.value)
    one, two = buffer.sample_transitions(9), twin.sample_transitions(9)
    np.testing.assert_array_equal(one.steps, two.steps)


@pytest.mark.parametrize(("tolerance", "terminates"), [*product([0.5, 1.5], [True, False])])
def test_the_sparse_rule_measures_distances(tolerance: float, terminates: bool) -> None:
    recording = record([4, 6, 5])
    rule = vhs.SparseReward(2.0, -3.0, tolerance, terminates)
    batch = recording.buffer.sample_transitions(200, "random", probability=1.0, reward=rule)
    near = np.linalg.norm((batch.achieved_goals - batch.goals).astype(np.float64), axis=-1) <= tolerance
    np.testing.assert_array_equal(batch.rewards, np.where(near, 2.0, -3.0))
    np.testing.assert_array_equal(batch.terminated, near & terminates)
    assert near.any()
    assert not near.all()
    assert (
        repr(rule)
        == f"SparseReward(reached=2.0, otherwise=-3.0, tolerance={tolerance}, terminates={terminates})"
    )
    assert rule == vhs.SparseReward(2.0, -3.0, tolerance, terminates)


def test_equal_goals_at_different_times_both_count_as_reached() -> None:
    buffer = vhs.EpisodeBuffer((1,), num_streams=1, max_episode_steps=3, capacity_steps=3, frame_stack=1)
    buffer.begin(0, np.zeros(1, np.uint8))
    for frame in (7, 1, 7):
        buffer.append(0, 0, -9.0, 0.0, np.full(1, frame, np.uint8))
    buffer.finish(0, "timeout")
    batch = buffer.sample_transitions(50, "final", probability=1.0)
    np.testing.assert_array_equal(batch.rewards, np.where(batch.steps == 1, -1.0, 0.0))


def test_out_is_written_in_part_or_whole() -> None:
    recording, twin = record([4, 6, 5]), record([4, 6, 5])
    expected = twin.buffer.sample_transitions(8, "future")
    out = {"next_observations": np.zeros((8, 2, 5), np.uint8), "goals": np.zeros((8, GOAL_DIM), np.float32)}
    batch = recording.buffer.sample_transitions(8, "future", out=out)
    assert batch.next_observations is out["next_observations"]
    assert batch.goals is out["goals"]
    for name in ("observations", "next_observations", "goals", "achieved_goals", "rewards"):
        np.testing.assert_array_equal(getattr(batch, name), getattr(expected, name))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"n": 0}, vhs.ArgumentError, "`n`: expected a number in 1..="),
        (
            {"relabel": "best"},
            vhs.ArgumentError,
            '`strategy`: expected "final", "future", "episode", "random"',
        ),
        ({"probability": 0.5, "ratio": 1}, vhs.ArgumentError, "`ratio`: expected either"),
        ({"probability": 1.5}, vhs.ArgumentError, "`probability`: expected a number in 0..=1"),
        ({"ratio": -1}, vhs.ArgumentError, "`ratio`: expected a number"),
        ({"on": ("lost",)}, vhs.ArgumentError, "`outcome`: expected"),
        ({"reward": 3}, vhs.DtypeError, "`reward`: expected a SparseReward or a function"),
        ({"out": {"images": 3}}, vhs.DtypeError, "`out`: expected arrays named among observations"),
        ({"out": {"goals": 3}}, vhs.DtypeError, "`out`: expected an array of float32, got int"),
        (
            {"out": {"goals": np.zeros((4, 3))}},
            vhs.DtypeError,
            "`out`: expected an array of float32, got float64",
        ),
        (
            {"out": {"goals": np.zeros((4, 2), np.float32)}},
            vhs.ShapeError,
            "`out`: expected shape [4, 3], got [4, 2]",
        ),
        (
            {"out": {"observations": np.zeros((4, 2, 10), np.uint8)[:, :, ::2]}},
            vhs.LayoutError,
            "`out`: expected a C-contiguous array",
        ),
    ],
)
def test_bad_arguments_are_refused_and_change_nothing(
    arguments: dict[str, object], error: type[Exception], message: str
) -> None:
    buffer, twin = record([3, 2]).buffer, record([3, 2]).buffer
    with pytest.raises(error) as caught:
        buffer.sample_transitions(**({"n": 4, "relabel": "final"} | arguments))
    assert message in str(caught.value)
    np.testing.assert_array_equal(buffer.sample_transitions(9).steps, twin.sample_transitions(9).steps)


def test_one_array_cannot_be_written_twice() -> None:
    buffer, images = record([3, 2]).buffer, np.zeros((4, 2, 5), np.uint8)
    with pytest.raises(vhs.LayoutError, match="in use"):
        buffer.sample_transitions(4, out={"observations": images, "next_observations": images})


def test_an_empty_buffer_has_no_transitions() -> None:
    with pytest.raises(vhs.EmptyError, match="at least one finished episode"):
        record([]).buffer.sample_transitions(1)


def test_results_lie_in_memory_that_is_used_again() -> None:
    buffer = vhs.EpisodeBuffer(
        (84, 84, 3), num_streams=1, max_episode_steps=2, capacity_steps=8, num_goals=1, num_interactions=1
    )
    frame = np.arange(84 * 84 * 3, dtype=np.uint32).astype(np.uint8).reshape(84, 84, 3)
    buffer.begin(0, frame, 0, 0)
    buffer.append(0, 0, 0.0, 0.0, frame[::-1])
    buffer.finish(0, "failure")
    first = buffer.sample_transitions(64)
    kept, address = first.observations[3], first.next_observations.ctypes.data
    del first
    second = buffer.sample_transitions(64)
    # The view keeps the memory of the observations in use; the other block has come back.
    addresses = {second.observations.ctypes.data, second.next_observations.ctypes.data}
    assert address in addresses
    assert not any(np.shares_memory(kept, array) for array in (second.observations, second.next_observations))
    np.testing.assert_array_equal(kept[1], frame)
