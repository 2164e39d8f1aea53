"""`HindsightBuffer` under the real algorithms of stable-baselines3."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import vhs

sb3 = pytest.importorskip("stable_baselines3", reason="an adapter for it")

from gymnasium import spaces  # noqa: E402
from stable_baselines3 import DDPG, DQN, PPO, SAC, TD3, HerReplayBuffer  # noqa: E402
from stable_baselines3.common.envs import BitFlippingEnv  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize  # noqa: E402

from vhs.adapters.sb3 import HindsightBuffer  # noqa: E402

from .goal_envs import LIMIT, EndingLine, EndingLineByRow, Line, Tile  # noqa: E402

Made = Callable[[], gymnasium.Env[Any, Any]]


def buffer_of(made: Made = EndingLine, envs: int = 1, size: int = 600, **how: Any) -> HindsightBuffer:
    env = DummyVecEnv([made] * envs)
    how = {"max_episode_steps": LIMIT, "device": "cpu", "n_envs": envs, "seed": 0} | how
    return HindsightBuffer(size, env.observation_space, env.action_space, env, **how)


def fill(buffer: HindsightBuffer, steps: int, seed: int = 0, other: Any = None) -> list[dict[str, Any]]:
    """Random play, recorded as the algorithms do; each transition as it was."""
    env, rng = buffer.env, np.random.default_rng(seed)
    assert env is not None
    env.seed(seed)
    obs, lived = env.reset(), []
    for _ in range(steps):
        actions = rng.integers(0, 2, env.num_envs)
        after, rewards, dones, infos = env.step(actions)
        ended = copy.deepcopy(after)
        for i in np.flatnonzero(dones):
            for key in ended:
                ended[key][i] = infos[i]["terminal_observation"][key]
        for taker in filter(None, (buffer, other)):
            taker.add(obs, ended, actions, rewards, dones, infos)
        for i in range(env.num_envs):
            cut = infos[i]["TimeLimit.truncated"]
            lived.append({"obs": obs, "next": ended, "env": i, "action": actions[i], "cut": cut})
            lived[-1] |= {"done": dones[i], "reward": rewards[i]}
        obs = after
    return lived


@pytest.mark.parametrize("made", [Line, EndingLine, EndingLineByRow])
@pytest.mark.parametrize("envs", [1, 3])
def test_a_batch_has_what_was_lived_and_under_a_new_goal_its_reward_and_end(made: Made, envs: int) -> None:
    buffer = buffer_of(made, envs)
    lived = fill(buffer, 120)
    by_place = {tuple(t["obs"]["observation"][0]): t for t in lived} if envs == 1 else None
    data = buffer.sample(400)
    seen, after = (
        {k: v.numpy() for k, v in part.items()} for part in (data.observations, data.next_observations)
    )
    assert data.actions.shape == data.rewards.shape == data.dones.shape == (400, 1)
    kinds = [part.numpy().dtype for part in (data.actions, data.rewards, data.dones)]
    assert kinds == [np.int64, np.float32, np.float32]
    goals = seen["desired_goal"]
    np.testing.assert_array_equal(goals, after["desired_goal"])
    np.testing.assert_array_equal(seen["achieved_goal"][:, 0], seen["observation"][:, 0])
    np.testing.assert_array_equal(after["achieved_goal"][:, 0], after["observation"][:, 0])
    reached = (after["achieved_goal"] == goals).all(-1)
    np.testing.assert_array_equal(data.rewards[:, 0].numpy(), reached - 1.0)
    if made is not Line:
        np.testing.assert_array_equal(data.dones[:, 0].numpy(), reached)
    if by_place is not None:
        new = 0
        for row in range(400):
            was = by_place[tuple(seen["observation"][row])]
            np.testing.assert_array_equal(after["observation"][row], was["next"]["observation"][0])
            assert data.actions[row, 0] == was["action"]
            told = was["obs"]["desired_goal"][0]
            new += int((goals[row] != told).any())
            if made is Line and (goals[row] == told).all():
                assert data.dones[row, 0] == (was["done"] and not was["cut"])
        assert new > 200


def test_an_episode_that_a_limit_cut_off_ends_for_the_learner_only_where_it_is_asked_for() -> None:
    ends = {}
    for handles in (True, False):
        buffer = buffer_of(Line, handle_timeout_termination=handles, n_sampled_goal=0)
        lived = fill(buffer, 120)
        data = buffer.sample(500)
        at_limit = data.next_observations["observation"][:, 2].numpy() == LIMIT
        failed = data.rewards[:, 0].numpy() < 0
        ends[handles] = data.dones[at_limit & failed, 0].numpy()
        assert any(t["cut"] for t in lived)
    assert len(ends[True]) > 0
    assert not ends[True].any()
    assert ends[False].all()


@pytest.mark.parametrize("strategy", ["final", "future", "episode"])
def test_goals_are_distributed_as_those_of_her_replay_buffer(strategy: str) -> None:
    buffer = buffer_of(Line, goal_selection_strategy=strategy)
    assert buffer.env is not None
    spaces_of = (buffer.observation_space, buffer.action_space, buffer.env)
    theirs = HerReplayBuffer(600, *spaces_of, device="cpu", goal_selection_strategy=strategy)
    fill(buffer, 40, other=theirs)
    np.random.seed(0)  # noqa: NPY002 - the other library draws from numpy's global generator
    counts = []
    for data in (buffer.sample(40_000), theirs.sample(40_000)):
        columns = [
            data.observations["observation"],
            data.observations["desired_goal"],
            data.rewards,
            data.dones,
        ]
        rows = np.concatenate([column.numpy() for column in columns], axis=1)
        counts.append(
            {tuple(row): n for row, n in zip(*np.unique(rows, axis=0, return_counts=True), strict=True)}
        )
    ours, their = counts
    for key in ours.keys() | their.keys():
        n, m = ours.get(key, 0), their.get(key, 0)
        assert abs(n - m) < 6 * np.sqrt(n + m) + 1, key


def test_a_reset_in_the_middle_of_an_episode_glues_nothing_together() -> None:
    buffer = buffer_of(Line, n_sampled_goal=0)
    fill(buffer, 4)
    fill(buffer, 30, seed=1)
    data = buffer.sample(300)
    before, after = data.observations["observation"], data.next_observations["observation"]
    assert (before[:, 1] == after[:, 1]).all()
    assert ((after[:, 2] - before[:, 2]) == 1).all()
    assert (before[:, 1] == 1).any()  # the episode that was cut off is there


def test_a_goal_that_changes_begins_an_episode_that_was_not_terminated() -> None:
    buffer = buffer_of(Line, n_sampled_goal=0)
    shown = Line()
    shown.reset(seed=0)
    for step in range(6):
        before = {key: part[None] for key, part in shown.seen().items()}
        before["desired_goal"] = np.full((1, 1), 10.0 + step // 3, np.float32)
        shown.step(1)
        after = {key: part[None] for key, part in shown.seen().items()} | {
            "desired_goal": before["desired_goal"]
        }
        done = np.array([step == 5])
        buffer.add(before, after, np.ones(1), np.array([-1.0]), done, [{"TimeLimit.truncated": True}])
    assert len(buffer.episodes) == 2
    data = buffer.sample(100)
    assert set(data.observations["desired_goal"][:, 0].tolist()) == {10.0, 11.0}
    assert not data.dones.any()


def test_images_are_stored_once_as_bytes_and_given_back_as_they_were() -> None:
    buffer = buffer_of(Tile, goals="observations")
    lived = fill(buffer, 100)
    frames = buffer.episodes.num_steps + len(buffer.episodes) + 1
    assert buffer.episodes.nbytes < 2 * frames * 36 * 36 * 3
    data = buffer.sample(200)
    pictures = {t["obs"]["observation"][0].tobytes() for t in lived}
    pictures |= {t["next"]["observation"][0].tobytes() for t in lived}
    for part in (data.observations, data.next_observations):
        for key in ("observation", "achieved_goal", "desired_goal"):
            assert part[key].dtype.itemsize == 1
            assert part[key].shape == (200, 36, 36, 3)
    assert {picture.numpy().tobytes() for picture in data.observations["observation"]} <= pictures
    reached = (
        (data.next_observations["achieved_goal"] == data.observations["desired_goal"]).all(-1).all(-1).all(-1)
    )
    np.testing.assert_array_equal(data.rewards[:, 0].numpy(), reached.numpy() - 1.0)
    np.testing.assert_array_equal(data.dones[:, 0].numpy(), reached.numpy())


def test_further_entries_of_an_observation_are_given_back_too() -> None:
    class Guided(EndingLine):
        def __init__(self) -> None:
            super().__init__()
            self.observation_space["compass"] = spaces.Box(-1e6, 1e6, (2, 2), np.float64)
            self.observation_space["half"] = spaces.Discrete(2)

        def seen(self) -> dict[str, Any]:
            return super().seen() | {"compass": np.full((2, 2), self.place - 0.5), "half": self.place // 11}

    buffer = buffer_of(Guided)
    fill(buffer, 100)
    data = buffer.sample(100)
    for shown in (data.observations, data.next_observations):
        places = shown["observation"][:, 0].numpy()
        np.testing.assert_array_equal(
            shown["compass"], np.broadcast_to(places[:, None, None] - 0.5, (100, 2, 2))
        )
        np.testing.assert_array_equal(shown["half"][:, 0], places // 11)


def test_infos_reach_compute_reward_where_they_are_kept() -> None:
    class Timed(Line):
        def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
            return np.array([float(each["time"]) for each in info])

    buffer = buffer_of(Timed, size=60, copy_info_dict=True)
    fill(buffer, 200)
    data = buffer.sample(200)
    new = data.rewards[:, 0] > 0
    assert new.sum() > 100
    assert (data.rewards[new, 0] == data.next_observations["observation"][new, 2]).all()
    # Those of evicted episodes are forgotten, at the latest when the next one ends.
    kept, stored = set(buffer.infos_by_episode), set(buffer.episodes.ids.tolist())
    assert stored <= kept
    assert len(kept - stored) <= LIMIT


def test_a_rule_or_a_function_rewards_instead_of_the_environment() -> None:
    class Bare(Line):
        compute_reward = None  # type: ignore[assignment]

    def halves(achieved: Any, desired: Any) -> Any:
        return (achieved == desired)[:, 0] / 2, np.zeros(len(desired), bool)

    for reward, paid in ((vhs.SparseReward(3.0, 1.0), {1.0, 3.0}), (halves, {0.0, 0.5})):
        buffer = buffer_of(Bare, reward=reward)
        fill(buffer, 100)
        assert paid <= set(buffer.sample(300).rewards[:, 0].tolist()) <= paid | {-1.0, 0.0}


def test_a_normaliser_is_applied_when_steps_are_drawn() -> None:
    buffer = buffer_of(Line)
    fill(buffer, 100)
    assert buffer.env is not None
    normaliser = VecNormalize(buffer.env, norm_obs_keys=["observation"])  # type: ignore[arg-type]
    normaliser.obs_rms["observation"].mean[:] = 5.0  # type: ignore[index]
    state = buffer.episodes.rng_state
    plain = buffer.sample(64)
    buffer.episodes.rng_state = state
    shown = buffer.sample(64, env=normaliser)
    wanted = np.clip(plain.observations["observation"].numpy() - 5.0, -10, 10)
    np.testing.assert_allclose(shown.observations["observation"].numpy(), wanted, rtol=1e-5)
    np.testing.assert_array_equal(shown.observations["desired_goal"], plain.observations["desired_goal"])


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", [DQN, SAC, TD3, DDPG])
def test_algorithms_train_save_load_and_go_on(algorithm: Any, tmp_path: Path) -> None:
    made = EndingLine if algorithm is DQN else lambda: EndingLine(is_continuous=True)
    how = {"max_episode_steps": LIMIT}
    model = algorithm(
        "MultiInputPolicy",
        DummyVecEnv([made] * 2),
        replay_buffer_class=HindsightBuffer,
        replay_buffer_kwargs=how,
        buffer_size=500,
        learning_starts=40,
        batch_size=16,
        seed=0,
        policy_kwargs={"net_arch": [16]},
        device="cpu",
    )
    model.learn(100)
    model.save_replay_buffer(tmp_path / "buffer")
    drawn = model.replay_buffer.sample(8)
    model.load_replay_buffer(tmp_path / "buffer")
    again = model.replay_buffer.sample(8)
    for key in drawn.observations:
        np.testing.assert_array_equal(drawn.observations[key], again.observations[key])
    np.testing.assert_array_equal(drawn.rewards, again.rewards)
    steps = model.replay_buffer.size()
    model.learn(60)
    assert model.replay_buffer.size() > steps


def test_a_sparse_rule_is_saved_too() -> None:
    buffer = buffer_of(Line, reward=vhs.SparseReward(3.0, 1.0))
    fill(buffer, 60)
    again = copy.deepcopy(buffer)
    assert {1.0, 3.0} <= set(again.sample(300).rewards[:, 0].tolist())


def test_reset_forgets_episodes() -> None:
    buffer = buffer_of()
    fill(buffer, 60)
    assert buffer.size() == 60
    buffer.reset()
    assert (buffer.size(), buffer.pos, len(buffer.episodes)) == (0, 0, 0)
    with pytest.raises(vhs.EmptyError, match="learning_starts"):
        buffer.sample(4)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"optimize_memory_usage": True}, "stored once in any case"),
        (
            {"goal_selection_strategy": "nearest"},
            "expected one of final, future, episode, random, got 'nearest'",
        ),
        ({"max_episode_steps": None}, "registered without a limit"),
        ({"size": 5}, "expected at least 6, an episode of 6 steps"),
        ({"goals": "observations"}, "expected 'vectors'"),
        ({"gae_lambda": 0.95, "gamma": 0.9}, r"learns off-policy .* got gae_lambda, gamma"),
        ({"n_steps": 3}, "got n_steps"),
        (
            {"made": lambda: gymnasium.make("CartPole-v1")},
            "expected a dictionary of observation, achieved_goal",
        ),
    ],
)
def test_what_it_cannot_serve_is_refused_in_a_sentence(how: dict[str, Any], said: str) -> None:
    with pytest.raises(vhs.ArgumentError, match=said):
        buffer_of(**how)


def test_an_algorithm_that_learns_on_policy_is_refused() -> None:
    with pytest.raises(vhs.ArgumentError, match="off-policy"):
        PPO("MultiInputPolicy", Line(), rollout_buffer_class=HindsightBuffer, device="cpu")


def test_an_environment_without_a_reward_of_goals_is_refused() -> None:
    class Bare(gymnasium.Env[Any, Any]):
        observation_space = Line().observation_space
        action_space = spaces.Discrete(2)

    with pytest.raises(vhs.ArgumentError, match="compute_reward"):
        buffer_of(Bare)


def test_what_was_reached_must_be_what_is_seen_where_it_is_said_to_be() -> None:
    buffer = buffer_of(Tile, goals="observations")
    shown = {key: part[None] for key, part in Tile().reset(seed=0)[0].items()}
    with pytest.raises(vhs.ArgumentError, match="achieved_goal"):
        buffer.add(
            shown,
            shown | {"achieved_goal": 255 - shown["observation"]},
            np.zeros(1),
            np.zeros(1),
            [False],
            [{}],
        )
    assert buffer.size() == 0


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_bits_are_flipped_with_hindsight_and_not_without() -> None:
    # Seeds 0 to 2: 1.00 of the last 40 episodes with it, 0.00 to 0.03 without.
    assert flipped(n_sampled_goal=4) > 0.8
    assert flipped(n_sampled_goal=0) < 0.2


def flipped(**how: Any) -> float:
    """How often DQN reaches the goal in its last episodes; trained for two or three seconds."""
    model = DQN(
        "MultiInputPolicy",
        BitFlippingEnv(n_bits=8),
        replay_buffer_class=HindsightBuffer,
        replay_buffer_kwargs={"max_episode_steps": 8, "reward": vhs.SparseReward(0.0, -1.0), **how},
        learning_rate=2e-3,
        buffer_size=10_000,
        learning_starts=100,
        batch_size=64,
        train_freq=1,
        target_update_interval=100,
        exploration_fraction=0.3,
        exploration_final_eps=0.02,
        gamma=0.95,
        policy_kwargs={"net_arch": [64]},
        seed=0,
        device="cpu",
    )
    model.learn(800)
    assert model.ep_success_buffer is not None
    return float(np.mean(list(model.ep_success_buffer)[-40:]))


@pytest.mark.slow
def test_pictures_train_a_network_that_has_them_channel_first() -> None:
    model = DQN(
        "MultiInputPolicy",
        Tile(),
        replay_buffer_class=HindsightBuffer,
        replay_buffer_kwargs={"goals": "observations", "max_episode_steps": LIMIT},
        buffer_size=2000,
        learning_starts=50,
        train_freq=8,
        seed=0,
        device="cpu",
    )
    model.learn(200)
    assert model.replay_buffer is not None
    data = model.replay_buffer.sample(4)
    assert tuple(data.observations["observation"].shape) == (4, 3, 36, 36)
    assert tuple(data.observations["desired_goal"].shape) == (4, 3, 36, 36)
