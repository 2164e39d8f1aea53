"""The gymnasium face equals gymnasium's own, step for step."""

import multiprocessing
import time
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import AlreadyPendingCallError, ClosedEnvironmentError, NoAsyncCallError
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from rollout_envs import Floats, Ledger, Misbehaved

from vhs import ArgumentError
from vhs.rollout import RolloutVectorEnv

pytestmark = pytest.mark.slow


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


def test_a_call_in_two_parts_equals_one_and_out_of_order_it_is_refused() -> None:
    with RolloutVectorEnv(cart_pole, 2, 1) as ours, RolloutVectorEnv(cart_pole, 2, 1) as other:
        with pytest.raises(NoAsyncCallError, match="`reset_wait` without any prior call to `reset_async`"):
            ours.reset_wait()
        ours.reset_async(seed=3)
        assert_same(ours.reset_wait(), other.reset(seed=3))
        ours.step_async(np.array([0, 1]))
        with pytest.raises(
            AlreadyPendingCallError, match="`reset_async` while waiting for a pending call to `step`"
        ):
            ours.reset_async()
        with pytest.raises(NoAsyncCallError, match="`reset_wait`"):
            ours.reset_wait()
        assert_same(ours.step_wait(timeout=20), other.step(np.array([0, 1])))
        with pytest.raises(NoAsyncCallError, match="`step_wait`"):
            ours.step_wait()


def test_a_step_whose_time_is_over_is_still_pending() -> None:
    with RolloutVectorEnv(Patient, 1, 2) as env:
        env.reset(seed=0)
        env.step_async([1, 2])
        for error in (TimeoutError, multiprocessing.TimeoutError):
            with pytest.raises(error, match=r"expected 2 environments to answer within 0\.01 s"):
                env.step_wait(timeout=0.01)
        assert env.step_wait()[1].tolist() == [1.0, 2.0]


class Patient(Ledger):
    def step(self, action: Any) -> Any:
        time.sleep(0.3)
        return super().step(action)


def test_a_vector_that_closes_with_a_pending_call_says_so() -> None:
    env = RolloutVectorEnv(Patient, 1, 2)
    env.reset(seed=0)
    env.step_async([1, 2])
    with pytest.warns(UserWarning, match="Calling `close` while waiting for a pending call to `step`"):
        env.close(terminate=True)
    with pytest.raises(ClosedEnvironmentError):
        env.reset()
    env.close()


def test_an_error_of_one_environment_leaves_the_vector_of_use(tmp_path: Any) -> None:
    fns = [lambda: Misbehaved("raise", tmp_path, 1), Ledger]
    with RolloutVectorEnv(fns, 2, 1) as env:
        env.reset(seed=4)
        env.step([0, 0])
        with pytest.raises(ZeroDivisionError, match="a deed"):
            env.step([0, 0])
        assert env.pool.num_under_way == 0
        env.reset(seed=4)
        assert env.step([0, 3])[1].tolist() == [0.0, 3.0]


def test_generators_and_their_seeds_are_those_of_the_environments() -> None:
    with RolloutVectorEnv(cart_pole, 1, 3) as env:
        env.reset(seed=42)
        assert env.np_random_seed == (42, 43, 44)
        drawn = [generator.random() for generator in env.np_random]
        assert drawn == [generator.random() for generator in env.np_random], "copies"
        assert len(set(drawn)) == 3


@pytest.mark.parametrize(
    ("mask", "error", "message"),
    [
        ([True, False], TypeError, "must be a numpy array, got <class 'list'>"),
        (np.array([True]), ValueError, r"must have shape `\(2,\)`, got \(1,\)"),
        (np.array([1, 0]), TypeError, "must have `dtype=np.bool_`, got int64"),
        (np.array([False, False]), ValueError, "at least one True value"),
    ],
)
def test_a_mask_is_refused_in_gymnasiums_words(mask: Any, error: type[Exception], message: str) -> None:
    with RolloutVectorEnv(cart_pole, 1, 2, autoreset_mode="Disabled") as env:
        env.reset()
        with pytest.raises(error, match=message):
            env.reset(options={"reset_mask": mask})


class Painter(Ledger):
    """Renders frames that need more room than an info has."""

    metadata = {"render_modes": ["rgb_array", "rgb_array_list"], "render_fps": 30}  # noqa: RUF012

    def __init__(self, render_mode: str) -> None:
        self.render_mode = render_mode

    def render(self) -> Any:
        frame = np.full((400, 600, 3), self.steps, np.uint8)
        return frame if self.render_mode == "rgb_array" else [frame] * 5


def test_frames_of_any_size_are_rendered_at_default_settings() -> None:
    for mode, shape in (("rgb_array", (400, 600, 3)), ("rgb_array_list", (5, 400, 600, 3))):
        with RolloutVectorEnv(lambda mode=mode: Painter(mode), 2, 2) as env:
            env.reset(seed=3)
            for step in range(3):
                frames = np.asarray(env.render())
                assert frames.shape == (4, *shape)
                assert (frames == step).all()
                env.step([0] * 4)
