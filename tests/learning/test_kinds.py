"""Goals that are pictures or vectors: what names them, what learns, and that hindsight solves them."""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from reach import reach_task
from toy import play_toy, toy_config

from vhs import EpisodeBatch, Outcome
from vhs.buffer import as_goal, make_buffer
from vhs.learning.learner import Learner
from vhs.learning.told import PictureGoals, VectorGoals
from vhs.task import TaskSpec
from vhs.train.build import make_learner

CHANCE = 0.20
"""Success of uniform actions of any of the three kinds, measured over 3,000 episodes: 0.18 to 0.21."""
STEP = spaces.Box(-1, 1, (2,), np.float32)
CHOICES = spaces.MultiDiscrete([3, 3], start=[1, -1])
WIDER = (
    "model.feature_dim=64",
    "model.hidden_dim=64",
    "model.head_dim=64",
    "train.learning_rate=2e-3",
    "train.episodes_per_update=4",
)


def batch_of(spec: TaskSpec, outcomes: list[Outcome]) -> EpisodeBatch:
    """Random episodes of growing length."""
    rng = np.random.default_rng(3)

    def frame() -> np.ndarray:
        if spec.frame_dtype == np.uint8:
            return rng.integers(0, 256, spec.frame_shape, dtype=np.uint8)
        return rng.normal(size=spec.frame_shape).astype(np.float32)

    def reached() -> np.ndarray | None:
        return rng.normal(size=2).astype(np.float32) if spec.goals == "vectors" else None

    stacking = "channels" if len(spec.frame_shape) == 3 else "frames"
    buffer = make_buffer(spec, capacity_steps=200, frame_stack=2, stacking=stacking)
    ids = []
    for episode, outcome in enumerate(outcomes):
        desired = as_goal(buffer, frame()) if reached() is None else reached()
        buffer.begin(0, frame(), desired_goal=desired, achieved_goal=reached())
        for _ in range(2 + episode):
            action = rng.uniform(-1, 1, spec.action_dim) if spec.action_dim else 1
            buffer.append(0, action, 0.5, 0.1, frame(), achieved_goal=reached())
        ids.append(buffer.finish(0, outcome))
    return buffer.gather(np.array(ids))


def learner_of(goals: str, action_space: spaces.Space, *overrides: str) -> tuple[Learner, TaskSpec]:
    spec = reach_task(goals, action_space).spec()
    return make_learner(toy_config("vhs", "method.relabel_probability=1", *overrides), spec), spec


@pytest.mark.parametrize("action_space", [spaces.Discrete(4), CHOICES, STEP], ids=str)
@pytest.mark.parametrize("goals", ["picture", "vector", "state"])
def test_an_update_changes_every_part_of_the_network(goals: str, action_space: spaces.Space) -> None:
    learner, spec = learner_of(goals, action_space)
    batch = batch_of(spec, [Outcome.SUCCESS, Outcome.FAILURE, Outcome.TIMEOUT])
    acted = torch.zeros(3, 16)
    before = {name: value.detach().clone() for name, value in learner.agent.named_parameters()}
    for _ in range(2):  # the small last layers let little of the first gradient through
        metrics = learner.update(batch, acted)
    same = [name for name, value in learner.agent.named_parameters() if torch.equal(value, before[name])]
    assert not same
    assert metrics["relabelled"] == pytest.approx(2 / 3), "failures and timeouts"
    assert "supcon" not in metrics


def test_a_picture_is_embedded_as_an_observation_that_stands_still() -> None:
    learner, spec = learner_of("picture", STEP)
    goals = learner.goals
    assert isinstance(goals, PictureGoals)
    batch = batch_of(spec, [Outcome.TIMEOUT, Outcome.FAILURE])
    rows = batch.offsets + batch.lengths
    pictures = goals.pictures(batch, rows)
    assert pictures is not None
    assert np.array_equal(pictures[:2], batch.desired_goals)
    newest = batch.observations[rows][..., 1:]
    assert np.array_equal(pictures[2:], np.concatenate([newest, newest], -1)), "not the motion before the end"
    learner.agent.eval()
    features = learner.agent.extractor(torch.from_numpy(pictures))
    torch.testing.assert_close(goals.begin(pictures[0]), features[0], atol=1e-5, rtol=1e-4)
    assert torch.equal(goals.instructed(learner.agent, batch, torch.zeros(2, 16), features), features[:2])
    nothing = torch.zeros(2, 16)
    assert torch.equal(goals.hindsight(learner.agent, batch, rows, nothing, features), features[2:])


def test_a_vector_is_embedded_by_the_agent_and_so_is_what_was_reached() -> None:
    learner, spec = learner_of("vector", STEP)
    goals, agent = learner.goals, learner.agent
    assert isinstance(goals, VectorGoals)
    batch = batch_of(spec, [Outcome.TIMEOUT, Outcome.FAILURE])
    rows, none = batch.offsets + batch.lengths, torch.zeros(0, 16)
    assert batch.desired_goals is not None
    assert batch.achieved_goals is not None
    told, reached = (torch.from_numpy(one) for one in (batch.desired_goals, batch.achieved_goals[rows]))
    torch.testing.assert_close(goals.instructed(agent, batch, none, none), agent.embed_vectors(told))
    torch.testing.assert_close(goals.hindsight(agent, batch, rows, none, none), agent.embed_vectors(reached))
    torch.testing.assert_close(goals.begin(batch.desired_goals[1]), agent.embed_vectors(told)[1])
    assert not goals.begin(batch.desired_goals[1]).requires_grad


def test_the_critic_is_asked_what_a_limit_cut_off() -> None:
    learner, spec = learner_of(
        "state", STEP, "train.gamma=0.5", "train.return_lambda=1", "train.value_weight=1"
    )
    cut = batch_of(spec, [Outcome.TIMEOUT])
    assert not cut.terminated[0]
    with torch.no_grad():
        learner.agent.value[-1].bias.fill_(40.0)  # far above anything that is paid
    found = learner.update(cut, torch.zeros(1, 16))["value"]
    # Two steps that pay 0.05 scaled, then V = 40: returns 0.05 + 0.5 * 40 and 0.05 + 0.5 * that.
    last = 0.05 + 0.5 * 40
    expected = ((40 - last) ** 2 + (40 - (0.05 + 0.5 * last)) ** 2) / 2
    assert found == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_hindsight_solves_with_continuous_actions_what_rewards_alone_do_not() -> None:
    """Vector goals, timeouts alone: 0.63 with hindsight, 0.17 without."""
    task = reach_task("state", STEP)
    assert play_toy(toy_config("vhs", *WIDER), 1500, task) > 2 * CHANCE
    assert play_toy(toy_config("pg", *WIDER), 1500, task) < 1.5 * CHANCE


@pytest.mark.slow
def test_several_choices_at_once_are_learned() -> None:
    """0.54 of episodes, and 0.37 without hindsight."""
    assert play_toy(toy_config("vhs", *WIDER), 1500, reach_task("state", CHOICES)) > 2 * CHANCE


@pytest.mark.slow
def test_pictures_of_goals_are_found() -> None:
    """0.69 of episodes; a picture says where to go as far as f learns to read it."""
    config = toy_config("vhs", *WIDER, "method.relabel_probability=0.4")
    assert play_toy(config, 3000, reach_task("picture")) > 2 * CHANCE
