"""Frames stacked as the channels of one picture, against numpy's own transposition."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import vhs

SIZES = st.tuples(st.integers(1, 3), st.integers(1, 5), st.integers(1, 5), st.integers(1, 4))
DTYPES = st.sampled_from(["uint8", "float32"])


def as_channels(observations: NDArray[np.generic]) -> NDArray[np.generic]:
    """[..., stack, height, width, channels] as [..., height, width, stack * channels]."""
    moved = np.moveaxis(observations, -4, -2)
    return moved.reshape(*moved.shape[:-2], -1)


def recorded(stacking: str, sizes: tuple[int, ...], dtype: str, goals: str) -> vhs.EpisodeBuffer:
    """Two successes and an open episode, the same frames whatever the stacking."""
    stack, *frame_shape = sizes
    buffer = vhs.EpisodeBuffer(
        frame_shape,
        num_streams=1,
        max_episode_steps=4,
        capacity_steps=20,
        frame_stack=stack,
        stacking=stacking,
        dtype=dtype,
        goals=goals,
    )
    rng = np.random.default_rng(0)

    def frames(*shape: int) -> NDArray[np.generic]:
        return rng.integers(0, 256, (*shape, *frame_shape)).astype(dtype)

    for length in (3, 2, 4):
        told = frames(stack)
        told = as_channels(told) if stacking == "channels" else told
        buffer.begin(0, frames(), **({"desired_goal": told} if goals == "observations" else {}))
        for _ in range(length):
            buffer.append(0, 0, -1.0, 0.0, frames())
        if length < 4:
            buffer.finish(0, "success")
    return buffer


@given(SIZES, DTYPES, st.sampled_from(["labels", "observations"]))
def test_every_observation_and_goal_is_a_transposition(
    sizes: tuple[int, ...], dtype: str, goals: str
) -> None:
    frames, channels = (recorded(stacking, sizes, dtype, goals) for stacking in ("frames", "channels"))
    stack, height, width, colours = sizes
    assert channels.observation_shape == channels.goal_shape == (height, width, stack * colours)
    assert (frames.stacking, channels.stacking) == ("frames", "channels")
    pairs = [(frames.observe(), channels.observe())]
    for padded in (False, True):
        one, two = (buffer.gather([1, 0], padded=padded) for buffer in (frames, channels))
        pairs += [(one.observations, two.observations)]
        if goals == "observations":
            pairs += [(one.desired_goals, two.desired_goals)]
    one, two = (buffer.sample_transitions(12, "random", ratio=2) for buffer in (frames, channels))
    pairs += [(getattr(one, name), getattr(two, name)) for name in ("observations", "next_observations")]
    pairs += [(one.goals, two.goals)]
    np.testing.assert_array_equal(one.rewards, two.rewards)
    one, two = (buffer.sample_windows(5, 2, 1, "final") for buffer in (frames, channels))
    pairs += [(one.observations, two.observations), (one.goals, two.goals)]
    for expected, found in pairs:
        np.testing.assert_array_equal(as_channels(expected), found)


def test_the_oldest_frame_comes_first_of_each_pixel() -> None:
    buffer = vhs.EpisodeBuffer(
        (1, 2, 3), num_streams=1, max_episode_steps=1, capacity_steps=1, stacking="channels"
    )
    buffer.begin(0, np.arange(6, dtype=np.uint8).reshape(1, 2, 3))
    buffer.append(0, 0, 0.0, 0.0, np.arange(10, 16, dtype=np.uint8).reshape(1, 2, 3))
    out = np.zeros((1, 1, 2, 6), np.uint8)
    assert buffer.observe(out=out) is out
    assert out.ravel().tolist() == [0, 1, 2, 10, 11, 12, 3, 4, 5, 13, 14, 15]


def test_a_store_collects_what_its_buffer_shows(tmp_path: Path) -> None:
    sizes = (2, 4, 5, 3)
    frames, channels = (recorded(stacking, sizes, "uint8", "labels") for stacking in ("frames", "channels"))
    stacks, pictures = (vhs.GoalStore(1, b.observation_shape, 8, seed=3) for b in (frames, channels))
    assert stacks.collect(frames, [0, 1]) == pictures.collect(channels, [0, 1]) == 2
    with pytest.raises(vhs.ShapeError, match=r"expected shape \[2, 4, 5, 3\], got \[4, 5, 6\]"):
        stacks.collect(channels, [0])
    stacks.save(tmp_path / "stacks")
    for mmap in (False, True):
        loaded = vhs.GoalStore.load(tmp_path / "stacks", stacking="channels", mmap=mmap)
        assert loaded.observation_shape == (4, 5, 6)
        loaded.save(tmp_path / "pictures")
        pictures.save(tmp_path / "expected")
        assert (tmp_path / "pictures").read_bytes() == (tmp_path / "expected").read_bytes()
    again = vhs.GoalStore.load(tmp_path / "pictures", stacking="channels")
    np.testing.assert_array_equal(again.sample_class(0, 9), pictures.sample_class(0, 9))
    vhs.GoalStore.verify(tmp_path / "stacks")  # what was mapped was never written to


def test_a_loaded_buffer_stacks_as_the_saved_one(tmp_path: Path) -> None:
    buffer = recorded("channels", (2, 4, 5, 3), "uint8", "observations")
    buffer.save(tmp_path / "buffer")
    loaded = vhs.EpisodeBuffer.load(tmp_path / "buffer")
    assert loaded.stacking == "channels"
    np.testing.assert_array_equal(loaded.gather([0]).observations, buffer.gather([0]).observations)
