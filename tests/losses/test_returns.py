"""TD(lambda) returns: by hand, against Monte-Carlo, and what lies after the end."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from vhs import ShapeError, discounted_returns
from vhs.losses import lambda_returns

REWARDS = torch.tensor([[1.0, 2.0, 4.0], [8.0, 1.0, 9.0]])
VALUES = torch.tensor([[10.0, 20.0, 40.0], [80.0, 10.0, 90.0]])
VALID = torch.tensor([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0]])


def test_by_hand() -> None:
    # Row 0: R_2 = 4; R_1 = 2 + .5 (.75 * 40 + .25 * 4) = 17.5; R_0 = 1 + .5 (.75 * 20 + .25 * 17.5).
    # Row 1 ends after two steps: R_1 = 1; R_0 = 8 + .5 (.75 * 10 + .25 * 1).
    found = lambda_returns(REWARDS, VALUES, VALID, gamma=0.5, mixing=0.25)
    expected = torch.tensor([[10.6875, 17.5, 4.0], [11.875, 1.0, 0.0]])
    torch.testing.assert_close(found, expected)


@given(
    st.integers(1, 4),
    st.integers(1, 12),
    st.sampled_from([0.0, 0.5, 0.99, 1.0]),
    st.sampled_from([0.0, 0.3, 0.95, 1.0]),
    st.integers(0, 99),
)
def test_they_are_those_of_the_recursion(
    episodes: int, steps: int, gamma: float, mixing: float, seed: int
) -> None:
    draw = np.random.default_rng(seed)
    rewards, values = torch.from_numpy(draw.normal(size=(2, episodes, steps)))
    beyond = torch.from_numpy(draw.normal(size=episodes))
    lengths = draw.integers(1, steps + 1, episodes)
    valid = torch.from_numpy((np.arange(steps) < lengths[:, None]).astype(np.float64))
    found = lambda_returns(rewards, values, valid, gamma, mixing, beyond)
    expected = torch.zeros_like(rewards)
    for row, length in enumerate(lengths.tolist()):
        value = following = beyond[row]
        for step in reversed(range(length)):
            following = rewards[row, step] + gamma * ((1 - mixing) * value + mixing * following)
            expected[row, step], value = following, values[row, step]
    torch.testing.assert_close(found, expected)


def test_lambda_1_is_monte_carlo() -> None:
    found = lambda_returns(REWARDS, VALUES, VALID, gamma=0.9, mixing=1.0)
    np.testing.assert_allclose(found, discounted_returns(REWARDS.numpy(), [3, 2], 0.9), rtol=1e-6)


def test_what_lies_after_the_end_changes_nothing() -> None:
    before = lambda_returns(REWARDS, VALUES, VALID, gamma=0.9, mixing=0.5)
    rewards, values = REWARDS.clone(), VALUES.clone()
    rewards[1, 2], values[1, 2] = 7777.0, -7777.0
    torch.testing.assert_close(lambda_returns(rewards, values, VALID, 0.9, 0.5), before)


def test_no_gradient_reaches_the_values() -> None:
    values = VALUES.clone().requires_grad_()
    assert not lambda_returns(REWARDS, values, VALID, gamma=0.9, mixing=0.5).requires_grad


def test_tensors_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ShapeError, match="`values`: expected shape"):
        lambda_returns(REWARDS, VALUES[:, :2], VALID, gamma=0.9, mixing=0.5)


@pytest.mark.parametrize("mixing", [0.0, 0.6, 1.0])
def test_what_a_limit_cut_off_is_worth_what_the_critic_says(mixing: float) -> None:
    rewards = torch.tensor([[1.0, 2.0, 3.0], [1.0, 4.0, 99.0]])
    values = torch.tensor([[0.5, 0.25, 1.0], [0.5, 2.0, 99.0]])
    valid = torch.tensor([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0]])
    beyond = torch.tensor([0.0, 8.0], requires_grad=True)
    found = lambda_returns(rewards, values, valid, 0.5, mixing, beyond)
    ended = lambda_returns(rewards, values, valid, 0.5, mixing)
    assert torch.equal(found[0], ended[0]), "the first episode ended its task"
    last = 4.0 + 0.5 * 8.0
    first = 1.0 + 0.5 * ((1 - mixing) * 2.0 + mixing * last)
    torch.testing.assert_close(found[1], torch.tensor([first, last, 0.0]))
    assert not found.requires_grad


def test_what_lies_beyond_has_one_number_an_episode() -> None:
    with pytest.raises(ShapeError, match=r"`beyond`: expected shape \[B=2\], found \[3\]"):
        lambda_returns(*torch.ones(3, 2, 4), 0.5, 1.0, torch.zeros(3))
