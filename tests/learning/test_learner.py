"""One update: what learns from what, what stays constant, what a bad update leaves behind."""

import copy
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import torch
from torch import Tensor

from vhs import Outcome
from vhs.errors import DivergenceError
from vhs.learning.learner import Learner

from .parts import DIM, GOALS, fill_store, goals_for, make_batch, small_learner


@contextmanager
def frozen_weights(learner: Learner) -> Iterator[None]:
    """Check that nothing in the body changes a weight."""
    before = {
        name: value.clone() for name, value in learner.agent.state_dict().items() if "running" not in name
    }
    yield
    after = learner.agent.state_dict()
    for name, value in before.items():
        if "num_batches" not in name:
            assert torch.equal(value, after[name]), f"{name} changed"


def test_an_update_changes_every_part_of_the_network() -> None:
    learner = small_learner("method.relabel_probability=1.0")
    fill_store(learner.goals)
    before = {name: parameter.detach().clone() for name, parameter in learner.agent.named_parameters()}
    batch = make_batch([Outcome.SUCCESS, Outcome.FAILURE, Outcome.TIMEOUT])
    metrics = learner.update(batch, goals_for(batch))
    same = [
        name for name, parameter in learner.agent.named_parameters() if torch.equal(parameter, before[name])
    ]
    assert not same
    assert set(metrics) == {
        "policy",
        "value",
        "entropy",
        "imitation_policy",
        "imitation_value",
        "supcon",
        "grad_norm",
        "relabelled",
    }
    assert all(np.isfinite(value) for value in metrics.values())


def test_only_failures_are_relabelled() -> None:
    learner = small_learner("method.relabel_probability=1.0")
    batch = make_batch([Outcome.SUCCESS, Outcome.FAILURE, Outcome.TIMEOUT, Outcome.FAILURE])
    metrics = learner.update(batch, goals_for(batch))
    assert metrics["relabelled"] == 0.5
    assert metrics["imitation_policy"] > 0
    none = make_batch([Outcome.SUCCESS, Outcome.TIMEOUT])
    metrics = learner.update(none, goals_for(none))
    assert (metrics["relabelled"], metrics["imitation_policy"], metrics["imitation_value"]) == (0.0, 0.0, 0.0)


def test_the_hindsight_goal_is_the_detached_feature_of_the_final_observation() -> None:
    learner = small_learner("method.relabel_probability=1.0", "method.hindsight_goal=feature")
    batch = make_batch([Outcome.FAILURE])
    seen: list[tuple[Tensor, Tensor, Tensor]] = []

    def spy(module: object, inputs: tuple[Tensor, ...], output: object) -> None:
        seen.append((inputs[0], inputs[1], inputs[2]))

    handle = learner.agent.register_forward_hook(spy)
    own = goals_for(batch)
    learner.agent.train()
    expected = learner.agent.extractor(torch.from_numpy(batch.observations))[int(batch.lengths[0])]
    learner.update(batch, own)
    handle.remove()
    (features, goals, interactions) = seen[0]
    assert goals.shape == (2, DIM)
    torch.testing.assert_close(goals[0], own[0])
    torch.testing.assert_close(goals[1], expected)
    assert features.requires_grad
    assert not goals.requires_grad
    assert interactions.tolist() == [0, 1], "instructed interaction 0, performed interaction 1 (action 4)"


@pytest.mark.parametrize(("updates", "expected"), [(0, 1.0), (5, 0.6), (10, 0.2), (99, 0.2)])
def test_scheduled_numbers_go_linearly_to_their_end_and_stay(updates: int, expected: float) -> None:
    ends = [f"train.{name}=1.0" for name in ("learning_rate", "entropy_weight")]
    ends += [f"train.{name}_end=0.2" for name in ("learning_rate", "entropy_weight")]
    learner = small_learner(*ends, "train.schedule_episodes=20", "train.episodes_per_update=2")
    learner.updates = updates
    assert learner.scheduled("train.learning_rate") == pytest.approx(expected)
    assert learner.scheduled("train.entropy_weight") == pytest.approx(expected)


def test_numbers_without_an_end_stay() -> None:
    learner = small_learner("train.learning_rate=0.5", "train.learning_rate_end=null")
    learner.updates = 10**6
    assert learner.scheduled("train.learning_rate") == 0.5


def test_prototypes_are_noise_until_the_store_is_warm_and_then_the_mean_of_features() -> None:
    learner = small_learner()
    batch = make_batch([Outcome.FAILURE])
    first, second = learner.goals.begin(0), learner.goals.begin(0)
    assert not torch.equal(first, second), "an empty class draws a fresh vector for each episode"
    learner.update(batch, goals_for(batch))
    assert not learner.goals.prototypes.seen.any()
    twin = small_learner()
    for one in (learner, twin):
        fill_store(one.goals)
    agent = copy.deepcopy(learner.agent).train()
    learner.update(batch, goals_for(batch))
    assert learner.goals.prototypes.seen.all()
    images, labels = twin.goals.store.sample(12, balanced=True)
    seen = torch.from_numpy(np.concatenate([batch.observations, images]))
    with torch.no_grad():
        features = agent.extractor(seen, learner.dtype)[len(batch.observations) :]
    means = torch.stack([features[torch.from_numpy(labels == label)].mean(0) for label in range(GOALS)])
    torch.testing.assert_close(torch.from_numpy(np.array(learner.goals.prototypes.table)), means)
    torch.testing.assert_close(learner.goals.begin(1), means[1])


def test_a_step_of_a_relabelled_episode_weighs_as_much_as_any_other() -> None:
    learner = small_learner("method.relabel_probability=1.0", "method.hindsight_discount=1.0")
    alone = make_batch([Outcome.FAILURE])
    among = make_batch([Outcome.FAILURE, Outcome.TIMEOUT])
    share = alone.lengths.sum() / among.lengths.sum()
    # A policy that starts uniform costs log(5) a relabelled step; the other episode only dilutes it.
    with_company = learner.update(among, goals_for(among))["imitation_policy"]
    assert with_company == pytest.approx(np.log(5) * share, rel=0.05)


def test_a_loss_that_is_not_finite_is_refused_and_changes_no_weight() -> None:
    learner = small_learner()
    batch = make_batch([Outcome.FAILURE])
    goals = goals_for(batch)
    goals[0, 0] = float("nan")
    with (
        frozen_weights(learner),
        pytest.raises(DivergenceError, match="update 1: expected a finite loss, found"),
    ):
        learner.update(batch, goals)


def test_state_round_trip_gives_the_same_next_update() -> None:
    first, second = small_learner(), small_learner("seed=1")
    for learner in (first, second):
        fill_store(learner.goals)
    batch = make_batch([Outcome.FAILURE, Outcome.SUCCESS])
    first.update(batch, goals_for(batch))
    second.load_state_dict(first.state_dict())
    second.goals.store.sample(12, balanced=True)  # the one batch that the first store has drawn
    assert first.update(batch, goals_for(batch)) == second.update(batch, goals_for(batch))
    torch.testing.assert_close(first.goals.begin(0), second.goals.begin(0))


def test_an_episode_is_imitated_as_far_as_it_reached_something() -> None:
    settings = (
        "method.relabel_probability=1.0",
        "method.hindsight_discount=1.0",
        "method.relabel_on=[failure, timeout]",
    )
    batch = make_batch([Outcome.TIMEOUT, Outcome.FAILURE, Outcome.TIMEOUT])

    def imitated(touched: list[int] | None) -> dict[str, float]:
        learner = small_learner(*settings)
        given = None if touched is None else np.array(touched, dtype=np.int64)
        return learner.update(batch, goals_for(batch), given)

    steps = batch.lengths.sum()
    # What failed has reached something at its end; of the timeouts one did after two steps, the other never.
    cut = imitated([2, 0, 0])
    assert cut["relabelled"] == pytest.approx(2 / 3)
    expected = np.log(5) * (2 + batch.lengths[1]) / steps
    assert cut["imitation_policy"] == pytest.approx(expected, rel=0.05)
    assert imitated(batch.lengths.tolist()) == imitated(None)
