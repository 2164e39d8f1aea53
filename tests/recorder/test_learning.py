"""Hindsight is what makes the difference: the same learner, the same buffer, with it and without."""

from __future__ import annotations

import pytest

from .examples import load


@pytest.mark.timeout(300)
def test_bit_flipping_is_learned_with_hindsight_and_not_without() -> None:
    torch = pytest.importorskip("torch", reason="the example's learner needs vhs[train]")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    example = load("bit_flipping")
    try:
        assert example.train(8, 300, hindsight=True) >= 0.9
        assert example.train(8, 300, hindsight=False) <= 0.3
    finally:
        torch.set_num_threads(threads)
