"""SupCon against numbers by hand, a second implementation in plain Python, and its own gradient."""

import math

import pytest
import torch

from vhs import ShapeError
from vhs.losses import supcon_loss


def naive_supcon(features: list[list[float]], labels: list[int], temperature: float) -> float:
    """Paper Eq. 3 with for-loops, as a mean over the anchors that have a positive."""
    unit = [[x / math.hypot(*row) for x in row] for row in features]

    def similarity(j: int, h: int) -> float:
        return sum(a * b for a, b in zip(unit[j], unit[h], strict=True)) / temperature

    losses = []
    for j in range(len(unit)):
        others = [h for h in range(len(unit)) if h != j]
        positives = [p for p in others if labels[p] == labels[j]]
        if not positives:
            continue
        denominator = sum(math.exp(similarity(j, h)) for h in others)
        losses.append(
            -sum(math.log(math.exp(similarity(j, p)) / denominator) for p in positives) / len(positives)
        )
    return sum(losses) / len(losses)


def test_two_aligned_pairs_by_hand() -> None:
    features = torch.tensor([[2.0, 0.0], [1.0, 0.0], [0.0, 3.0], [0.0, 1.0]])
    labels = torch.tensor([0, 0, 1, 1])
    # Each anchor: positive at similarity 1, two negatives at 0; temperature 1: -log(e / (e + 2)).
    expected = -math.log(math.e / (math.e + 2))
    assert supcon_loss(features, labels, 1.0).item() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("temperature", [0.07, 0.5])
@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_the_naive_formula(seed: int, temperature: float) -> None:
    generator = torch.Generator().manual_seed(seed)
    features = torch.randn(13, 6, generator=generator, dtype=torch.float64)
    labels = torch.randint(0, 4, (13,), generator=generator)
    expected = naive_supcon(features.tolist(), labels.tolist(), temperature)
    assert supcon_loss(features, labels, temperature).item() == pytest.approx(expected, rel=1e-9)


def test_gradient_is_that_of_the_formula() -> None:
    features = torch.randn(
        7, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0), requires_grad=True
    )
    labels = torch.tensor([0, 0, 1, 1, 1, 2, 3])
    assert torch.autograd.gradcheck(lambda f: supcon_loss(f, labels, 0.3), (features,))


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_images_for_a_pair_cost_nothing(count: int) -> None:
    features = torch.ones(count, 4, requires_grad=True)
    loss = supcon_loss(features, torch.zeros(count, dtype=torch.int64), 0.07)
    loss.backward()
    assert loss.item() == 0.0
    assert torch.equal(features.grad, torch.zeros(count, 4))


def test_no_positive_pair_costs_nothing_and_gives_no_gradient() -> None:
    features = torch.randn(3, 4, generator=torch.Generator().manual_seed(0), requires_grad=True)
    loss = supcon_loss(features, torch.tensor([0, 1, 2]), 0.07)
    loss.backward()
    assert loss.item() == 0.0
    assert features.grad is not None
    assert torch.equal(features.grad, torch.zeros_like(features))


def test_floor_of_a_balanced_batch_is_the_log_of_its_positives() -> None:
    labels = torch.arange(64) % 5
    features = torch.nn.functional.one_hot(labels, 8).double()
    # 12 or 11 positives at equal similarity, negatives at e^(-1/0.07): about log(12), the floor that training
    # reaches.
    assert supcon_loss(features, labels, 0.07).item() == pytest.approx(2.46, abs=0.03)


def test_mismatched_shapes_are_refused_by_name() -> None:
    with pytest.raises(ShapeError, match=r"`labels`: expected shape \[N=3\], found \[4\]"):
        supcon_loss(torch.zeros(3, 2), torch.zeros(4, dtype=torch.int64), 0.07)
