"""The goal-discriminator's cross-entropy against numbers by hand."""

import math

import pytest
import torch

from vhs import ShapeError
from vhs.losses import goal_discrimination_loss


def test_cross_entropy_by_hand() -> None:
    logits = torch.tensor([[0.0, 0.0, 0.0], [math.log(6.0), 0.0, 0.0]])
    # p = 1/3 of the right class, then 6/8
    expected = -(math.log(1 / 3) + math.log(6 / 8)) / 2
    assert goal_discrimination_loss(logits, torch.tensor([2, 0])).item() == pytest.approx(expected)


def test_gradient_is_the_difference_of_probabilities() -> None:
    logits = torch.zeros(1, 4, dtype=torch.float64, requires_grad=True)
    goal_discrimination_loss(logits, torch.tensor([1])).backward()
    torch.testing.assert_close(logits.grad, torch.tensor([[0.25, -0.75, 0.25, 0.25]], dtype=torch.float64))


def test_no_image_costs_nothing() -> None:
    logits = torch.zeros(0, 4, requires_grad=True)
    loss = goal_discrimination_loss(logits, torch.zeros(0, dtype=torch.int64))
    loss.backward()
    assert loss.item() == 0.0


def test_labels_that_do_not_fit_are_named() -> None:
    with pytest.raises(ShapeError, match=r"`labels`: expected shape \[N=2\], found \[3\]"):
        goal_discrimination_loss(torch.zeros(2, 4), torch.zeros(3, dtype=torch.int64))
