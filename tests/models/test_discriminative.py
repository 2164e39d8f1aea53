"""GDAN's agent: the heads read an attention that the discriminator asks, and do not train it."""

import pytest
import torch
from torch import Tensor

from vhs.models import Categorical, DiscriminativeAgent, FeatureExtractor, RecurrentState


@pytest.fixture
def agent() -> DiscriminativeAgent:
    torch.manual_seed(0)
    return DiscriminativeAgent(
        FeatureExtractor((16, 16, 3), 2, (4, 4, 4, 4), 8),
        num_goals=3,
        head=Categorical(5),
        num_interactions=2,
        hidden_dim=12,
        head_dim=10,
        interaction_dim=4,
        num_words=3,
    )


def sequence(steps: int = 5) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    features = torch.randn(2, steps, 8, generator=generator)
    return features, torch.randn(2, 8, generator=generator), torch.tensor([0, 1])


def test_a_sequence_equals_its_steps_one_by_one(agent: DiscriminativeAgent) -> None:
    features, goals, interactions = sequence()
    log_probs, values, *_ = agent(features, goals, interactions)
    state: RecurrentState | None = agent.initial_state(2)
    for step in range(features.shape[1]):
        one_log_probs, one_values, _, state = agent(features[:, step : step + 1], goals, interactions, state)
        torch.testing.assert_close(one_log_probs[:, 0], log_probs[:, step])
        torch.testing.assert_close(one_values[:, 0], values[:, step])


def test_the_attention_is_tanh_of_query_and_key_times_value(agent: DiscriminativeAgent) -> None:
    features, gated, hidden = torch.randn(1, 1, 8), torch.randn(1, 1, 8), torch.randn(1, 1, 12)
    with torch.no_grad():
        found = agent._attend(features, gated, hidden)[0, 0]
        seen = (agent.recognise[0].weight @ features[0, 0] + agent.recognise[0].bias).clamp(min=0)
        both = torch.cat([gated[0, 0], hidden[0, 0]])
        kept = (agent.memory[0].weight @ both + agent.memory[0].bias).clamp(min=0)
        query = (agent.query[0].weight @ seen + agent.query[0].bias).clamp(min=0)
        key = (agent.key[0].weight @ kept[:12] + agent.key[0].bias).clamp(min=0)
        attended = torch.cat([torch.tanh(query + key) * kept[12:], hidden[0, 0]])
        fused = agent.fuse[0].weight @ attended + agent.fuse[0].bias
        expected = torch.tanh((fused - fused.mean()) / (fused.var(correction=0) + 1e-5).sqrt())
    torch.testing.assert_close(found, expected)


def test_actor_and_critic_read_the_discriminator_and_do_not_train_it(agent: DiscriminativeAgent) -> None:
    log_probs, values, *_ = agent(*sequence())
    (log_probs[..., 0].sum() + values.sum()).backward()
    assert all(parameter.grad is None for parameter in agent.recognise.parameters())
    assert all(parameter.grad is None for parameter in agent.classify.parameters())
    assert all(parameter.grad.abs().sum() > 0 for parameter in agent.query.parameters())
    with torch.no_grad():
        agent.recognise[0].bias += 1.0
    assert not torch.equal(agent(*sequence())[0], log_probs)


def test_the_discriminator_gives_a_number_a_class(agent: DiscriminativeAgent) -> None:
    assert agent.discriminate(torch.randn(7, 8)).shape == (7, 3)
