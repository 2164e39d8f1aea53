"""SPL by hand, and the evaluation of an agent that cannot be evaluated."""

from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import torch
from debug import debug_config

from vhs.acting.policy import load_agent
from vhs.envs.task import load_room
from vhs.errors import CheckpointError
from vhs.eval import evaluate
from vhs.eval.evaluate import success_weighted_by_path_length
from vhs.train import train


def test_spl_by_hand() -> None:
    success = np.array([True, True, False, True])
    optimal = np.array([4.0, 3.0, 5.0, 6.0])
    taken = np.array([8.0, 3.0, 5.0, 4.0])
    # 4/8 + 1 + 0 + at most 1, over 4 episodes
    assert success_weighted_by_path_length(success, optimal, taken) == pytest.approx(2.5 / 4)


def test_rooms_without_a_plan_within_the_horizon_are_left_out_of_spl(tmp_path: Path) -> None:
    config = debug_config("train.episodes=4", "env.room.horizon_steps=4")
    train(config, tmp_path / "run", StringIO())
    result = evaluate(tmp_path / "run", episodes=20)
    assert result.spl is not None
    assert result.optimal_steps is not None
    assert 0 < result.optimal_steps <= 4
    assert 0 <= result.spl <= 1


def test_a_run_without_a_checkpoint_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("task: task2\n")
    with pytest.raises(CheckpointError, match=r"expected a checkpoint in .*checkpoints, found none"):
        evaluate(tmp_path)


def test_a_run_with_a_damaged_configuration_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("task: task9\n")
    with pytest.raises(CheckpointError, match=r"config.yaml: damaged configuration: task: expected"):
        evaluate(tmp_path)


def test_an_agent_is_shown_an_object_and_asked_for_it_alone(tmp_path: Path) -> None:
    """What is asked for is the task's, what names it the pictures': the same agent, other episodes."""
    train(debug_config("train.episodes=4", "env.room.goals=[mustard]"), tmp_path / "run", StringIO())
    agent = load_agent(tmp_path / "run", load_room("task2", room={"goals": ["milk"]}))
    assert not agent.goals.prototypes.seen[4]
    agent.show("milk", np.zeros((1, 84, 84, 3), np.uint8))
    before = {name: value.clone() for name, value in agent.agent.state_dict().items()}
    asked = evaluate(agent, episodes=8)
    assert (asked.episodes, asked.trained_episodes) == (8, 4)
    assert asked == evaluate(agent, episodes=8)
    assert all(torch.equal(value, before[name]) for name, value in agent.agent.state_dict().items())
