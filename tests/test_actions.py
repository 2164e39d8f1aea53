"""Actions: stored as numbers or reals, done as the environment's space has them, and back."""

import numpy as np
import pytest
from gymnasium import spaces

import vhs
from vhs.actions import ActionSizes, action_array, action_sizes, doer, shown_space, stored_action

NUMBERED = [
    spaces.Discrete(5, start=-2),
    spaces.MultiDiscrete([2, 3, 2]),
    spaces.MultiDiscrete([[2, 3], [1, 4]], start=[[1, 0], [7, -2]]),
    spaces.MultiBinary(3),
]


@pytest.mark.parametrize("space", NUMBERED, ids=str)
def test_every_number_is_an_action_of_its_own_and_comes_back(space: spaces.Space) -> None:
    sizes, do = action_sizes(space), doer(space)
    done = [do(np.int64(number)) for number in range(sizes.num_actions)]
    assert all(space.contains(one) or space.contains(np.int64(one)) for one in done)
    assert len({np.asarray(one).tobytes() for one in done}) == sizes.num_actions
    assert [stored_action(one, space) for one in done] == list(range(sizes.num_actions))
    assert shown_space(space) == spaces.Discrete(sizes.num_actions)


def test_the_last_of_several_choices_counts_fastest() -> None:
    assert action_sizes(spaces.MultiDiscrete([2, 3])) == ActionSizes(6, (2, 3))
    assert doer(spaces.MultiDiscrete([2, 3]))(4).tolist() == [1, 1]


def test_real_numbers_reach_from_bound_to_bound() -> None:
    space = spaces.Box(np.array([[-2.0, 0.0]], np.float32), np.array([[2.0, 10.0]], np.float32))
    assert action_sizes(space) == ActionSizes(1, (), 2)
    assert shown_space(space) == spaces.Box(-1, 1, (2,), np.float32)
    do = doer(space)
    for action, expected in (([-1, 1], [[-2, 10]]), ([0, 0], [[0, 5]]), ([0.5, -0.5], [[1, 2.5]])):
        found = do(np.array(action, np.float32))
        assert space.contains(found)
        np.testing.assert_allclose(found, expected)


def test_arrays_keep_the_axis_of_actions_when_there_is_none() -> None:
    assert action_array([], 0).shape == (0,)
    assert action_array([], 3).shape == (0, 3)
    assert action_array([[0.5, 1.0]], 2).dtype == np.float32


@pytest.mark.parametrize(
    ("space", "message"),
    [
        (spaces.Text(3), "`env`: expected Discrete, MultiDiscrete, MultiBinary or Box actions, got Text"),
        (
            spaces.MultiBinary(31),
            "`env`: expected fewer than 2147483648 combinations of actions, got 2147483648",
        ),
    ],
)
def test_a_space_that_nothing_can_store_is_refused(space: spaces.Space, message: str) -> None:
    with pytest.raises(vhs.ArgumentError, match=message):
        action_sizes(space)


def test_real_numbers_without_bounds_are_refused_to_policies_alone() -> None:
    space = spaces.Box(-np.inf, np.inf, (2,))
    assert action_sizes(space).action_dim == 2
    with pytest.raises(vhs.ArgumentError, match="`env`: expected continuous actions between finite bounds"):
        doer(space)
