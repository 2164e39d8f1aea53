"""Episodes of training last longer than those of the task; rates and evaluation know the task's own steps."""

from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy import Toy, toy_config

from vhs.acting.policy import load_agent
from vhs.config import Config
from vhs.eval import evaluate
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
