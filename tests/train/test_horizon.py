"""Episodes of training last longer than those of the task; rates and evaluation know the task's own steps."""

from dataclasses import replace
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy import TOY_SPEC, Toy, toy_config

from vhs.acting.policy import load_agent
from vhs.acting.setup import learn_spec, settled, task_of
from vhs.config import Config, load_config
from vhs.errors import CheckpointError, ConfigError
from vhs.eval import evaluate
from vhs.runs.directory import read_config
from vhs.runs.rows import read_log
from vhs.task import Task
from vhs.train import train

FEW = ("train.episodes=24", "train.log_every=24", "env.num_envs=4", "env.num_workers=0", "method.warmup=2")


class Late(Toy):
    """Whatever is done, the step `reaching` succeeds; none does beyond `max_steps`."""

    def __init__(self, reaching: int, max_steps: int = 100) -> None:
        super().__init__()
        self.reaching, self.max_steps = reaching, max_steps

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        self.t += 1
        is_reached = self.t == self.reaching
        info = {"outcome": "success"} if is_reached else {}
        return self.observe(), 10.0 * is_reached, is_reached, self.t >= self.max_steps, info


def late(reaching: int, **fields: Any) -> Task:
    make = partial(Late, reaching)
    return Task(name="late", make=make, max_steps=6, interactions={3: 0, 4: 1}, limit_ends=True, **fields)


def configured(*overrides: str, method: str = "vhs") -> Config:
    if method == "pg":
        overrides = tuple(one for one in overrides if not one.startswith("method."))
    return toy_config(method, *FEW, *overrides)


def last_row(run: Path, task: Task, config: Config) -> dict[str, Any]:
    assert train(config, run, StringIO(), task=task)
    return read_log(run)[-1]


@pytest.mark.parametrize(
    ("factor", "reaching", "steps"),
    [(1, 9, 6), (1.5, 9, 9), (1.5, 10, 9), (1.1, 9, 7), (2, 9, 9), (2, 99, 12)],
)
def test_an_episode_of_training_lasts_as_long_as_its_factor_says(
    factor: float, reaching: int, steps: int, tmp_path: Path
) -> None:
    row = last_row(tmp_path, late(reaching), configured(f"env.horizon_factor={factor}"))
    assert row["env_steps"] == 24 * steps
    assert (row["rate/success"], row["rate/timeout"], row["rate/steps"]) == (0.0, 1.0, 6.0)


def test_what_is_reached_late_teaches_and_does_not_count(tmp_path: Path) -> None:
    row = last_row(tmp_path, late(9), configured("env.horizon_factor=2"))
    assert sum(row[f"goals/{label}"] for label in range(3)) == 24, "images of goals that were reached"
    assert row["rate/success"] == 0
    found = evaluate(load_agent(tmp_path, late(9)), episodes=4)
    assert (found.timeout, found.steps) == (1.0, 6.0), "evaluation gives no more steps than the task"


def test_what_is_reached_in_time_counts(tmp_path: Path) -> None:
    row = last_row(tmp_path, late(6), configured("env.horizon_factor=2"))
    assert (row["rate/success"], row["rate/steps"], row["env_steps"]) == (1.0, 6.0, 24 * 6)


def test_episodes_last_twice_as_long_where_hindsight_imitates_and_they_can(tmp_path: Path) -> None:
    can = late(99, max_steps_keyword="max_steps")
    assert last_row(tmp_path / "vhs", can, configured())["env_steps"] == 24 * 12
    assert last_row(tmp_path / "pg", can, configured(method="pg"))["env_steps"] == 24 * 6
    # What says nothing may not bear a step more than it was made for.
    assert last_row(tmp_path / "silent", late(99), configured())["env_steps"] == 24 * 6


def test_an_environment_that_counts_its_steps_is_told_how_many(tmp_path: Path) -> None:
    short = late(99, kwargs={"max_steps": 6})
    untold = last_row(tmp_path / "untold", short, configured("env.horizon_factor=2"))
    assert untold["env_steps"] == 24 * 6, "it ends by itself"
    told = late(99, max_steps_keyword="max_steps")
    assert told.new_env().max_steps == 6
    assert last_row(tmp_path / "told", told, configured("env.horizon_factor=2"))["env_steps"] == 24 * 12


def test_a_factor_that_the_environment_does_not_follow_is_said(tmp_path: Path) -> None:
    said = StringIO()
    few = ("train.episodes=100", "train.log_every=100", "env.horizon_factor=2")
    train(configured(*few), tmp_path / "short", said, task=late(99, kwargs={"max_steps": 6}))
    assert "none of the first 100 episodes lasted longer than 6 steps, where training may take 12" in (
        said.getvalue()
    )
    said = StringIO()
    train(configured(*few), tmp_path / "long", said, task=late(9))
    assert "lasted longer" not in said.getvalue()


def longest(task: Task) -> int | None:
    """Of a registered environment."""
    spec = task.new_env().spec
    return spec and spec.max_episode_steps


def test_the_limit_among_the_keywords_of_a_configuration_is_the_tasks(tmp_path: Path) -> None:
    words = tmp_path / "words.yaml"
    words.write_text("task: {make: CartPole-v1, max_steps: 20, max_steps_keyword: max_episode_steps}\n")
    key = "env.kwargs.max_episode_steps"
    assert longest(task_of(load_config([words]))) == 20
    task = task_of(load_config([words], [f"{key}=30"]))
    assert (task.max_steps, task.kwargs, longest(task)) == (30, {}, 30)
    assert longest(replace(task, max_steps=60)) == 60
    for wrong in ("0", "many", "true"):
        with pytest.raises(ConfigError, match=f"{key}: expected a number of steps, found "):
            task_of(load_config([words], [f"{key}={wrong}"]))


class Brittle(Late):
    """Nobody thought of a seventh step."""

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        if self.t == 6:
            raise IndexError("no seventh step")
        return super().step(action)


def test_the_longer_episode_is_tried_before_a_run_begins(tmp_path: Path) -> None:
    task = Task(name="brittle", make=partial(Brittle, 99), max_steps=6, interactions={3: 0, 4: 1})
    assert train(configured(), tmp_path / "plain", StringIO(), task=task)
    with pytest.raises(IndexError, match="no seventh step"):
        train(configured("env.horizon_factor=2"), tmp_path / "longer", StringIO(), task=task)
    assert not (tmp_path / "longer").exists()


def test_a_run_keeps_to_what_its_task_decided_when_it_began(tmp_path: Path) -> None:
    """As of an earlier version, which let no episode last longer."""
    task = late(99, max_steps_keyword="max_steps")
    before = configured("env.horizon_factor=1", "env.retry_share=0")
    assert last_row(tmp_path, task, before)["env_steps"] == 24 * 6
    assert last_row(tmp_path, task, configured("train.episodes=48"))["env_steps"] == 48 * 6
    assert (read_config(tmp_path).env.horizon_factor, read_config(tmp_path).env.retry_share) == (1, 0)
    with pytest.raises(CheckpointError, match=r"other values of env\.horizon_factor"):
        train(configured("train.episodes=48", "env.horizon_factor=2"), tmp_path, StringIO(), task=task)


def test_a_task_that_has_become_longer_cannot_go_on(tmp_path: Path) -> None:
    train(configured("method.name=vhs", "method.replay_ratio=1"), tmp_path, StringIO(), task=late(5))
    longer, more = replace(late(5), max_steps=8), configured("train.episodes=48", "method.replay_ratio=1")
    with pytest.raises(CheckpointError, match=r"expected episodes of up to 6 steps in training, .* found 8"):
        train(more, tmp_path, StringIO(), task=longer)


def test_a_late_run_goes_on_as_it_would_have(tmp_path: Path) -> None:
    task = late(9)
    whole, halved = tmp_path / "whole", tmp_path / "halved"
    last = last_row(whole, task, configured("train.episodes=48"))
    train(configured(), halved, StringIO(), task=task)
    again = last_row(halved, task, configured("train.episodes=48"))
    assert {key: value for key, value in again.items() if not key.startswith(("time", "speed"))} == {
        key: value for key, value in last.items() if not key.startswith(("time", "speed"))
    }
    ours, theirs = (load_agent(run, task).agent.state_dict() for run in (whole, halved))
    assert all(np.array_equal(ours[name], theirs[name]) for name in ours)


@pytest.mark.parametrize(
    ("override", "found"), [("", (2, 0.25)), ("vhs_weight=0", (1, 0)), ("name=pg", (1, 0))]
)
def test_what_is_not_imitated_gets_no_more_time(override: str, found: tuple[float, float]) -> None:
    config = load_config(
        [], ["task=task2", "env.num_workers=0", *([f"method.{override}"] if override else [])]
    )
    env = settled(config, learn_spec(config, task_of(config))).env
    assert (env.horizon_factor, env.retry_share) == found


@pytest.mark.parametrize(("steps", "gamma"), [(1, 0.9), (20, 0.9), (50, 0.96), (200, 0.99)])
def test_the_discount_follows_from_how_long_an_episode_may_last(steps: int, gamma: float) -> None:
    spec = replace(TOY_SPEC, max_episode_steps=steps)
    assert settled(toy_config("vhs"), spec).train.gamma == pytest.approx(gamma)
    assert settled(toy_config("vhs", "train.gamma=0.5"), spec).train.gamma == 0.5


def test_the_discount_is_of_the_tasks_steps_and_not_of_the_longer_episode(tmp_path: Path) -> None:
    task = replace(late(9), max_steps=50)
    train(configured("env.horizon_factor=2", "train.episodes=24"), tmp_path, StringIO(), task=task)
    assert read_config(tmp_path).train.gamma == pytest.approx(0.96)
