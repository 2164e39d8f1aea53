"""`PoolEnv` under TorchRL's own checks and losses, and batches as its TensorDicts."""

from __future__ import annotations

import importlib
import multiprocessing
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import vhs

torch = pytest.importorskip("torch")
pytest.importorskip("torchrl", reason="an adapter for it")

from torchrl.data import Categorical  # noqa: E402
from torchrl.envs import check_env_specs  # noqa: E402

from vhs.adapters.tensordict import tensordict_of  # noqa: E402
from vhs.adapters.torchrl import PoolEnv  # noqa: E402

from .goal_envs import LIMIT, Deadly, EndingLine, Line, Tile  # noqa: E402

# Importing TorchRL told it to spawn, and not these tests alone: as if nobody had said anything.
multiprocessing.set_start_method(None, force=True)  # type: ignore[arg-type]

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]  # they start processes


class Counted(gymnasium.Env[Any, Any]):
    """Actions are numbered from 5; what was done is seen."""

    observation_space = spaces.MultiDiscrete([100, 3])
    action_space = spaces.Discrete(3, start=5)

    def reset(self, **_: Any) -> Any:
        return np.array([0, 0]), {}

    def step(self, action: Any) -> Any:
        return np.array([action, 1]), 1.0, False, False, {}


@pytest.mark.parametrize(
    "made",
    [Line, Tile, lambda: EndingLine(is_continuous=True), Counted, lambda: gymnasium.make("FrozenLake-v1")],
)
def test_torchrl_finds_its_specs_right(made: Callable[[], Any]) -> None:
    env = PoolEnv(made, 2, 2, seed=0)
    try:
        check_env_specs(env)
        rollout = env.rollout(20, break_when_any_done=False)
        assert rollout.shape == (4, 20)
        # Steps of those that have not ended alone.
        assert env.rollout(40, break_when_any_done=False, break_when_all_done=True).shape[0] == 4
    finally:
        env.close()
    assert env.pool.closed


def test_steps_are_those_of_the_environments_and_ended_ones_are_begun_alone() -> None:
    env = PoolEnv(Line, 1, 3)
    env.set_seed(7)
    rollout = env.rollout(30, break_when_any_done=False)
    env.set_seed(7)
    again = env.rollout(30, break_when_any_done=False)
    env.close()
    assert (rollout["observation"][:, 0, ::2] == again["observation"][:, 0, ::2]).all()  # but its number
    before, after = rollout["observation"], rollout["next", "observation"]
    ways = 2 * rollout["action"] - 1
    places = torch.clamp(before[..., 0] + ways, 0, 20)
    assert (after[..., 0] == places).all()
    assert (after[..., 2] == before[..., 2] + 1).all()
    ended = rollout["next", "done"][:, :-1, 0]
    assert ended.any()
    assert (before[:, 1:][~ended] == after[:, :-1][~ended]).all()
    assert (before[:, 1:, 2][ended] == 0).all()
    reached = (rollout["next", "achieved_goal"] == rollout["desired_goal"]).all(-1, keepdim=True)
    assert (rollout["next", "terminated"] == reached).all()
    assert (rollout["next", "reward"] == reached.float() - 1).all()
    assert (rollout["next", "truncated"] == (after[..., 2:] == LIMIT)).all()


def test_numbered_actions_are_counted_from_zero() -> None:
    env = PoolEnv(Counted, 1)
    rollout = env.rollout(10)
    env.close()
    assert isinstance(env.action_spec, Categorical)
    assert (rollout["next", "observation"][..., 0] == rollout["action"] + 5).all()


def test_an_episode_that_died_with_its_worker_is_truncated_where_it_was_seen_last() -> None:
    env = PoolEnv(Deadly, 2, on_error="restart")
    rollout = env.rollout(5, policy=lambda td: td.set("action", torch.ones(2, dtype=torch.int64)))
    env.close()
    assert rollout.shape == (2, 3)
    last = rollout[:, -1]
    assert last["next", "truncated"].all()
    assert (last["next", "observation"] == last["observation"]).all()
    assert (last["next", "reward"] == 0).all()


def test_what_has_no_spec_is_refused_before_it_is_used() -> None:
    class Told(Counted):
        observation_space = spaces.Dict(text=spaces.Text(5), place=spaces.Discrete(2))

    with pytest.raises(vhs.ArgumentError, match=r"`observation_space`: expected Box, .* got Text"):
        PoolEnv(Told, 1)
    with pytest.raises(vhs.ArgumentError, match="on_error"):
        PoolEnv(Line, 1, on_error="drop")


def filled(**how: Any) -> vhs.EpisodeBuffer:
    fields = {"compass": vhs.Field((2,)), "skill": vhs.Field((), "int64", per="step")}
    shared = {"num_streams": 1, "max_episode_steps": 5, "capacity_steps": 50, "frame_stack": 1}
    buffer = vhs.EpisodeBuffer((2,), fields=fields, **shared, **how)
    for episode in range(4):
        compass = {"compass": np.zeros(2, np.float32)}
        goals = {key: np.float32([t]) for key, t in (("desired_goal", 9), ("achieved_goal", 0))}
        buffer.begin(0, np.uint8([episode, 0]), fields=compass, **(goals if how else {}))
        for t in range(1, 3 + episode % 2):
            reached = {"achieved_goal": np.float32([t])} if how else {}
            fields = {"compass": np.full(2, t, np.float32), "skill": t}
            buffer.append(0, 1, -1.0, 0.5, np.uint8([episode, t]), fields=fields, **reached)
        buffer.finish(0, "failure" if episode else "timeout")
    return buffer


VECTORS = {"goals": "vectors", "goal_shape": (1,)}


def test_transitions_have_what_follows_under_next() -> None:
    batch = filled(**VECTORS).sample_transitions(32, "future")
    made = tensordict_of(batch)
    assert made.shape == (32,)
    assert made["observation"].data_ptr() == batch.observations.ctypes.data
    assert (made["next", "observation"][:, 0, 1] == made["observation"][:, 0, 1] + 1).all()
    assert (made["next", "achieved_goal"][:, 0] == made["next", "observation"][:, 0, 1]).all()
    assert (made["achieved_goal"][:, 0] == made["observation"][:, 0, 1]).all()
    assert (made["next", "compass"][:, 0] == made["compass"][:, 0] + 1).all()
    assert (made["skill"] == made["next", "achieved_goal"][:, 0]).all()
    np.testing.assert_array_equal(made["desired_goal"], batch.goals)
    for key, wanted in (("reward", batch.rewards), ("terminated", batch.terminated)):
        np.testing.assert_array_equal(made["next", key][:, 0], wanted)
    np.testing.assert_array_equal(made["next", "done"][:, 0], batch.terminated | batch.truncated)


@pytest.mark.parametrize("is_window", [True, False])
def test_sequences_show_each_observation_before_and_after_from_one_memory(is_window: bool) -> None:
    buffer = filled(**VECTORS)
    batch: Any = buffer.sample_windows(6, 3) if is_window else buffer.gather([0, 1, 3], padded=True)
    made = tensordict_of(batch)
    assert made.shape == made["mask"].shape == made["next", "reward"].shape[:2]
    lived = made[made["mask"]]
    assert (lived["next", "observation"][:, 0, 1] == lived["observation"][:, 0, 1] + 1).all()
    assert (lived["next", "compass"][:, 0] == lived["skill"]).all()
    assert (lived["next", "achieved_goal"][:, 0] == lived["skill"]).all()
    assert (lived["desired_goal"] == 9).all()
    shared = made["observation"].untyped_storage().data_ptr()
    assert made["next", "observation"].untyped_storage().data_ptr() == shared
    if not is_window:
        assert made["next", "done"][..., 0].sum(1).tolist() == [1, 1, 1]
        assert made["next", "truncated"][0, 1, 0]
        assert made["next", "terminated"][1, 2, 0]


def test_goals_that_are_classes_are_labels() -> None:
    buffer = filled()
    assert tensordict_of(buffer.sample_windows(4, 2))["label"].shape == (4, 2)
    assert tensordict_of(buffer.gather([0, 1], padded=True))["label"].shape == (2, 3)
    assert "desired_goal" not in tensordict_of(buffer.sample_transitions(4)).keys()  # noqa: SIM118 - of a TensorDict
    with pytest.raises(vhs.ArgumentError, match="padded=True"):
        tensordict_of(buffer.gather([0, 1]))


def test_its_dqn_learns_from_our_batches_on_our_pool(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "examples")
    example = importlib.import_module("torchrl_dqn")
    assert example.train(6, 450, hindsight=True) > 0.7
