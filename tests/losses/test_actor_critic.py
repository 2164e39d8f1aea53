"""The actor-critic terms against numbers by hand, finite differences and padding."""

import math

import pytest
import torch
from torch import Tensor

from vhs import ShapeError
from vhs.losses import ActorCriticTerms, actor_critic_loss
from vhs.models import Categorical


def loss_of(
    log_probs: Tensor, actions: Tensor, values: Tensor, returns: Tensor, valid: Tensor
) -> ActorCriticTerms:
    """The terms of a policy over numbered actions."""
    head = Categorical(log_probs.shape[-1])
    taken, entropy = head.log_prob(log_probs, actions), head.entropy(log_probs)
    return actor_critic_loss(taken, entropy, values, returns, valid)


def test_one_episode_by_hand() -> None:
    log_probs = torch.log(torch.tensor([[[0.5, 0.5], [0.25, 0.75]]]))
    terms = loss_of(
        log_probs,
        actions=torch.tensor([[0, 1]]),
        values=torch.tensor([[1.0, 0.0]]),
        returns=torch.tensor([[3.0, -1.0]]),
        valid=torch.ones(1, 2),
    )
    # advantages 2 and -1
    assert terms.policy.item() == pytest.approx(-(math.log(0.5) * 2 - math.log(0.75)) / 2)
    assert terms.value.item() == pytest.approx((4 + 1) / 2)
    entropy = [math.log(2), -(0.25 * math.log(0.25) + 0.75 * math.log(0.75))]
    assert terms.entropy.item() == pytest.approx(sum(entropy) / 2)


def random_case(seed: int = 0) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return {
        "logits": torch.randn(2, 3, 4, generator=generator, dtype=torch.float64),
        "actions": torch.randint(0, 4, (2, 3), generator=generator),
        "values": torch.randn(2, 3, generator=generator, dtype=torch.float64),
        "returns": torch.randn(2, 3, generator=generator, dtype=torch.float64),
        "valid": torch.tensor([[1.0, 1.0, 1.0], [1.0, 0.0, 0.0]], dtype=torch.float64),
    }


def test_gradient_of_policy_and_entropy() -> None:
    case = random_case()

    def loss(logits: Tensor) -> Tensor:
        terms = loss_of(
            logits.log_softmax(-1), case["actions"], case["values"], case["returns"], case["valid"]
        )
        return terms.policy - 0.01 * terms.entropy

    assert torch.autograd.gradcheck(loss, (case["logits"].requires_grad_(),))


def test_gradient_of_the_value_term_alone_reaches_the_values() -> None:
    case = random_case()
    values = case["values"].requires_grad_()
    log_probs = case["logits"].log_softmax(-1)

    def value_term(v: Tensor) -> Tensor:
        return loss_of(log_probs, case["actions"], v, case["returns"], case["valid"]).value

    assert torch.autograd.gradcheck(value_term, (values,))
    policy = loss_of(log_probs, case["actions"], values, case["returns"], case["valid"]).policy
    assert not policy.requires_grad, "the advantage must be a constant of the policy gradient"


def test_padding_changes_nothing() -> None:
    case = random_case()
    log_probs = case["logits"].log_softmax(-1)
    before = loss_of(log_probs, case["actions"], case["values"], case["returns"], case["valid"])
    garbage = case["valid"] == 0
    after = loss_of(
        torch.where(garbage.unsqueeze(-1), torch.full_like(log_probs, -7.0), log_probs),
        case["actions"],
        case["values"].masked_fill(garbage, 99.0),
        case["returns"].masked_fill(garbage, -99.0),
        case["valid"],
    )
    for old, new in zip(before, after, strict=True):
        assert old.item() == pytest.approx(new.item(), rel=1e-12)


def test_an_impossible_action_adds_nothing_to_the_entropy_and_gets_no_gradient() -> None:
    impossible = -torch.inf
    logits = torch.tensor([[[0.0, 0.0, impossible], [0.0, 1.0, impossible]]], requires_grad=True)
    ones = torch.ones(1, 2)
    terms = loss_of(logits.log_softmax(-1), torch.tensor([[0, 1]]), ones, ones, ones)
    possible = logits.detach()[..., :2].clone().requires_grad_()
    expected = loss_of(possible.log_softmax(-1), torch.tensor([[0, 1]]), ones, ones, ones)
    torch.testing.assert_close(terms.entropy, expected.entropy)
    terms.entropy.backward()
    expected.entropy.backward()
    assert logits.grad is not None
    torch.testing.assert_close(logits.grad[..., :2], possible.grad)
    assert torch.equal(logits.grad[..., 2], torch.zeros(1, 2))


def test_an_impossible_action_after_the_end_changes_nothing() -> None:
    logits = torch.tensor([[[0.0, 0.0], [0.0, -torch.inf]]], requires_grad=True)
    terms = loss_of(
        logits.log_softmax(-1),
        actions=torch.tensor([[0, 1]]),
        values=torch.zeros(1, 2),
        returns=torch.ones(1, 2),
        valid=torch.tensor([[1.0, 0.0]]),
    )
    assert terms.policy.item() == pytest.approx(math.log(2))
    terms.policy.backward()
    assert logits.grad is not None
    assert torch.equal(logits.grad[:, 1], torch.zeros(1, 2))


def test_no_step_costs_nothing() -> None:
    nothing = torch.zeros(0, 0)
    terms = loss_of(torch.zeros(0, 0, 4), torch.zeros(0, 0, dtype=torch.int64), nothing, nothing, nothing)
    assert [term.item() for term in terms] == [0.0, 0.0, 0.0]


def test_mismatched_shapes_are_refused_by_name() -> None:
    with pytest.raises(ShapeError, match=r"`returns`: expected shape \[B=1, T=2\], found \[1, 3\]"):
        actor_critic_loss(*torch.zeros(3, 1, 2), torch.zeros(1, 3), torch.ones(1, 2))
