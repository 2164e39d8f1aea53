"""Hindsight is what makes the difference: the same learner, the same buffer, with it and without."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from .examples import load

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300), pytest.mark.usefixtures("_one_thread")]


@pytest.fixture
def _one_thread() -> Iterator[None]:
    torch = pytest.importorskip("torch", reason="the examples' learners need vhs[train]")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def test_bit_flipping_is_learned_with_hindsight_and_not_without() -> None:
    example = load("bit_flipping")
    assert example.train(8, 300, hindsight=True) >= 0.9
    assert example.train(8, 300, hindsight=False) <= 0.3


def test_colours_are_reached_more_often_by_imitation_in_hindsight() -> None:
    example = load("self_imitation")
    # Seeds 0 to 2: 0.46 to 0.53 with it, 0.20 to 0.25 without; one tile of seven by chance.
    assert example.train(3000, hindsight=True) >= 0.38
    assert example.train(3000, hindsight=False) <= 0.32
