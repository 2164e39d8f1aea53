"""Learners that share an update: one set of weights, mean gradients, same result whoever is faster."""

import pytest
import torch
from torch import Tensor

from vhs.learning.parallel import Replicas
from vhs.models import Categorical, FeatureExtractor, GoalAgent


@pytest.fixture
def agent() -> GoalAgent:
    torch.manual_seed(0)
    extractor = FeatureExtractor((16, 16, 3), 2, (4, 4, 4, 4), 8)
    return GoalAgent(
        extractor, head=Categorical(4), num_interactions=1, hidden_dim=12, head_dim=10, interaction_dim=4
    )


def images(seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (6, 2, 16, 16, 3), dtype=torch.uint8, generator=generator)


def learn(agent: GoalAgent, observations: Tensor) -> float:
    agent.zero_grad(set_to_none=True)
    agent.train()
    loss = agent.extractor(observations)[:, 0].square().mean()
    loss.backward()
    return loss.item()


def gradient(agent: GoalAgent) -> Tensor:
    found = agent.extractor.project.weight.grad
    assert found is not None
    return found.clone()


def test_gradients_are_the_mean_of_the_shares(agent: GoalAgent) -> None:
    alone = []
    for seed in (1, 2):
        learn(agent, images(seed))
        alone.append(gradient(agent))
    replicas = Replicas(agent, 2)
    replicas.map(learn, [images(1), images(2)])
    replicas.merge()
    torch.testing.assert_close(gradient(agent), (alone[0] + alone[1]) / 2)


def test_results_come_in_the_order_of_the_shares(agent: GoalAgent) -> None:
    expected = [learn(agent, images(seed)) for seed in (1, 2, 3)]
    found = Replicas(agent, 3).map(learn, [images(seed) for seed in (1, 2, 3)])
    assert found == pytest.approx(expected)


def test_twins_follow_the_weights_and_share_batch_statistics_after_merging(agent: GoalAgent) -> None:
    replicas = Replicas(agent, 2)
    optimiser = torch.optim.SGD(agent.parameters(), lr=0.1)
    replicas.map(learn, [images(1), images(2)])
    norms = [replica.extractor.convolutions[1].running_mean.clone() for replica in replicas.agents]
    assert not torch.equal(*norms), "each normalises by its own share"
    replicas.merge()
    optimiser.step()
    first, twin = (replica.state_dict() for replica in replicas.agents)
    for name, value in first.items():
        torch.testing.assert_close(twin[name], value)
    torch.testing.assert_close(first["extractor.convolutions.1.running_mean"], (norms[0] + norms[1]) / 2)


def test_the_same_shares_give_the_same_gradients_bit_for_bit(agent: GoalAgent) -> None:
    found = []
    for _ in range(2):
        replicas = Replicas(agent, 2)
        replicas.map(learn, [images(1), images(2)])
        replicas.merge()
        found.append(gradient(agent))
    assert torch.equal(*found)


@pytest.mark.parametrize("broken", [0, 1])
def test_an_error_of_any_learner_arrives(agent: GoalAgent, broken: int) -> None:
    shares = [images(1), images(2)]
    shares[broken] = shares[broken][:, :1]
    with pytest.raises(ValueError, match="`observations`: expected shape"):
        Replicas(agent, 2).map(learn, shares)
