"""One update of VHS: what learns from what, what stays constant, what a bad update leaves behind."""

import copy
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import torch
from torch import Tensor

from vhs import EpisodeBatch, EpisodeBuffer, GoalStore, Outcome, Prototypes, Rng
from vhs.algorithms import VHS
from vhs.config import Config, load_config
from vhs.errors import DivergenceError
from vhs.models import FeatureExtractor, GoalAgent

FRAME = (16, 16, 3)
GOALS, INTERACTIONS, DIM = 3, 2, 8
SUCCESS_REWARD = 9.99


def make_vhs(*overrides: str) -> VHS:
    config: Config = load_config(
        [], ["method.warmup=6", "method.supcon_batch=12", "method.prototype_samples=4", *overrides]
    )
    torch.manual_seed(0)
    extractor = FeatureExtractor(FRAME, 2, (4, 4, 4, 4), DIM)
    agent = GoalAgent(
        extractor,
        num_actions=3 + INTERACTIONS,
        num_interactions=INTERACTIONS,
        hidden_dim=12,
        head_dim=10,
        interaction_dim=4,
    )
    return VHS(
        agent,
        GoalStore(GOALS, extractor.observation_shape, 50, seed=0),
        Prototypes(GOALS, DIM, momentum=0.0 if config.method.prototype == "exact" else 0.9, seed=0),
        method=config.method,
        train=config.train,
        success_reward=SUCCESS_REWARD,
        dtype=torch.float32,
        rng=Rng(0),
    )


def fill_store(vhs: VHS, per_class: int = 5) -> None:
    rng = np.random.default_rng(7)
    for label in range(GOALS):
        for _ in range(per_class):
            vhs.goal_store.push(rng.integers(0, 256, vhs.goal_store.observation_shape, dtype=np.uint8), label)


def make_batch(outcomes: list[Outcome], last_action: int = 4) -> EpisodeBatch:
    """Random episodes of growing length; each ends with `last_action`."""
    rng = np.random.default_rng(3)
    buffer = EpisodeBuffer(
        FRAME,
        num_streams=1,
        max_episode_steps=20,
        capacity_steps=400,
        frame_stack=2,
        stacking="channels",
        num_goals=GOALS,
        interactions={3 + number: number for number in range(INTERACTIONS)},
    )
    ids = []
    for episode, outcome in enumerate(outcomes):
        buffer.begin(0, rng.integers(0, 256, FRAME, dtype=np.uint8), episode % GOALS, 0)
        steps = 3 + episode
        for step in range(steps):
            action = last_action if step == steps - 1 else int(rng.integers(0, 3))
            reward, value = float(rng.normal()), float(rng.normal())
            buffer.append(0, action, reward, value, rng.integers(0, 256, FRAME, dtype=np.uint8))
        ids.append(buffer.finish(0, outcome))
    return buffer.gather(np.array(ids, dtype=np.int64))


def goals_for(batch: EpisodeBatch) -> Tensor:
    return torch.randn(len(batch.lengths), DIM, generator=torch.Generator().manual_seed(5))


@contextmanager
def frozen_weights(vhs: VHS) -> Iterator[None]:
    """Check that nothing in the body changes a weight."""
    before = {name: value.clone() for name, value in vhs.agent.state_dict().items() if "running" not in name}
    yield
    after = vhs.agent.state_dict()
    for name, value in before.items():
        if "num_batches" not in name:
            assert torch.equal(value, after[name]), f"{name} changed"


def test_an_update_changes_every_part_of_the_network() -> None:
    vhs = make_vhs("method.relabel_probability=1.0")
    fill_store(vhs)
    before = {name: parameter.detach().clone() for name, parameter in vhs.agent.named_parameters()}
    batch = make_batch([Outcome.SUCCESS, Outcome.FAILURE, Outcome.TIMEOUT])
    metrics = vhs.update([(batch, goals_for(batch))])
    same = [name for name, parameter in vhs.agent.named_parameters() if torch.equal(parameter, before[name])]
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
    vhs = make_vhs("method.relabel_probability=1.0")
    batch = make_batch([Outcome.SUCCESS, Outcome.FAILURE, Outcome.TIMEOUT, Outcome.FAILURE])
    metrics = vhs.update([(batch, goals_for(batch))])
    assert metrics["relabelled"] == 0.5
    assert metrics["imitation_policy"] > 0
    none = make_batch([Outcome.SUCCESS, Outcome.TIMEOUT])
    metrics = vhs.update([(none, goals_for(none))])
    assert (metrics["relabelled"], metrics["imitation_policy"], metrics["imitation_value"]) == (0.0, 0.0, 0.0)


def test_the_hindsight_goal_is_the_detached_feature_of_the_final_observation() -> None:
    vhs = make_vhs("method.relabel_probability=1.0", "method.hindsight_goal=feature")
    batch = make_batch([Outcome.FAILURE])
    seen: list[tuple[Tensor, Tensor, Tensor]] = []

    def spy(module: object, inputs: tuple[Tensor, ...], output: object) -> None:
        seen.append((inputs[0], inputs[1], inputs[2]))

    handle = vhs.agent.register_forward_hook(spy)
    own = goals_for(batch)
    vhs.agent.train()
    expected = vhs.agent.extractor(torch.from_numpy(batch.observations))[int(batch.lengths[0])]
    vhs.update([(batch, own)])
    handle.remove()
    (features, goals, interactions) = seen[0]
    assert goals.shape == (2, DIM)
    torch.testing.assert_close(goals[0], own[0])
    torch.testing.assert_close(goals[1], expected)
    assert features.requires_grad
    assert not goals.requires_grad
    assert interactions.tolist() == [0, 1], "instructed interaction 0, performed interaction 1 (action 4)"


def test_prototype_hindsight_takes_the_prototype_nearest_to_what_was_reached() -> None:
    vhs = make_vhs("method.hindsight_goal=prototype")
    reached = torch.randn(4, DIM, generator=torch.Generator().manual_seed(2))
    fill_store(vhs)
    assert torch.equal(vhs._hindsight_goals(reached), reached), (
        "a class without a prototype leaves the feature"
    )
    table = np.eye(GOALS, DIM, dtype=np.float32) * np.array([[1.0], [50.0], [2.0]], dtype=np.float32)
    vhs.prototypes.update(table, [0, 1, 2])
    near = torch.tensor(table)[[2, 0, 1, 0]] * 3 + 0.1
    torch.testing.assert_close(vhs._hindsight_goals(near), torch.tensor(table)[[2, 0, 1, 0]])


def test_prototype_hindsight_waits_until_goals_can_be_told_apart() -> None:
    vhs = make_vhs("method.hindsight_goal=prototype", "method.prototype=exact")
    fill_store(vhs, per_class=1)
    for label in range(GOALS):
        vhs.embed_goal(label)
    assert vhs.prototypes.seen.all()
    assert not vhs.is_warm
    reached = torch.randn(4, DIM, generator=torch.Generator().manual_seed(2))
    assert torch.equal(vhs._hindsight_goals(reached), reached)


@pytest.mark.parametrize(("updates", "expected"), [(0, 1.0), (5, 0.6), (10, 0.2), (99, 0.2)])
def test_scheduled_numbers_go_linearly_to_their_end_and_stay(updates: int, expected: float) -> None:
    ends = [f"train.{name}=1.0" for name in ("learning_rate", "entropy_weight")]
    ends += [f"train.{name}_end=0.2" for name in ("learning_rate", "entropy_weight")]
    vhs = make_vhs(*ends, "train.schedule_episodes=20", "train.episodes_per_update=2")
    vhs.updates = updates
    assert vhs._scheduled("learning_rate") == pytest.approx(expected)
    assert vhs._scheduled("entropy_weight") == pytest.approx(expected)


def test_numbers_without_an_end_stay() -> None:
    vhs = make_vhs("train.learning_rate=0.5", "train.learning_rate_end=null")
    vhs.updates = 10**6
    assert vhs._scheduled("learning_rate") == 0.5


def test_prototypes_are_noise_until_the_store_is_warm_and_then_the_mean_of_features() -> None:
    vhs = make_vhs()
    batch = make_batch([Outcome.FAILURE])
    first, second = vhs.embed_goal(0), vhs.embed_goal(0)
    assert not torch.equal(first, second), "an empty class draws a fresh vector for each episode"
    vhs.update([(batch, goals_for(batch))])
    assert not vhs.prototypes.seen.any()
    twin = make_vhs()
    for one in (vhs, twin):
        fill_store(one)
    agent = copy.deepcopy(vhs.agent).train()
    vhs.update([(batch, goals_for(batch))])
    assert vhs.prototypes.seen.all()
    images, labels = twin.goal_store.sample(vhs._method.supcon_batch, balanced=True)
    seen = torch.from_numpy(np.concatenate([batch.observations, images]))
    with torch.no_grad():
        features = agent.extractor(seen, vhs.dtype)[len(batch.observations) :]
    means = torch.stack([features[torch.from_numpy(labels == label)].mean(0) for label in range(GOALS)])
    torch.testing.assert_close(torch.from_numpy(np.array(vhs.prototypes.table)), means)
    torch.testing.assert_close(vhs.embed_goal(1), means[1])


def test_exact_prototypes_embed_stored_images_of_their_class_alone() -> None:
    vhs = make_vhs("method.prototype=exact")
    assert not torch.equal(vhs.embed_goal(2), vhs.embed_goal(2)), "noise while the class is empty"
    image = np.full(vhs.goal_store.observation_shape, 90, dtype=np.uint8)
    vhs.goal_store.push(image, 2)
    assert not vhs.is_warm
    vhs.agent.eval()
    with torch.inference_mode():
        expected = vhs.agent.extractor(torch.from_numpy(image).unsqueeze(0))[0]
    torch.testing.assert_close(vhs.embed_goal(2), expected, atol=1e-5, rtol=1e-4)
    assert not vhs.prototypes.seen[0]


@pytest.mark.parametrize("value_target", ["behaviour", "hindsight_return"])
def test_hindsight_value_targets(value_target: str) -> None:
    vhs = make_vhs(f"method.value_target={value_target}", "train.gamma=0.5", "train.reward_scale=0.1")
    batch = make_batch([Outcome.FAILURE])
    targets = vhs._hindsight_values(batch)
    if value_target == "behaviour":
        np.testing.assert_array_equal(targets, batch.values)
    else:
        rewards = batch.rewards[0].astype(np.float64) * 0.1
        rewards[-1] = SUCCESS_REWARD * 0.1
        expected = [
            rewards[0] + 0.5 * rewards[1] + 0.25 * rewards[2],
            rewards[1] + 0.5 * rewards[2],
            rewards[2],
        ]
        np.testing.assert_allclose(targets[0], expected, rtol=1e-5)


def test_a_step_of_a_relabelled_episode_weighs_as_much_as_any_other() -> None:
    vhs = make_vhs("method.relabel_probability=1.0", "method.hindsight_discount=1.0")
    alone = make_batch([Outcome.FAILURE])
    among = make_batch([Outcome.FAILURE, Outcome.TIMEOUT])
    share = alone.lengths.sum() / among.lengths.sum()
    # A policy that starts uniform costs log(5) a relabelled step; the other episode only dilutes it.
    with_company = vhs.update([(among, goals_for(among))])["imitation_policy"]
    assert with_company == pytest.approx(np.log(5) * share, rel=0.05)


def test_a_loss_that_is_not_finite_is_refused_and_changes_no_weight() -> None:
    vhs = make_vhs()
    batch = make_batch([Outcome.FAILURE])
    goals = goals_for(batch)
    goals[0, 0] = float("nan")
    with frozen_weights(vhs), pytest.raises(DivergenceError, match="update 1: expected a finite loss, found"):
        vhs.update([(batch, goals)])


def test_state_round_trip_gives_the_same_next_update() -> None:
    first, second = make_vhs(), make_vhs("seed=1")
    for vhs in (first, second):
        fill_store(vhs)
    batch = make_batch([Outcome.FAILURE, Outcome.SUCCESS])
    first.update([(batch, goals_for(batch))])
    second.load_state_dict(first.state_dict())
    second.goal_store.sample(12, balanced=True)  # the one batch that the first store has drawn
    assert first.update([(batch, goals_for(batch))]) == second.update([(batch, goals_for(batch))])
    torch.testing.assert_close(first.embed_goal(0), second.embed_goal(0))
