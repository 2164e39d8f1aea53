"""Types of elements: whatever numpy's common ones hold is stored, drawn, saved and compared exactly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vhs

INTEGERS = ["uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64"]
TYPES = ["bool", *INTEGERS, "float16", "float32", "float64"]


def extremes(dtype: str) -> np.ndarray:
    """Numbers at the ends of a type's range, [4]."""
    kind = np.dtype(dtype).kind
    if kind == "b":
        return np.array([True, False, False, True])
    if kind == "f":
        info = np.finfo(dtype)
        return np.array([info.max, info.min, info.smallest_subnormal, -0.0], dtype)
    limits = np.iinfo(dtype)
    return np.array([limits.max, limits.min, 1, 0], dtype)


def filled(dtype: str) -> vhs.EpisodeBuffer:
    """One episode of one step; frames and goals have the same numbers, the second in reverse."""
    buffer = vhs.EpisodeBuffer(
        (4,),
        num_streams=1,
        max_episode_steps=3,
        capacity_steps=9,
        frame_stack=1,
        dtype=dtype,
        goals="vectors",
        goal_shape=(4,),
        goal_dtype=dtype,
    )
    numbers = extremes(dtype)
    buffer.begin(0, numbers, desired_goal=numbers, achieved_goal=numbers)
    buffer.append(0, 0, 0.0, 0.0, numbers[::-1], achieved_goal=numbers[::-1])
    buffer.finish(0, "failure")
    return buffer


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("loading", [None, {}, {"mmap": True}])
def test_a_type_is_stored_and_given_back(dtype: str, loading: dict[str, bool] | None, tmp_path: Path) -> None:
    buffer, numbers = filled(dtype), extremes(dtype)
    if loading is not None:
        buffer.save(tmp_path / "buffer")
        buffer = vhs.EpisodeBuffer.load(tmp_path / "buffer", **loading)
    assert (buffer.dtype, buffer.goal_dtype) == (np.dtype(dtype), np.dtype(dtype))
    batch = buffer.gather([0])
    for array in (batch.observations[:, 0], batch.achieved_goals):
        assert array.dtype == np.dtype(dtype)
        np.testing.assert_array_equal(array, [numbers, numbers[::-1]])
    steps = buffer.sample_transitions(5, "final", probability=1.0)
    np.testing.assert_array_equal(steps.previous_achieved_goals, [numbers] * 5)
    np.testing.assert_array_equal(steps.achieved_goals, [numbers[::-1]] * 5)
    assert steps.terminated.all()


@pytest.mark.parametrize("dtype", TYPES)
def test_another_type_is_refused(dtype: str) -> None:
    other = "uint8" if dtype != "uint8" else "bool"
    with pytest.raises(vhs.DtypeError, match=f"`frame`: expected {dtype}, got {other}"):
        filled(dtype).begin(0, np.zeros(4, other))


@pytest.mark.parametrize("dtype", ["float16", "uint16", "int16", "uint32", "uint64", "bool"])
def test_distances_are_those_of_the_numbers(dtype: str) -> None:
    buffer = vhs.EpisodeBuffer(
        (1,),
        num_streams=1,
        max_episode_steps=2,
        capacity_steps=4,
        goals="vectors",
        goal_shape=(1,),
        goal_dtype=dtype,
    )
    frame = np.zeros(1, np.uint8)
    places = [np.array([place], dtype) for place in (0, 1, 0)]
    buffer.begin(0, frame, desired_goal=places[0], achieved_goal=places[0])
    for place in places[1:]:
        buffer.append(0, 0, 0.0, 0.0, frame, achieved_goal=place)
    buffer.finish(0, "failure")
    for tolerance, reached in ((0.9, {1}), (1.0, {0, 1})):
        reward = vhs.SparseReward(tolerance=tolerance)
        batch = buffer.sample_transitions(50, "final", probability=1.0, reward=reward)
        assert set(batch.steps[batch.terminated].tolist()) == reached


def test_a_truth_is_one_byte_whatever_numpy_made_of_it() -> None:
    buffer = vhs.EpisodeBuffer((4,), num_streams=1, max_episode_steps=2, capacity_steps=4, dtype=bool)
    mask = np.array([0, 1, 255, 128], np.uint8)
    buffer.begin(0, mask.view(bool))
    buffer.append(0, 0, 0.0, 0.0, np.stack([mask, mask], axis=1).view(bool)[:, 0])
    assert buffer.observe([0]).view(np.uint8).tolist() == [[[0, 1, 1, 1], [0, 1, 1, 1]]]


def test_actions_are_the_numbers_of_the_environment(tmp_path: Path) -> None:
    buffer = vhs.EpisodeBuffer(
        (1,),
        num_streams=1,
        max_episode_steps=9,
        capacity_steps=9,
        num_actions=3,
        first_action=-1,
        interactions={1: 0, -1: 1},
    )
    frame = np.zeros(1, np.uint8)
    buffer.begin(0, frame)
    for action in (-1, 0, 1):
        buffer.append(0, action, 0.0, 0.0, frame)
    for action in (-2, 2, 2**62, -(2**62)):
        with pytest.raises(
            vhs.ArgumentError, match=rf"`actions`: expected numbers in -1..2, got {action} at"
        ):
            buffer.append(0, action, 0.0, 0.0, frame)
    buffer.finish(0, "failure")
    buffer.save(tmp_path / "buffer")
    for each in (buffer, vhs.EpisodeBuffer.load(tmp_path / "buffer")):
        assert (each.first_action, each.num_actions, each.interactions) == (-1, 3, {-1: 1, 1: 0})
        assert each.gather([0]).actions.tolist() == [[-1, 0, 1]]
        hindsight = each.sample_episodes(1, "final").hindsight
        assert hindsight.interactions.tolist() == [0]
    with pytest.raises(vhs.ArgumentError, match=r"actions in -1..2 that do"):
        vhs.EpisodeBuffer(
            (1,),
            num_streams=1,
            max_episode_steps=1,
            capacity_steps=1,
            num_actions=3,
            first_action=-1,
            interactions={2: 0},
        )
