"""What each method learns from: its terms by hand, who gets a gradient, what it never reads."""

import copy
import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from toy import ALGORITHMS as OVERLAYS
from toy import toy_learner

from vhs import EpisodeBatch, Outcome
from vhs.acting.actor import Actor
from vhs.config import load_config
from vhs.eval import evaluate
from vhs.learning.learner import Learner
from vhs.learning.methods import METHODS
from vhs.models import GoalAgent
from vhs.runs.rows import read_log
from vhs.train import train

from .parts import fill_store, make_batch

RL = {"policy", "value", "entropy", "grad_norm"}
TERMS = {
    "a3c": RL,
    "gdan": RL | {"discriminator"},
    "gcsl": {"imitation_policy", "supcon", "grad_norm", "relabelled"},
    "pg": RL | {"supcon"},
    "vhs": RL | {"supcon", "imitation_policy", "imitation_value", "replay", "relabelled"},
}
OUTCOMES = [Outcome.SUCCESS, Outcome.FAILURE, Outcome.TIMEOUT, Outcome.FAILURE]


def goals_of(learner: Learner, batch: EpisodeBatch) -> Tensor:
    return torch.stack([learner.goals.begin(int(goal)) for goal in batch.goals])


def update(learner: Learner, batch: EpisodeBatch) -> dict[str, float]:
    return learner.update(batch, goals_of(learner, batch))


def weights(learner: Learner) -> dict[str, Tensor]:
    return {name: value.detach().clone() for name, value in learner.agent.named_parameters()}


def sees_gradient(module: Any) -> bool:
    return any(p.grad is not None and bool(p.grad.abs().sum() > 0) for p in module.parameters())


def run_episode(
    agent: GoalAgent, features: Tensor, goal: Tensor, batch: EpisodeBatch, episode: int, interaction: int
) -> tuple[list[Tensor], Tensor, Tensor]:
    """Log-probabilities of the actions taken, values and entropies of one episode."""
    first, steps = int(batch.offsets[episode]), int(batch.lengths[episode])
    log_probs, values, *_ = agent(
        features[first : first + steps].unsqueeze(0), goal.unsqueeze(0), torch.tensor([interaction])
    )
    taken = [log_probs[0, t, int(batch.actions[episode, t])] for t in range(steps)]
    return taken, values[0], -(log_probs[0].exp() * log_probs[0]).sum(-1)


def last_value(agent: GoalAgent, features: Tensor, goal: Tensor, batch: EpisodeBatch, episode: int) -> float:
    """V of the last observation of an episode."""
    first, steps = int(batch.offsets[episode]), int(batch.lengths[episode])
    whole = features[first : first + steps + 1].unsqueeze(0)
    values = agent(whole, goal.unsqueeze(0), torch.from_numpy(batch.interactions[episode : episode + 1]))[1]
    return float(values[0, -1])


@pytest.mark.parametrize("name", METHODS)
def test_each_method_has_its_terms_alone(name: str) -> None:
    learner = toy_learner(name)
    fill_store(learner.goals)
    metrics = update(learner, make_batch(OUTCOMES))
    assert set(metrics) == TERMS[name]
    assert all(math.isfinite(value) for value in metrics.values())


def test_the_terms_of_a3c_are_those_of_its_episodes_under_their_words() -> None:
    learner = toy_learner("a3c", "train.gamma=0.5", "train.reward_scale=0.1")
    batch = make_batch(OUTCOMES)
    agent = copy.deepcopy(learner.agent).train()
    policy, value, entropy, count = 0.0, 0.0, 0.0, 0
    with torch.no_grad():
        features = agent.extractor(torch.from_numpy(batch.observations))
        for episode, goal in enumerate(batch.goals):
            assert agent.words is not None
            word = agent.words.weight[int(goal)]
            taken, values, entropies = run_episode(
                agent, features, word, batch, episode, int(batch.interactions[episode])
            )
            following = (
                0.0 if batch.terminated[episode] else last_value(agent, features, word, batch, episode)
            )
            for t in reversed(range(len(taken))):
                following = 0.1 * float(batch.rewards[episode, t]) + 0.5 * following
                policy -= float(taken[t]) * (following - float(values[t]))
                value += (following - float(values[t])) ** 2
            entropy += float(entropies.sum())
            count += len(taken)
    found = update(learner, batch)
    assert found["policy"] == pytest.approx(policy / count, rel=1e-3)
    assert found["value"] == pytest.approx(value / count, rel=1e-3)
    assert found["entropy"] == pytest.approx(entropy / count, rel=1e-3)


def test_gcsl_imitates_failures_under_what_they_reached() -> None:
    learner = toy_learner("gcsl", "method.relabel_probability=1")
    batch = make_batch(OUTCOMES)
    agent = copy.deepcopy(learner.agent).train()
    total = 0.0
    with torch.no_grad():
        features = agent.extractor(torch.from_numpy(batch.observations))
        for episode in (1, 3):
            reached = features[int(batch.offsets[episode] + batch.lengths[episode])]
            # The last action is 4, the second interaction.
            taken, _, _ = run_episode(agent, features, reached, batch, episode, interaction=1)
            total -= float(sum(taken))
    found = update(learner, batch)
    assert found["imitation_policy"] == pytest.approx(total / batch.lengths.sum(), rel=1e-3)
    assert found["relabelled"] == 0.5


def test_the_discriminator_of_gdan_classifies_stored_images_in_the_same_pass_as_the_episodes() -> None:
    learner = toy_learner("gdan")
    fill_store(learner.goals)
    batch = make_batch(OUTCOMES)
    images, labels = copy_of_next_sample(learner)
    agent = copy.deepcopy(learner.agent).train()
    with torch.no_grad():
        both = torch.cat([torch.from_numpy(batch.observations), torch.from_numpy(images)])
        features = agent.extractor(both)[len(batch.observations) :]
        logits = agent.classify(agent.recognise(features)).double()
    expected = np.mean([-float(row.log_softmax(0)[label]) for row, label in zip(logits, labels, strict=True)])
    assert update(learner, batch)["discriminator"] == pytest.approx(expected, rel=1e-3)


def copy_of_next_sample(learner: Learner) -> tuple[Any, Any]:
    """The goal images of the next update: stores that are filled alike draw alike."""
    twin = toy_learner("gdan")
    fill_store(twin.goals)
    return twin.goals.store.sample(12, balanced=True)


def test_a_word_learns_from_the_episodes_that_it_names() -> None:
    learner = toy_learner("a3c")
    batch = make_batch([Outcome.FAILURE, Outcome.SUCCESS])  # of goals 0 and 1
    update(learner, batch)
    words = learner.agent.words
    assert words is not None
    assert words.weight.grad is not None
    assert (words.weight.grad.abs().sum(dim=1) > 0).tolist() == [True, True, False]


@pytest.mark.parametrize("name", ["a3c", "gdan"])
def test_words_are_looked_up_anew_when_learning(name: str) -> None:
    batch = make_batch(OUTCOMES)
    first, second = toy_learner(name), toy_learner(name)
    stale = torch.full((len(OUTCOMES), 16), float("nan"))
    assert update(first, batch) == second.update(batch, stale)


@pytest.mark.parametrize("name", METHODS)
def test_a_goal_embedding_is_a_constant_of_its_own(name: str) -> None:
    learner = toy_learner(name)
    embedding = learner.goals.begin(1)
    assert (embedding.shape, embedding.dtype, embedding.requires_grad) == ((16,), torch.float32, False)
    kept = embedding.clone()
    fill_store(learner.goals)
    update(learner, make_batch(OUTCOMES))
    assert torch.equal(embedding, kept), "a running episode keeps the goal that it began with"


@pytest.mark.parametrize("name", METHODS)
def test_an_actor_acts_under_the_goals_of_each_method(name: str) -> None:
    learner = toy_learner(name)
    actor = Actor(learner.agent, 2, dtype=torch.float32, generator=torch.Generator().manual_seed(0))
    for stream in (0, 1):
        actor.begin(stream, learner.goals.begin(stream), 0)
    images = np.zeros((2, 2, 16, 16, 3), dtype=np.uint8)
    actions, values = actor.act(np.arange(2), images)
    assert actions.shape == values.shape == (2,)
    assert values[0] != values[1], "the same image under another goal"


def test_a3c_never_touches_the_goal_store() -> None:
    learner = toy_learner("a3c")
    learner.goals.store = None  # type: ignore[assignment]
    update(learner, make_batch(OUTCOMES))


def test_a3c_does_not_profit_from_the_goal_store() -> None:
    batch = make_batch(OUTCOMES)
    empty, full = toy_learner("a3c"), toy_learner("a3c")
    fill_store(full.goals)
    for learner in (empty, full):
        update(learner, batch)
    for name, value in weights(empty).items():
        assert torch.equal(value, weights(full)[name]), name


@pytest.mark.parametrize("weight", [0.0, 0.5])
def test_the_discriminator_trains_on_the_store_alone(weight: float) -> None:
    learner = toy_learner("gdan", f"method.discriminator_weight={weight}")
    agent: Any = learner.agent
    batch = make_batch(OUTCOMES)
    update(learner, batch)
    assert not learner.goals.is_warm
    assert not sees_gradient(agent.recognise)
    assert not sees_gradient(agent.classify)
    fill_store(learner.goals)
    update(learner, batch)
    assert sees_gradient(agent.recognise) == sees_gradient(agent.classify) == (weight > 0)
    assert all(
        sees_gradient(part) for part in (agent.query, agent.key, agent.memory, agent.fuse, agent.words)
    )


def test_gcsl_has_no_rl_term() -> None:
    quiet, loud = make_batch(OUTCOMES), make_batch(OUTCOMES)
    loud.rewards[:] *= 1000
    assert not np.array_equal(quiet.rewards, loud.rewards)
    learners = [toy_learner("gcsl", "method.relabel_probability=1") for _ in range(2)]
    for learner, batch in zip(learners, (quiet, loud), strict=True):
        update(learner, batch)
        assert not sees_gradient(learner.agent.value)
        assert sees_gradient(learner.agent.policy)
    for name, value in weights(learners[0]).items():
        assert torch.equal(value, weights(learners[1])[name]), name


def test_gcsl_learns_nothing_from_successes_and_timeouts() -> None:
    learner = toy_learner("gcsl")
    before = weights(learner)
    metrics = update(learner, make_batch([Outcome.SUCCESS, Outcome.TIMEOUT]))
    assert metrics == {"imitation_policy": 0.0, "grad_norm": 0.0, "relabelled": 0.0}
    assert all(torch.equal(value, before[name]) for name, value in weights(learner).items())


def test_the_hindsight_goal_of_gcsl_is_a_constant() -> None:
    learner = toy_learner("gcsl", "method.relabel_probability=1")
    seen: list[Tensor] = []
    handle = learner.agent.register_forward_hook(lambda module, inputs, output: seen.append(inputs[1]))
    update(learner, make_batch(OUTCOMES))
    handle.remove()
    assert [goals.shape for goals in seen] == [(2, 16)]
    assert not seen[0].requires_grad


def test_pg_relabels_nothing() -> None:
    learner = toy_learner("pg")
    fill_store(learner.goals)
    seen: list[Tensor] = []
    handle = learner.agent.register_forward_hook(lambda module, inputs, output: seen.append(inputs[1]))
    assert "relabelled" not in update(learner, make_batch(OUTCOMES))
    handle.remove()
    assert [len(goals) for goals in seen] == [len(OUTCOMES)], "no failure a second time"
    assert learner.goals.prototypes.seen.all()


def test_vhs_without_relabelling_is_pg() -> None:
    batch = make_batch(OUTCOMES)
    learners = [toy_learner("pg"), toy_learner("vhs", "method.relabel_probability=0")]
    for learner in learners:
        fill_store(learner.goals)
        update(learner, batch)
    for name, value in weights(learners[0]).items():
        torch.testing.assert_close(weights(learners[1])[name], value)


@pytest.mark.parametrize("name", METHODS)
def test_state_round_trip_gives_the_same_next_update(name: str) -> None:
    batch = make_batch(OUTCOMES)
    first, second = toy_learner(name), toy_learner(name, "seed=1")
    second.goals.store = toy_learner(name).goals.store
    for learner in (first, second):
        fill_store(learner.goals)
    update(first, batch)
    file = io.BytesIO()
    torch.save(first.state_dict(), file)
    file.seek(0)
    second.load_state_dict(torch.load(file, weights_only=True))
    if {"supcon", "discriminator"} & {*METHODS[name].terms}:
        second.goals.store.sample(12, balanced=True)  # the one batch that the first store has drawn
    assert torch.equal(first.goals.begin(0), second.goals.begin(0))
    assert update(first, batch) == update(second, batch)
    for key, value in weights(first).items():
        assert torch.equal(value, weights(second)[key]), key


@pytest.mark.parametrize("name", METHODS)
def test_each_method_trains_in_a_real_room_and_is_evaluated(name: str, tmp_path: Path) -> None:
    files = [OVERLAYS.parent / "debug.yaml", OVERLAYS / f"{name}.yaml"]
    config = load_config(files, ["train.episodes=48", "train.log_every=24", "env.num_workers=0"])
    assert train(config, tmp_path / "run", io.StringIO())
    rows = read_log(tmp_path / "run")
    assert [row["episodes"] for row in rows] == [24, 48]
    expected = {f"loss/{term}" for term in TERMS[name] - {"supcon", "discriminator"}}
    for row in rows:
        assert expected <= set(row)
        assert sum(row[f"rate/{outcome}"] for outcome in ("success", "failure", "timeout")) == pytest.approx(
            1
        )
    result = evaluate(tmp_path / "run", episodes=4)
    assert (result.episodes, result.trained_episodes) == (4, 48)
