"""Prioritised draws and sums of several steps; the Rust tests compare both with lists and loops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import vhs

from .recorded import record

FRAME = np.zeros(2, np.uint8)


def filled(**given: Any) -> vhs.EpisodeBuffer:
    """Two episodes, of three steps and of two, rewarded 0, 1, 2 and 3, 4."""
    sizes: dict[str, Any] = {"num_streams": 1, "max_episode_steps": 4, "capacity_steps": 16}
    buffer = vhs.EpisodeBuffer((2,), **(sizes | {"priority_exponent": 1.0} | given))
    for rewards in ([0, 1, 2], [3, 4]):
        buffer.begin(0, FRAME)
        for reward in rewards:
            buffer.append(0, 0, reward, None, FRAME)
        buffer.finish(0, "failure")
    return buffer


def test_a_learner_prefers_steps_of_large_errors() -> None:
    buffer = filled()
    batch = buffer.sample_transitions(500, beta=0.5)
    assert batch.weights is not None
    assert batch.weights.tolist() == [1] * 500  # all steps are new
    errors = np.where((batch.ids == 1) & (batch.steps == 1), 7.0, 1.0)
    buffer.update_priorities(batch.ids, batch.steps, errors)
    batch = buffer.sample_transitions(11_000, beta=0.5)
    favourite = batch.ids * 10 + batch.steps == 11
    assert abs(favourite.sum() - 7000) < 6 * np.sqrt(7000)
    assert batch.weights is not None
    assert batch.weights[favourite] == pytest.approx(7**-0.5)
    assert batch.weights[~favourite] == pytest.approx(1)
    plain = buffer.sample_transitions(100)
    assert plain.weights is plain.lengths is plain.discounts is None
    once = buffer.sample_transitions(100, gamma=0.5)
    assert once.lengths is not None
    assert once.discounts is not None
    assert (once.lengths.tolist(), once.discounts.tolist()) == ([1] * 100, [0.5] * 100)


def test_sums_of_steps_end_with_their_episode() -> None:
    batch = filled().sample_transitions(60, n_step=2, gamma=0.5)
    assert batch.lengths is not None
    assert batch.discounts is not None
    sums = {(0, 0): 0.5, (0, 1): 2, (0, 2): 2, (1, 0): 5, (1, 1): 4}
    for row, place in enumerate(zip(batch.ids.tolist(), batch.steps.tolist(), strict=True)):
        assert batch.rewards[row] == sums[place]
        steps = 1 if place in {(0, 2), (1, 1)} else 2
        assert (batch.lengths[row], batch.discounts[row]) == (steps, 0.5**steps)
        assert batch.terminated[row] == (place != (0, 0))


@pytest.mark.parametrize("strategy", ["final", "future", "random"])
def test_sums_with_hindsight_stop_where_the_new_goal_is_reached(strategy: str) -> None:
    recording = record([5, 6, 3, 1], "vectors")
    batch = recording.buffer.sample_transitions(80, strategy, ratio=4, n_step=3, gamma=0.9)
    assert batch.lengths is not None
    for row in np.flatnonzero(batch.relabelled):
        start, source = int(batch.steps[row]), (int(batch.goal_ids[row]), int(batch.goal_steps[row]))
        after = [(int(batch.ids[row]), t) for t in range(start + 1, start + 4)]
        reached = source in after[: int(batch.lengths[row])]
        assert batch.terminated[row] == reached
        if reached:
            assert source == after[int(batch.lengths[row]) - 1]
            np.testing.assert_array_equal(batch.achieved_goals[row], batch.goals[row])
        misses = int(batch.lengths[row]) - reached
        assert batch.rewards[row] == pytest.approx(-sum(0.9**step for step in range(misses)))


@pytest.mark.parametrize(
    ("given", "error", "told"),
    [
        ({"n_step": 2}, vhs.ArgumentError, "`gamma`: expected a discount in 0..=1 beside n_step, got none"),
        ({"n_step": 0, "gamma": 1.0}, vhs.ArgumentError, "`n_step`: expected a number in 1..=1048576, got 0"),
        ({"gamma": 1.5}, vhs.ArgumentError, "`gamma`: expected a number in 0..=1, got 1.5"),
        ({"beta": float("nan")}, vhs.ArgumentError, "`beta`: expected a number in 0..=1, got NaN"),
        (
            {"n_step": 2, "gamma": 0.9, "relabel": "final", "reward": lambda achieved, goals: achieved},
            vhs.ArgumentError,
            "`reward`: expected a vhs.SparseReward where n_step is above 1, got a function",
        ),
    ],
)
def test_a_draw_that_makes_no_sense_is_refused(given: dict[str, Any], error: type, told: str) -> None:
    buffer = filled()
    before = buffer.rng_state
    with pytest.raises(error, match=told):
        buffer.sample_transitions(3, **given)
    assert buffer.rng_state.tolist() == before.tolist()


@pytest.mark.parametrize(
    ("priorities", "error", "told"),
    [
        (
            [1.0, 0.0],
            vhs.ArgumentError,
            r"numbers above 0 \(errors may be 0: add a small number\), got 0 at index 1",
        ),
        ([1.0, np.nan], vhs.NonFiniteError, "`priorities`: expected a finite number, got NaN at index 1"),
        ([-1.0, 1.0], vhs.ArgumentError, "numbers above 0"),
        ([1.0], vhs.ShapeError, r"`priorities`: expected shape \[2\], got \[1\]"),
        (["a", "b"], vhs.DtypeError, "`priorities`: expected real numbers"),
    ],
)
def test_what_is_no_priority_is_refused_and_nothing_changes(priorities: Any, error: type, told: str) -> None:
    buffer, other = filled(), filled()
    with pytest.raises(error, match=told):
        buffer.update_priorities([0, 1], [0, 1], priorities)
    one, two = (each.sample_transitions(20, beta=1.0) for each in (buffer, other))
    assert (one.ids.tolist(), one.steps.tolist()) == (two.ids.tolist(), two.steps.tolist())


def test_a_buffer_without_priorities_says_so() -> None:
    buffer = filled(priority_exponent=None)
    assert buffer.priority_exponent is None
    told = (
        "`priority_exponent`: expected a number when the buffer is made, for what needs priorities, got none"
    )
    with pytest.raises(vhs.ArgumentError, match=told):
        buffer.sample_transitions(3, beta=0.4)
    with pytest.raises(vhs.ArgumentError, match=told):
        buffer.update_priorities([0], [0], [1.0])
    with pytest.raises(vhs.ArgumentError, match=r"`priority_exponent`: expected a number in 0\.\.=1, got 2"):
        filled(priority_exponent=2.0)
    nothing = vhs.EpisodeBuffer(
        (2,), num_streams=1, max_episode_steps=4, capacity_steps=16, priority_exponent=1
    )
    with pytest.raises(vhs.EmptyError):
        nothing.sample_transitions(3, beta=0.4)
