"""The recurrent agent: step by step equals all at once, instructions matter, it starts undecided."""

import pytest
import torch
from torch import Tensor

from vhs.models import Categorical, FeatureExtractor, GoalAgent, RecurrentState


@pytest.fixture
def agent() -> GoalAgent:
    torch.manual_seed(0)
    return GoalAgent(
        FeatureExtractor((16, 16, 3), 2, (4, 4, 4, 4), 8),
        head=Categorical(6),
        num_interactions=3,
        hidden_dim=12,
        head_dim=10,
        interaction_dim=4,
    )


def sequence(batch: int = 2, steps: int = 5) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    features = torch.randn(batch, steps, 8, generator=generator)
    goals = torch.randn(batch, 8, generator=generator)
    return features, goals, torch.arange(batch) % 3


def test_a_sequence_equals_its_steps_one_by_one(agent: GoalAgent) -> None:
    features, goals, interactions = sequence()
    log_probs, values, *_ = agent(features, goals, interactions)
    state: RecurrentState | None = agent.initial_state(2)
    for step in range(features.shape[1]):
        one_log_probs, one_values, _, state = agent(features[:, step : step + 1], goals, interactions, state)
        torch.testing.assert_close(one_log_probs[:, 0], log_probs[:, step])
        torch.testing.assert_close(one_values[:, 0], values[:, step])


def test_a_step_sees_nothing_of_later_steps(agent: GoalAgent) -> None:
    features, goals, interactions = sequence()
    before = agent(features, goals, interactions)[0][:, :3]
    features[:, 3:] = 77.0
    torch.testing.assert_close(agent(features, goals, interactions)[0][:, :3], before)


def test_policy_is_a_distribution_that_starts_near_uniform(agent: GoalAgent) -> None:
    log_probs, values, *_ = agent(*sequence())
    torch.testing.assert_close(log_probs.exp().sum(-1), torch.ones(2, 5))
    assert log_probs.exp().sub(1 / 6).abs().max() < 0.02
    assert values.abs().max() < 0.1


@pytest.mark.parametrize("changed", ["goal", "interaction"])
def test_the_instruction_changes_policy_and_value(agent: GoalAgent, changed: str) -> None:
    features, goals, interactions = sequence()
    before = agent(features, goals, interactions)
    if changed == "goal":
        goals = goals.flip(0)
    else:
        interactions = (interactions + 1) % 3
    after = agent(features, goals, interactions)
    assert not torch.equal(before[0], after[0])
    assert not torch.equal(before[1], after[1])
