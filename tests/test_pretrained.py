"""The agents that we ship: small, and still able to do their task."""

from pathlib import Path

import pytest

from vhs.eval import evaluate, read_evaluations

pytestmark = pytest.mark.slow

PRETRAINED = Path(__file__).parent.parent / "pretrained"
TASKS = ("task1", "task2", "task3")
MOST_BYTES = 4_000_000


@pytest.mark.parametrize("task", TASKS)
def test_an_agent_is_small_enough_to_ship(task: str) -> None:
    assert (PRETRAINED / task / "agent.safetensors").stat().st_size <= MOST_BYTES


@pytest.mark.parametrize("task", TASKS)
def test_an_agent_succeeds_as_often_as_its_evaluation_claims(task: str) -> None:
    """In 300 episodes; on the arithmetic of the evaluation the same ones, on another a few end otherwise."""
    claims = [entry for entry in read_evaluations(PRETRAINED / task) if not entry["greedy"]]
    claim = min(claims, key=lambda entry: entry["seed"])
    found = evaluate(PRETRAINED / task, episodes=claim["episodes"], seed=claim["seed"])
    assert found.success >= claim["success"] - 0.02, (found, claim)
    assert found.trained_episodes == claim["trained_episodes"]
