"""The pull towards the uniform policy: by hand, and where the entropy has none left."""

import math

import pytest
import torch
from torch import Tensor

from vhs import ShapeError
from vhs.losses import policy_spread_loss


def of_logits(logits: Tensor, valid: Tensor | None = None) -> Tensor:
    log_probs = logits.log_softmax(-1)
    return policy_spread_loss(log_probs, torch.ones(logits.shape[:2]) if valid is None else valid)


def test_by_hand() -> None:
    log_probs = torch.log(torch.tensor([[[0.5, 0.5], [0.9, 0.1]]]))
    expected = (0.0 - (math.log(0.9) + math.log(0.1)) / 2 - math.log(2)) / 2
    assert policy_spread_loss(log_probs, torch.ones(1, 2)).item() == pytest.approx(expected, rel=1e-5)


def test_the_uniform_policy_costs_nothing_and_every_other_something() -> None:
    assert of_logits(torch.zeros(1, 1, 4)).item() == pytest.approx(0.0, abs=1e-6)
    assert of_logits(torch.tensor([[[0.0, 0.0, 0.0, 1.0]]])).item() > 0


def test_an_action_that_died_out_is_pulled_back_as_hard_as_any() -> None:
    logits = torch.tensor([[[20.0, 0.0, 0.0, 0.0]]], requires_grad=True)
    of_logits(logits).backward()
    torch.testing.assert_close(logits.grad, torch.tensor([[[0.75, -0.25, -0.25, -0.25]]]))
    entropy_logits = logits.detach().clone().requires_grad_()
    log_probs = entropy_logits.log_softmax(-1)
    (log_probs.exp() * log_probs).sum().backward()
    assert entropy_logits.grad is not None
    assert entropy_logits.grad.abs().max() < 1e-6, "the entropy has let go"


def test_steps_after_the_end_change_nothing() -> None:
    logits = torch.randn(2, 3, 4, generator=torch.Generator().manual_seed(0))
    valid = torch.tensor([[1.0, 1.0, 1.0], [1.0, 0.0, 0.0]])
    before = of_logits(logits, valid)
    logits[1, 1:] = 50 * torch.eye(4)[:2]
    torch.testing.assert_close(of_logits(logits, valid), before)


def test_tensors_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ShapeError, match="`valid`: expected shape"):
        of_logits(torch.zeros(1, 2, 3), torch.ones(1, 3))
