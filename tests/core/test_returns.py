"""Discounted returns against their definition as a sum."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

import vhs

from . import naive


@given(
    hnp.arrays(np.float32, (4, 6), elements=st.floats(-10, 10, width=32)),
    hnp.arrays(np.int64, 4, elements=st.integers(0, 6)),
    st.floats(0, 1),
)
def test_returns_are_the_discounted_sums(
    rewards: NDArray[np.float32], lengths: NDArray[np.int64], gamma: float
) -> None:
    found = vhs.discounted_returns(rewards, lengths, gamma)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, naive.returns(rewards, lengths, gamma), rtol=1e-5, atol=1e-5)
    out = np.full(rewards.shape, 9, np.float32)
    assert vhs.discounted_returns(rewards, lengths, gamma, out=out) is out
    np.testing.assert_array_equal(out, found)


def test_padding_is_neither_read_nor_kept() -> None:
    rewards = np.array([[1.0, np.nan], [1.0, 1.0]], np.float32)
    assert vhs.discounted_returns(rewards, [1, 2], 0.5).tolist() == [[1.0, 0.0], [1.5, 1.0]]


def test_nothing_has_no_returns() -> None:
    assert vhs.discounted_returns(np.zeros((0, 3)), [], 0.5).shape == (0, 3)
    assert vhs.discounted_returns(np.zeros((2, 0)), [0, 0], 0.5).shape == (2, 0)
