"""Dead reckoning against walks that are simulated forwards, in a world of their own."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import vhs

LONGEST = 6
Walk = list[tuple[int, bool]]


def ends(moves: list[tuple[float, float, float]], walk: Walk) -> list[tuple[complex, complex]]:
    """Place and direction before each step and after the last, as complex numbers."""
    place, direction = 2 + 1j, complex(math.cos(0.3), math.sin(0.3))
    poses = [(place, direction)]
    for action, blocked in walk:
        forward, left, turn = moves[action]
        place += 0 if blocked else complex(forward, left) * direction
        direction *= complex(math.cos(turn), math.sin(turn))
        poses.append((place, direction))
    return poses


@given(
    st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-3, 3)), min_size=3, max_size=3),
    st.lists(st.lists(st.tuples(st.integers(0, 2), st.booleans()), max_size=LONGEST), max_size=4),
    st.floats(0, 2),
)
def test_every_step_points_at_what_lay_ahead_of_the_end(
    moves: list[tuple[float, float, float]], walks: list[Walk], ahead_m: float
) -> None:
    actions = np.full((len(walks), LONGEST), -1)
    blocked = np.ones(actions.shape, bool)
    for row, walk in enumerate(walks):
        actions[row, : len(walk)] = [action for action, _ in walk]
        blocked[row, : len(walk)] = [is_blocked for _, is_blocked in walk]
    lengths = [len(walk) for walk in walks]
    bearings, distances = vhs.egomotion(actions, blocked, lengths, moves, ahead_m=ahead_m)
    assert bearings.dtype == distances.dtype == np.float32
    assert bearings.shape == distances.shape == actions.shape
    for row, walk in enumerate(walks):
        *poses, (end, heading) = ends(moves, walk)
        seen = [(end + ahead_m * heading - place) / direction for place, direction in poses]
        found = distances[row] * np.exp(1j * bearings[row].astype(np.float64))
        np.testing.assert_allclose(found[: len(walk)], np.array(seen, complex), atol=1e-4)
        assert not found[len(walk) :].any()


def test_nothing_lies_nowhere() -> None:
    for shape in ((0, 3), (2, 0)):
        bearings, distances = vhs.egomotion(
            np.zeros(shape, int), np.zeros(shape, bool), [0] * shape[0], [[1, 0, 0]]
        )
        assert bearings.shape == distances.shape == shape


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"lengths": [3]}, vhs.LabelError, "`lengths`: expected a number in 0..3, got 3 at index 0"),
        ({"lengths": [2, 2]}, vhs.ShapeError, r"`actions`: expected shape \[2, 2\], got \[1, 2\]"),
        ({"actions": [[0, 2]]}, vhs.LabelError, "`actions`: expected a number in 0..2, got 2 at index 1"),
        ({"blocked": np.zeros((1, 3), bool)}, vhs.ShapeError, r"`blocked`: expected shape \[1, 2\]"),
        ({"blocked": np.zeros((1, 2))}, vhs.DtypeError, "`blocked`: expected bool"),
        ({"moves": [[1.0, 0.0]] * 2}, vhs.ShapeError, r"`moves`: expected shape \[2, 3\], got \[2, 2\]"),
        ({"moves": [[1.0, np.nan, 0], [0, 0, 0]]}, vhs.NonFiniteError, "`moves`"),
        ({"ahead_m": -0.5}, vhs.ArgumentError, "`ahead_m`: expected a finite number of at least 0, got -0.5"),
    ],
)
def test_what_does_not_fit_is_refused(
    change: dict[str, object], error: type[vhs.VhsError], message: str
) -> None:
    good: dict[str, object] = {
        "actions": [[0, 1]],
        "blocked": np.zeros((1, 2), bool),
        "lengths": [2],
        "moves": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
    }
    vhs.egomotion(**good)  # type: ignore[arg-type]
    with pytest.raises(error, match=message):
        vhs.egomotion(**(good | change))  # type: ignore[arg-type]
