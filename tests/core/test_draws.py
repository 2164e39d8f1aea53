"""The numbers behind sampling are part of the library's output: those of Rust, and those of every version."""

from __future__ import annotations

import numpy as np
import pytest

import vhs


def filled() -> vhs.EpisodeBuffer:
    """Six failures of 1, 2, 3, 4, 1 and 2 steps: as in `rust/vhs-core/tests/properties/draws.rs`."""
    buffer = vhs.EpisodeBuffer(
        (1,), num_streams=1, max_episode_steps=5, capacity_steps=50, frame_stack=1, seed=7
    )
    frame = np.zeros(1, np.uint8)
    for number in range(6):
        buffer.begin(0, frame)
        for _ in range(1 + number % 4):
            buffer.append(0, 0, 0.0, 0.0, frame)
        buffer.finish(0, "failure")
    return buffer


def test_the_same_seed_draws_the_same_as_from_rust() -> None:
    buffer = filled()
    steps = buffer.sample_transitions(8, "future", probability=0.5)
    assert steps.ids.tolist() == [5, 3, 3, 0, 1, 4, 3, 0]
    assert steps.steps.tolist() == [0, 2, 3, 0, 0, 0, 1, 0]
    assert steps.goal_steps.tolist() == [-1, -1, 4, 1, -1, -1, 3, -1]
    whole = buffer.sample_episodes(6, "final", 0.5)
    assert whole.ids.tolist() == [2, 4, 5, 2, 1, 2]
    assert whole.hindsight.selected.tolist() == [True, False, False, False, True, True]
    parts = buffer.sample_windows(4, 2, 1, "random", ratio=1)
    assert parts.ids.tolist() == [4, 4, 3, 4]
    assert parts.steps.tolist() == [0, 0, 0, 0]
    assert parts.goal_ids.tolist() == [4, 2, 3, 3]
    assert parts.goal_steps.tolist() == [-1, 3, -1, 3]
    assert buffer.rng_state.tolist() == [
        14083743595286522908,
        9232919180395065440,
        14602620075285058684,
        17561433964684381176,
    ]


def test_a_refused_call_gives_its_number_back() -> None:
    buffer = filled()
    state = buffer.rng_state
    with pytest.raises(vhs.ArgumentError):
        buffer.sample_transitions(0)
    with pytest.raises(vhs.ArgumentError):
        buffer.sample_windows(4, 0)
    assert buffer.rng_state.tolist() == state.tolist()
