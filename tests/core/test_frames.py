"""Stacked frames as channels, against numpy's own transposition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import vhs


@given(st.tuples(*[st.integers(0, 4), *[st.integers(1, 5)] * 4]), st.integers(0, 2**32 - 1))
def test_equals_a_transposition(shape: tuple[int, ...], seed: int) -> None:
    observations = np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)
    count, stack, height, width, colours = shape
    expected = observations.transpose(0, 2, 3, 1, 4).reshape(count, height, width, stack * colours)
    np.testing.assert_array_equal(vhs.stack_channels(observations), expected)


def test_writes_into_out() -> None:
    observations = np.arange(24, dtype=np.uint8).reshape(1, 2, 2, 2, 3)
    out = np.zeros((1, 2, 2, 6), np.uint8)
    assert vhs.stack_channels(observations, out=out) is out
    assert out[0, 0, 0].tolist() == [0, 1, 2, 12, 13, 14]


def test_another_number_of_axes_is_refused() -> None:
    with pytest.raises(
        vhs.ShapeError, match=r"expected shape \[N, stack, height, width, colours\], got \[2, 3\]"
    ):
        vhs.stack_channels(np.zeros((2, 3), np.uint8))


def test_another_type_is_refused() -> None:
    with pytest.raises(vhs.DtypeError, match="`observations`: expected uint8, got float32"):
        vhs.stack_channels(np.zeros((1, 2, 3, 3, 3), np.float32))  # type: ignore[arg-type]


def test_an_out_that_does_not_fit_is_refused_and_left_alone() -> None:
    out = np.full((1, 2, 2, 5), 7, np.uint8)
    with pytest.raises(vhs.ShapeError, match="`out`: expected shape"):
        vhs.stack_channels(np.zeros((1, 2, 2, 2, 3), np.uint8), out=out)
    assert (out == 7).all()
