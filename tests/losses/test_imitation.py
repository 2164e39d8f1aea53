"""The hindsight self-imitation terms against numbers by hand, finite differences and padding."""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from vhs import ShapeError
from vhs.losses import ImitationTerms, hindsight_imitation_loss
from vhs.models import Categorical


def loss_of(log_probs: Tensor, actions: Tensor, *rest: Any, **named: Any) -> ImitationTerms:
    """The terms of a policy over numbered actions."""
    taken = Categorical(log_probs.shape[-1]).log_prob(log_probs, actions)
    return hindsight_imitation_loss(taken, *rest, **named)


def test_one_episode_by_hand() -> None:
    terms = loss_of(
        torch.log(torch.tensor([[[0.5, 0.5], [0.2, 0.8]]])),
        actions=torch.tensor([[1, 0]]),
        values=torch.tensor([[1.0, 2.0]]),
        value_targets=torch.tensor([[0.5, 0.0]]),
        valid=torch.ones(1, 2),
        steps=torch.tensor(4.0),
    )
    assert terms.policy.item() == pytest.approx(-(math.log(0.5) + math.log(0.2)) / 4)
    assert terms.value.item() == pytest.approx((0.25 + 4.0) / 4)


def random_case() -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    return (
        torch.randn(2, 3, 4, generator=generator, dtype=torch.float64),
        torch.randint(0, 4, (2, 3), generator=generator),
        torch.randn(2, 3, generator=generator, dtype=torch.float64),
        torch.randn(2, 3, generator=generator, dtype=torch.float64),
        torch.tensor([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0]], dtype=torch.float64),
        torch.tensor(5.0, dtype=torch.float64),
    )


def test_gradient_reaches_log_probs_and_values() -> None:
    logits, actions, values, targets, valid, steps = random_case()

    def loss(logits: Tensor, values: Tensor) -> Tensor:
        terms = loss_of(logits.log_softmax(-1), actions, values, targets, valid, steps)
        return terms.policy + terms.value

    assert torch.autograd.gradcheck(loss, (logits.requires_grad_(), values.requires_grad_()))


def test_the_value_target_is_a_constant() -> None:
    logits, actions, values, targets, valid, steps = random_case()
    targets.requires_grad_()
    terms = loss_of(logits.log_softmax(-1), actions, values.requires_grad_(), targets, valid, steps)
    (terms.policy + terms.value).backward()
    assert targets.grad is None


def test_padding_changes_nothing() -> None:
    logits, actions, values, targets, valid, steps = random_case()
    log_probs = logits.log_softmax(-1)
    before = loss_of(log_probs, actions, values, targets, valid, steps)
    after = loss_of(
        log_probs,
        actions,
        values.masked_fill(valid == 0, 99.0),
        targets.masked_fill(valid == 0, -99.0),
        valid,
        steps,
    )
    assert [term.item() for term in before] == pytest.approx([term.item() for term in after])


def test_an_impossible_action_after_the_end_changes_nothing() -> None:
    logits = torch.tensor([[[0.0, 0.0], [0.0, -torch.inf]]], requires_grad=True)
    valid, zeros = torch.tensor([[1.0, 0.0]]), torch.zeros(1, 2)
    terms = loss_of(logits.log_softmax(-1), torch.tensor([[0, 1]]), zeros, zeros, valid, valid.sum())
    assert terms.policy.item() == pytest.approx(math.log(2))
    terms.policy.backward()
    assert logits.grad is not None
    assert torch.equal(logits.grad[:, 1], torch.zeros(1, 2))


def test_no_step_costs_nothing() -> None:
    nothing = torch.zeros(0, 3)
    terms = loss_of(torch.zeros(0, 3, 4), nothing.long(), nothing, nothing, nothing, torch.tensor(0))
    assert [term.item() for term in terms] == [0.0, 0.0]


def test_mismatched_shapes_are_refused_by_name() -> None:
    logits, actions, values, targets, valid, steps = random_case()
    with pytest.raises(ShapeError, match=r"`value_targets`: expected shape \[B=2, T=3\], found \[2, 2\]"):
        loss_of(logits.log_softmax(-1), actions, values, targets[:, :2], valid, steps)


def test_discounted_imitation_weighs_actions_by_their_distance_to_the_end() -> None:
    log_probs = torch.log(torch.tensor([[[0.5, 0.5], [0.5, 0.5], [0.5, 0.5]], [[0.5, 0.5]] * 3]))
    valid = torch.tensor([[1.0, 1.0, 1.0], [1.0, 0.0, 0.0]])
    zeros = torch.zeros(2, 3)
    terms = loss_of(log_probs, zeros.long(), zeros, zeros, valid, torch.tensor(4), discount=0.5)
    # Episodes of three steps and of one: weights 1/4, 1/2, 1 and 1, over 4 steps.
    torch.testing.assert_close(terms.policy, torch.log(torch.tensor(2.0)) * 2.75 / 4)
