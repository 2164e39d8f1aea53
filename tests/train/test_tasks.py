"""Training and evaluating on environments of other shapes than the package's rooms."""

import sys
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import torch
from toy import Toy, toy_config, toy_task

from vhs import Task
from vhs.acting.policy import load_agent
from vhs.acting.setup import make_env
from vhs.errors import ConfigError
from vhs.eval import evaluate
from vhs.runs.rows import read_log
from vhs.show.moments import play_moments
from vhs.show.pictures import draw
from vhs.train import train

pytestmark = pytest.mark.slow

SETTINGS = (
    "train.episodes=48",
    "train.log_every=24",
    "env.num_envs=4",
    "env.num_workers=0",
    "method.warmup=2",
    "method.relabel_on=[failure, timeout]",
    "method.relabel_probability=1",
)


def train_and_evaluate(task: Task, run: Path, *overrides: str) -> None:
    """A few updates on a task; they change the policy, and its evaluation adds up."""
    config = toy_config("vhs", *SETTINGS, *overrides)
    assert train(config, run, StringIO(), task=task)
    rows = read_log(run)
    assert [row["episodes"] for row in rows] == [24, 48]
    assert all(
        row["rate/success"] + row["rate/failure"] + row["rate/timeout"] == pytest.approx(1) for row in rows
    )
    assert rows[-1]["loss/relabelled"] > 0
    assert rows[-1]["loss/imitation_policy"] > 0
    agent = load_agent(run, task)
    assert agent.agent.policy[-1].out_features == task.spec().num_actions
    result = evaluate(run, episodes=12, task=task)
    assert result.success + result.failure + result.timeout == pytest.approx(1)
    assert 1 <= result.steps <= 6
    assert (result.spl, result.optimal_steps) == (None, None), "the toy knows no shortest way"


@pytest.mark.parametrize("start", [0, 4])
def test_two_moves_and_two_interactions(start: int, tmp_path: Path) -> None:
    train_and_evaluate(toy_task(moves=2, interactions=2, start=start), tmp_path / "run")


def test_no_interactions(tmp_path: Path) -> None:
    train_and_evaluate(toy_task(interactions=0), tmp_path / "run")


def test_a_frame_that_is_not_square(tmp_path: Path) -> None:
    train_and_evaluate(toy_task(frame=(12, 20, 3)), tmp_path / "run")


@pytest.mark.parametrize("frame", [(16, 16, 1), (16, 16)])
def test_one_grey_channel(frame: tuple[int, ...], tmp_path: Path) -> None:
    task = toy_task(frame=frame)
    assert task.spec().frame_shape == (16, 16, 1)
    train_and_evaluate(task, tmp_path / "run")
    agent = load_agent(tmp_path / "run", task)
    first = next(play_moments(agent, make_env(task, agent.spec), [0], 0, greedy=False))
    assert np.asarray(draw(first)).std() > 0


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="worker processes need Linux")
def test_workers_step_a_task_too(tmp_path: Path) -> None:
    weights = []
    for workers in (0, 1):
        run = tmp_path / str(workers)
        config = toy_config("vhs", *SETTINGS, f"env.num_workers={workers}")
        train(config, run, StringIO(), task=toy_task(moves=2, start=3))
        weights.append(load_agent(run, toy_task(moves=2, start=3)).agent.state_dict())
    for name, value in weights[0].items():
        assert torch.equal(value, weights[1][name]), name


@pytest.mark.parametrize(
    ("task", "override", "message"),
    [
        (
            replace(toy_task(), success_reward=None),
            "method.value_target=hindsight_return",
            "expected behaviour, as task toy does not say what a success pays",
        ),
        (
            toy_task(),
            "method.supcon_batch=3",
            "method.supcon_batch: expected more than 3, the number of goals",
        ),
        (
            replace(toy_task(), goals=("red", "green", "blue")),
            "method.supcon_batch=2",
            "method.supcon_batch: expected more than 3, the number of goals",
        ),
    ],
)
def test_what_a_task_cannot_give_is_refused_before_anything_is_written(
    task: Task, override: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=message):
        train(toy_config("vhs", *SETTINGS, override), tmp_path / "run", StringIO(), task=task)
    assert not (tmp_path / "run").exists()


def test_the_toy_is_the_environment_that_the_tests_say() -> None:
    env = Toy(moves=2, interactions=2, start=4)
    env.reset(seed=0)
    assert env.action_space.contains(np.int64(4))
    assert not env.action_space.contains(np.int64(0))
    with pytest.raises(AssertionError):
        env.step(0)
