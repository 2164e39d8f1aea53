"""`PoolVecEnv` beside stable-baselines3's own vectors, step for step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest

import vhs

pytest.importorskip("stable_baselines3", reason="an adapter for it")

from stable_baselines3 import DQN, PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from vhs.adapters.sb3 import HindsightBuffer, PoolVecEnv

from .goal_envs import LIMIT, Deadly, EndingLine, Line, Tile

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]  # they start processes


def same(one: Any, other: Any) -> None:
    """Nested values are equal, arrays in type and content."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            same(one[key], other[key])
    elif isinstance(one, list | tuple):
        assert len(one) == len(other)
        for mine, theirs in zip(one, other, strict=True):
            same(mine, theirs)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    else:
        assert one == other


@pytest.mark.parametrize("made", [Line, Tile, lambda: gymnasium.make("CartPole-v1", max_episode_steps=9)])
def test_steps_are_those_of_dummy_vec_env(made: Callable[[], Any]) -> None:
    ours, theirs = PoolVecEnv(made, 2, 2), DummyVecEnv([made] * 4)
    rng = np.random.default_rng(0)
    try:
        for vector in (ours, theirs):
            vector.seed(3)
            vector.set_options({"level": 2})
        for _ in range(2):  # the second time without seed and options
            same(ours.reset(), theirs.reset())
            same(ours.reset_infos, theirs.reset_infos)
            for _ in range(25):
                actions = rng.integers(0, 2, 4)
                same(ours.step(actions), theirs.step(actions))
                same(ours.reset_infos, theirs.reset_infos)
    finally:
        ours.close()


def test_environments_are_read_set_called_and_asked_for_their_wrappers() -> None:
    with pytest.raises(AttributeError):
        open_vector(lambda vector: vector.get_attr("nothing"))

    def asked(vector: PoolVecEnv) -> None:
        vector.reset()
        assert vector.env_is_wrapped(Monitor) == [True, False, True]
        assert vector.env_is_wrapped(Monitor, indices=1) == [False]
        vector.set_attr("goal", 7, indices=[2])
        vector.env_method("reset", seed=0, indices=[0])
        assert vector.get_attr("goal", indices=[2]) == [7]
        goals = np.zeros((5, 1), np.float32)
        rewards = vector.env_method("compute_reward", goals, goals, [{}] * 5, indices=[1])
        np.testing.assert_array_equal(rewards, np.zeros((1, 5)))
        assert vector.has_attr("compute_reward")
        assert not vector.has_attr("compute_anything")
        assert not vector.has_attr("get_episode_rewards")  # one of three has no Monitor
        assert vector.get_attr("get_episode_rewards", indices=[0])[0]() == []

    open_vector(asked)


def open_vector(use: Callable[[PoolVecEnv], Any]) -> None:
    vector = PoolVecEnv([lambda: Monitor(Line()), Line, lambda: Monitor(Line())], 3)
    try:
        use(vector)
    finally:
        vector.close()


def test_an_episode_that_died_with_its_worker_is_in_no_batch() -> None:
    vector = PoolVecEnv(Deadly, 2, on_error="restart")
    try:
        how = {"max_episode_steps": LIMIT, "n_envs": 2, "device": "cpu", "seed": 0}
        buffer = HindsightBuffer(200, vector.observation_space, vector.action_space, vector, **how)
        obs = vector.reset()
        for _ in range(2):
            actions = np.ones(2, np.int64)
            after, rewards, dones, infos = vector.step(actions)
            buffer.add(obs, after, actions, rewards, dones, infos)
            obs = after
        assert buffer.size() == 2
        after, rewards, dones, infos = vector.step(actions)
        assert dones.all()
        for env, info in enumerate(infos):
            assert info["cut"]
            assert info["TimeLimit.truncated"]
            np.testing.assert_array_equal(
                info["terminal_observation"]["observation"], obs["observation"][env]
            )
        buffer.add(obs, after, actions, rewards, dones, infos)
        assert buffer.size() == 0
        assert len(buffer.episodes) == 0
    finally:
        vector.close()


def test_a_vector_keeps_its_size_and_a_step_is_sent_before_it_is_waited_for() -> None:
    with pytest.raises(vhs.ArgumentError, match="on_error"):
        PoolVecEnv(Line, 1, on_error="drop")
    with pytest.raises(vhs.ArgumentError, match="env_fn"):
        PoolVecEnv("Line", 1)  # type: ignore[arg-type]
    vector = PoolVecEnv(Line, 1)
    with pytest.raises(vhs.ProtocolError, match="step_async"):
        vector.step_wait()
    vector.reset()
    vector.step_async(np.zeros(1, np.int64))
    vector.reset()  # what was pending is dropped
    vector.close()


def test_algorithms_learn_on_a_pool() -> None:
    vector = VecMonitor(PoolVecEnv(EndingLine, 2, 2))
    try:
        policy = {"net_arch": [32]}
        PPO("MultiInputPolicy", vector, n_steps=32, policy_kwargs=policy, device="cpu").learn(256)
        model = DQN(
            "MultiInputPolicy",
            vector,
            replay_buffer_class=HindsightBuffer,
            replay_buffer_kwargs={"max_episode_steps": LIMIT},
            buffer_size=5000,
            learning_starts=100,
            policy_kwargs=policy,
            seed=0,
            device="cpu",
        )
        model.learn(400)
        reward, _ = evaluate_policy(model, vector, n_eval_episodes=8)
        assert -LIMIT <= reward <= 0
    finally:
        vector.close()
