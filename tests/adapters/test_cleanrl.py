"""The examples in CleanRL's shape learn with our buffer."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch", reason="the examples' learners need it")

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture
def examples(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "examples")
    return importlib.import_module


def test_its_dqn_flips_bits(examples: Any) -> None:
    dqn = examples("cleanrl_dqn")
    assert dqn.train(dqn.Args(bits=6, total_timesteps=2500)) > 0.8


def test_its_sac_brings_a_point_to_another(examples: Any) -> None:
    sac = examples("cleanrl_sac")
    assert sac.train(sac.Args(total_timesteps=2500, batch_size=128)) > 0.6
