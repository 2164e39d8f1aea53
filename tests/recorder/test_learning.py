"""Hindsight is what makes the difference: the same learner, the same buffer, with it and without."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "bit_flipping.py"


@pytest.mark.timeout(300)
def test_bit_flipping_is_learned_with_hindsight_and_not_without() -> None:
    torch = pytest.importorskip("torch", reason="the example's learner needs vhs[train]")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    spec = importlib.util.spec_from_file_location("bit_flipping", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    try:
        assert example.train(8, 300, hindsight=True) >= 0.9
        assert example.train(8, 300, hindsight=False) <= 0.3
    finally:
        torch.set_num_threads(threads)
