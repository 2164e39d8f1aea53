"""The gymnasium face equals gymnasium's own, step for step."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from rollout_envs import Floats, Ledger, Misbehaved

from vhs import ArgumentError
from vhs.rollout import RolloutVectorEnv


def cart_pole() -> gym.Env[Any, Any]:
    return gym.make("CartPole-v1")


def pendulum() -> gym.Env[Any, Any]:
    return gym.make("Pendulum-v1", max_episode_steps=20)


def blackjack() -> gym.Env[Any, Any]:
    return gym.make("Blackjack-v1")


def assert_same(ours: Any, theirs: Any) -> None:
    if isinstance(theirs, dict):
        assert set(ours) == set(theirs)
        for key in theirs:
            assert_same(ours[key], theirs[key])
    elif isinstance(theirs, tuple):
        assert len(ours) == len(theirs)
        for one, other in zip(ours, theirs, strict=True):
            assert_same(one, other)
    elif isinstance(theirs, np.ndarray) and theirs.dtype == object:
        for one, other in zip(ours, theirs, strict=True):
            assert_same(one, other)
    elif theirs is None:
        assert ours is None
    else:
        np.testing.assert_array_equal(ours, theirs)
        assert np.asarray(ours).dtype == np.asarray(theirs).dtype


def test_the_seed_of_the_pool_is_that_of_the_first_episodes_too() -> None:
    first = []
    for _ in range(2):
        with RolloutVectorEnv(cart_pole, 1, 2, seed=7) as env:
            first.append(env.reset()[0])
    np.testing.assert_array_equal(*first)


@pytest.mark.parametrize("env_fn", [cart_pole, pendulum, blackjack, Ledger])
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_every_step_equals_gymnasiums(env_fn: Any, mode: str) -> None:
    theirs = SyncVectorEnv([env_fn] * 4, autoreset_mode=mode)
    ours = RolloutVectorEnv(env_fn, 2, 2, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] is AutoresetMode(mode)
    for name in ("observation_space", "action_space", "single_observation_space", "single_action_space"):
        assert getattr(ours, name) == getattr(theirs, name)
    assert_same(ours.reset(seed=5), theirs.reset(seed=5))
    ours.action_space.seed(1)
    for _ in range(120):
        actions = ours.action_space.sample()
        assert_same(ours.step(actions), theirs.step(actions))
    assert_same(ours.reset(seed=[1, 2, 3, 4]), theirs.reset(seed=[1, 2, 3, 4]))
    ours.close()
    theirs.close()


def test_disabled_autoreset_with_a_mask_equals_gymnasiums() -> None:
    theirs = SyncVectorEnv([cart_pole] * 4, autoreset_mode="Disabled")
    ours = RolloutVectorEnv(cart_pole, 2, 2, autoreset_mode="Disabled")
    assert_same(ours.reset(seed=5), theirs.reset(seed=5))
    ours.action_space.seed(1)
    resets = 0
    for _ in range(150):
        actions = ours.action_space.sample()
        step = ours.step(actions)
        assert_same(step, theirs.step(actions))
        done = step[2] | step[3]
        if done.any():
            resets += 1
            options = {"reset_mask": done}
            assert_same(ours.reset(options=options), theirs.reset(options=dict(options)))
    assert resets > 3
    with pytest.raises(ValueError, match="reset_mask"):
        ours.reset(options={"reset_mask": np.zeros(4, bool)})
    ours.close()


def test_attributes_calls_and_rendering() -> None:
    with RolloutVectorEnv(lambda: gym.make("FrozenLake-v1", render_mode="ansi"), 2, 1) as env:
        env.reset(seed=0)
        assert env.render_mode == "ansi"
        frames = env.render()
        assert len(frames) == 2
        assert "FFHF" not in frames[0]
        assert "SFFF" in frames[0].replace("\x1b[41mS\x1b[0m", "S")
    with RolloutVectorEnv(cart_pole, 2, 1) as env:
        env.set_attr("gravity", [1.0, 2.0])
        assert env.get_attr("gravity") == (1.0, 2.0)
        assert env.call("get_wrapper_attr", "gravity") == (1.0, 2.0)
        with pytest.raises(ArgumentError, match="expected 2"):
            env.set_attr("gravity", [1.0])


def test_gymnasiums_vector_wrappers_work() -> None:
    env = gym.wrappers.vector.RecordEpisodeStatistics(RolloutVectorEnv(cart_pole, 2, 2))
    env.reset(seed=0)
    lengths = []
    for _ in range(100):
        *_, infos = env.step(np.ones(4, np.int64))
        if "episode" in infos:
            lengths += infos["episode"]["l"][infos["_episode"]].tolist()
    assert len(lengths) > 10
    assert max(lengths) < 15, "always pushing right falls soon"
    env.close()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_cut_episode_appears_as_truncated(mode: str, tmp_path: Any) -> None:
    env_fn = lambda: Misbehaved("die", tmp_path)  # noqa: E731
    env = RolloutVectorEnv(env_fn, 1, 1, autoreset_mode=mode)
    env.reset(seed=3)
    cuts = 0
    for _ in range(40):
        _, reward, terminated, truncated, infos = env.step(np.array([9]))
        if "cut" in infos:
            cuts += 1
            assert truncated.tolist() == [True]
            assert terminated.tolist() == [False]
            assert reward.tolist() == [0.0]
    assert cuts > 2
    env.close()


def test_a_size_that_changes_is_refused() -> None:
    with pytest.raises(ArgumentError, match="keeps its size"):
        RolloutVectorEnv(Floats, 1, on_error="drop")
