"""Action heads against distributions that torch has, exact sums and samples."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.distributions import Independent, Normal, TanhTransform, TransformedDistribution

from vhs.models import ActionHead, Categorical, MultiCategorical, SquashedNormal

HEADS = [Categorical(4), MultiCategorical((2, 3, 2)), SquashedNormal(2)]


def random_parameters(head: ActionHead, rows: int = 5, seed: int = 0) -> Tensor:
    outputs = torch.randn(rows, head.size, generator=torch.Generator().manual_seed(seed))
    return head.parameters(outputs)


def repeated(row: Tensor, times: int) -> Tensor:
    return row.unsqueeze(0).expand(times, -1)


@pytest.mark.parametrize("head", HEADS, ids=lambda head: type(head).__name__)
def test_entropy_is_the_mean_surprise_of_samples(head: ActionHead) -> None:
    for row in random_parameters(head, 3):
        many = repeated(row, 40_000)
        actions = head.sample(many, torch.Generator().manual_seed(1))
        surprise = -head.log_prob(many, actions)
        assert surprise.mean().item() == pytest.approx(head.entropy(row).item(), abs=0.02)


@pytest.mark.parametrize("head", HEADS, ids=lambda head: type(head).__name__)
def test_the_same_generator_samples_the_same_and_a_batch_is_its_rows(head: ActionHead) -> None:
    parameters = random_parameters(head)
    first, again = (head.sample(parameters, torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(first, again)
    joined = head.log_prob(parameters.unsqueeze(0), first.unsqueeze(0))[0]
    alone = [head.log_prob(p, a) for p, a in zip(parameters, first, strict=True)]
    torch.testing.assert_close(joined, torch.stack(alone))
    assert head.entropy(parameters.unsqueeze(0)).shape == (1, 5)


@pytest.mark.parametrize("head", HEADS, ids=lambda head: type(head).__name__)
def test_raising_what_was_done_moves_the_mode_to_it(head: ActionHead) -> None:
    outputs = torch.zeros(1, head.size, requires_grad=True)
    wanted = head.sample(random_parameters(head, 1, seed=4), torch.Generator().manual_seed(5))
    optimiser = torch.optim.Adam([outputs], lr=0.1)
    for _ in range(150):
        optimiser.zero_grad()
        (-head.log_prob(head.parameters(outputs), wanted).sum()).backward()
        optimiser.step()
    found = head.mode(head.parameters(outputs.detach()))
    torch.testing.assert_close(found.double(), wanted.double(), atol=0.02, rtol=0)


@pytest.mark.parametrize("head", HEADS, ids=lambda head: type(head).__name__)
def test_gradients(head: ActionHead) -> None:
    outputs = torch.randn(3, head.size, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    actions = head.sample(random_parameters(head, 3), torch.Generator().manual_seed(6))
    if actions.is_floating_point():
        actions = actions.double()

    def both(outputs: Tensor) -> Tensor:
        parameters = head.parameters(outputs)
        return head.log_prob(parameters, actions) + head.entropy(parameters)

    assert torch.autograd.gradcheck(both, (outputs.requires_grad_(),))


def test_choices_at_once_are_numbered_as_numpy_numbers_them() -> None:
    head = MultiCategorical((2, 3, 2))
    parameters = random_parameters(head, 1)[0]
    total = 0.0
    for number in range(12):
        options = np.unravel_index(number, (2, 3, 2))
        parts = parameters.split((2, 3, 2))
        expected = sum(part[int(option)] for part, option in zip(parts, options, strict=True))
        found = head.log_prob(parameters, torch.tensor(number))
        torch.testing.assert_close(found, torch.as_tensor(expected))
        total += found.exp().item()
    assert total == pytest.approx(1.0, abs=1e-5)
    every = head.log_prob(repeated(parameters, 12), torch.arange(12))
    assert head.mode(parameters.unsqueeze(0)).item() == every.argmax().item()


def test_a_squashed_normal_is_torchs() -> None:
    head = SquashedNormal(2)
    parameters = random_parameters(head)
    mean, std = parameters.chunk(2, -1)
    assert (std > 0).all()
    normal = TransformedDistribution(Normal(mean, std), [TanhTransform()])
    actions = head.sample(parameters, torch.Generator().manual_seed(1))
    assert actions.abs().max() < 1
    expected = Independent(normal, 1).log_prob(actions)
    torch.testing.assert_close(head.log_prob(parameters, actions), expected, atol=1e-4, rtol=1e-4)


def test_a_squashed_normal_starts_nearly_flat() -> None:
    head = SquashedNormal(1)
    parameters = head.parameters(torch.zeros(1, 2))
    assert head.entropy(parameters).item() == pytest.approx(math.log(2), abs=0.05), (
        "uniform in -1..1 is log 2"
    )


def test_the_edges_of_continuous_actions_have_a_finite_density_and_gradient() -> None:
    head = SquashedNormal(2)
    outputs = torch.zeros(3, 4, requires_grad=True)
    actions = torch.tensor([[1.0, -1.0], [0.0, 1.0], [0.999999, -0.5]])
    head.log_prob(head.parameters(outputs), actions).sum().backward()
    assert outputs.grad is not None
    assert torch.isfinite(outputs.grad).all()
    far = head.parameters(torch.tensor([[30.0, -30.0, 9.0, -40.0]]))
    assert torch.isfinite(head.entropy(far)).all()
    assert torch.isfinite(head.log_prob(far, head.mode(far))).all()
