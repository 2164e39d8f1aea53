"""The losses on where what was reached had been, against numbers by hand."""

import math

import pytest
import torch
from torch import Tensor

from vhs import ShapeError
from vhs.losses import localisation_loss, memory_loss

VIEW = (0.5, 0.9)
"""In view below, out of it above, in radians."""


def surprise(logit: float, answer: bool) -> float:
    """Nats of a yes or a no at these log-odds."""
    return math.log1p(math.exp(-logit if answer else logit))


def test_cross_entropy_by_hand() -> None:
    logits = torch.zeros(2, 3, 2)
    logits[0, :, 1] = torch.tensor([2.0, -1.0, 3.0])
    logits[1, 0, 0] = 4.0
    bearings = torch.tensor([[0.4, -3.0, 0.7], [-0.49, 0.0, 0.0]])
    valid = torch.tensor([[1.0, 1.0, 1.0], [1.0, 0.0, 0.0]])
    # In view, out of view, at the edge; then in view, and the episode is over.
    expected = (surprise(2.0, True) + surprise(-1.0, False) + surprise(4.0, True)) / 3
    loss = localisation_loss(logits, torch.tensor([1, 0]), bearings, valid, *VIEW)
    assert loss.item() == pytest.approx(expected)


def test_only_the_class_that_was_reached_is_taught() -> None:
    logits = torch.zeros(1, 2, 3, requires_grad=True)
    bearings, valid = torch.tensor([[0.0, 2.0]]), torch.ones(1, 2)
    localisation_loss(logits, torch.tensor([2]), bearings, valid, *VIEW).backward()
    expected = torch.tensor([[[0.0, 0.0, -0.25], [0.0, 0.0, 0.25]]])
    torch.testing.assert_close(logits.grad, expected)


def test_without_an_answer_nothing_is_learned() -> None:
    logits = torch.zeros(1, 1, 3, requires_grad=True)
    aside, valid = torch.full((1, 1), 0.7), torch.ones(1, 1)
    loss = localisation_loss(logits, torch.tensor([0]), aside, valid, *VIEW)
    loss.backward()
    assert loss.item() == 0.0
    assert logits.grad is not None
    assert not logits.grad.any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"labels": torch.zeros(3, dtype=torch.int64)}, r"`labels`: expected shape \[B=2\], found \[3\]"),
        ({"bearings_rad": torch.zeros(2, 4)}, r"`bearings_rad`: expected shape \[B=2, T=5\], found \[2, 4\]"),
        ({"logits": torch.zeros(2, 5)}, r"`logits`: expected shape \[B, T, C\], found \[2, 5\]"),
    ],
)
def test_tensors_that_do_not_fit_are_named(change: dict[str, Tensor], message: str) -> None:
    good = {
        "logits": torch.zeros(2, 5, 3),
        "labels": torch.zeros(2, dtype=torch.int64),
        "bearings_rad": torch.zeros(2, 5),
        "valid": torch.ones(2, 5),
    }
    with pytest.raises(ShapeError, match=message):
        localisation_loss(**(good | change), in_view_rad=0.5, out_of_view_rad=0.9)


def test_memory_is_asked_for_the_sector_that_a_bearing_lies_in() -> None:
    """Against a loop; the first of eight sectors lies around straight ahead, the second to its left."""
    degrees = [[0, 22, 23, 45, 179], [-22, -23, -90, -179, 0]]
    sectors = [[0, 0, 1, 1, 4], [0, 7, 6, 4, 0]]
    logits = torch.randn(2, 5, 8, generator=torch.Generator().manual_seed(0))
    valid = torch.tensor([[1.0, 1, 1, 1, 1], [1, 1, 1, 1, 0]])
    loss = memory_loss(logits, torch.deg2rad(torch.tensor(degrees, dtype=torch.float32)), valid)
    surprises = [
        -float(logits[row, step].log_softmax(0)[sectors[row][step]])
        for row in range(2)
        for step in range(5)
        if valid[row, step]
    ]
    assert float(loss) == pytest.approx(sum(surprises) / len(surprises), rel=1e-5)
    assert memory_loss(logits, torch.zeros(2, 5), torch.zeros(2, 5)) == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"logits": torch.zeros(2, 8)}, "`logits`: expected shape [B, T, S], found [2, 8]"),
        ({"bearings_rad": torch.zeros(2, 4)}, "`bearings_rad`: expected shape [B=2, T=3], found [2, 4]"),
        ({"valid": torch.zeros(3, 3)}, "`valid`: expected shape [B=2, T=3], found [3, 3]"),
    ],
)
def test_what_memory_is_asked_has_to_fit_together(change: dict[str, Tensor], message: str) -> None:
    good = {"logits": torch.zeros(2, 3, 8), "bearings_rad": torch.zeros(2, 3), "valid": torch.ones(2, 3)}
    with pytest.raises(ShapeError) as caught:
        memory_loss(**(good | change))
    assert str(caught.value) == message
