"""Environments and a library that we did not write: they must be installed for these tests."""

from __future__ import annotations

import importlib
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import vhs
from vhs.recorder import HindsightRecorder, Instruction, make_buffer

from .test_recorder import play

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]


def make(package: str, name: str) -> gymnasium.Env[Any, Any]:
    """An environment of another package, which the extra `dev` brings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gymnasium.register_envs(importlib.import_module(package))
        return gymnasium.make(name)


def test_point_maze_is_recorded_and_rewarded_by_its_own_rule() -> None:
    env = make("gymnasium_robotics", "PointMaze_UMaze-v3")
    buffer = make_buffer(env, capacity_steps=3000)
    assert (buffer.goals, buffer.goal_shape, buffer.goal_dtype) == ("vectors", (2,), np.float64)
    recorder = HindsightRecorder(env, buffer)
    seen = play(recorder, 3)
    batch = buffer.gather([0])
    np.testing.assert_array_equal(batch.observations[:, 0], [step[0]["observation"] for step in seen[0]])
    np.testing.assert_array_equal(batch.actions[0], [step[1][0] for step in seen[0][1:]])
    rows = buffer.sample_transitions(400, "future", ratio=4, reward=recorder.reward)
    distance = np.linalg.norm(rows.achieved_goals - rows.goals, axis=-1)
    np.testing.assert_array_equal(rows.rewards, distance <= 0.45)
    # The built-in rule, at this environment's distance.
    rule = vhs.SparseReward(1.0, 0.0, tolerance=0.45)
    rows = buffer.sample_transitions(400, "future", ratio=4, reward=rule)
    distance = np.linalg.norm(rows.achieved_goals - rows.goals, axis=-1)
    new = rows.relabelled
    np.testing.assert_array_equal(rows.rewards[new], (distance <= 0.45)[new])


def test_baby_ai_gives_image_goals_by_its_missions() -> None:
    env = make("minigrid", "BabyAI-GoToLocal-v0")
    missions: dict[str, int] = {}
    reader = Instruction(goal=lambda seen: missions.setdefault(seen["mission"], len(missions)))
    buffer = make_buffer(env, capacity_steps=4000, max_episode_steps=64, reader=reader, num_goals=100)
    recorder = HindsightRecorder(env, buffer, reader=reader)
    seen = play(recorder, 30)
    store = vhs.GoalStore(100, buffer.observation_shape, 50)
    stored = store.collect(buffer, buffer.ids)
    successes = [number for number, steps in enumerate(seen) if steps[-1][1][1] > 0]
    assert stored == len(successes) > 0
    for number in successes:
        label = missions[seen[number][0][0]["mission"]]
        images = store.sample_class(label, 50)[:, 0]
        assert (images == seen[number][-1][0]["image"]).all(axis=(1, 2, 3)).any()
    rows = buffer.sample_transitions(200, "future", probability=1.0)
    for row in range(200):
        shown = seen[rows.ids[row]][rows.goal_steps[row]][0]["image"]
        np.testing.assert_array_equal(rows.goals[row, 0], shown)


class _Recorded(gymnasium.Env[Any, Any]):
    """What the other library asks of an environment: its spaces and its reward."""

    def __init__(self) -> None:
        number = spaces.Box(-1, 1e6, (1,), np.float32)
        self.observation_space = spaces.Dict(
            dict.fromkeys(("observation", "achieved_goal", "desired_goal"), number)
        )
        self.action_space = spaces.Discrete(2)

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
        return -(achieved != desired).any(-1).astype(np.float32)


LENGTHS = [1, 2, 5, 3, 4, 1, 7]


@pytest.mark.parametrize("strategy", ["final", "future", "episode"])
def test_strategies_agree_with_stable_baselines3_as_distributions(strategy: str) -> None:
    ours, theirs = _our_counts(strategy, 60_000), _their_counts(strategy, 60_000)
    assert ours.keys() == theirs.keys()
    for key in ours:
        spread = np.sqrt(ours[key] + theirs[key])
        assert abs(ours[key] - theirs[key]) < 6 * spread, key


def _number(episode: int, t: int) -> float:
    """A number for every observation of every episode, so that a goal says where it is from."""
    return float(100 * episode + t)


def _our_counts(strategy: str, n: int) -> dict[tuple[float, float, float], int]:
    buffer = vhs.EpisodeBuffer(
        (1,),
        num_streams=1,
        max_episode_steps=7,
        capacity_steps=40,
        frame_stack=1,
        dtype="float32",
        goals="vectors",
        goal_shape=(1,),
    )
    for episode, length in enumerate(LENGTHS):
        numbers = [np.array([_number(episode, t)], np.float32) for t in range(length + 1)]
        buffer.begin(0, numbers[0], desired_goal=-np.ones(1, np.float32), achieved_goal=numbers[0])
        for t in range(length):
            buffer.append(0, 0, -1.0, 0.0, numbers[t + 1], achieved_goal=numbers[t + 1])
        buffer.finish(0, "timeout")
    batch = buffer.sample_transitions(n, strategy, ratio=4)
    return _count(batch.observations[:, 0, 0], batch.goals[:, 0], batch.rewards)


def _their_counts(strategy: str, n: int) -> dict[tuple[float, float, float], int]:
    from stable_baselines3 import HerReplayBuffer
    from stable_baselines3.common.vec_env import DummyVecEnv

    env = DummyVecEnv([_Recorded])
    buffer = HerReplayBuffer(
        50, env.observation_space, env.action_space, env, n_sampled_goal=4, goal_selection_strategy=strategy
    )
    np.random.seed(0)  # noqa: NPY002 - the other library draws from numpy's global generator

    def shown(episode: int, t: int) -> dict[str, np.ndarray]:
        number = np.array([[_number(episode, t)]], np.float32)
        return {"observation": number, "achieved_goal": number, "desired_goal": -np.ones((1, 1), np.float32)}

    for episode, length in enumerate(LENGTHS):
        for t in range(length):
            done = np.array([t + 1 == length])
            here, there = shown(episode, t), shown(episode, t + 1)
            buffer.add(
                here, there, np.zeros((1, 1)), np.array([-1.0]), done, [{"TimeLimit.truncated": False}]
            )
    data = buffer.sample(n)
    observations = {name: part.numpy()[:, 0] for name, part in data.observations.items()}
    return _count(observations["observation"], observations["desired_goal"], data.rewards.numpy()[:, 0])


def _count(*columns: np.ndarray) -> dict[tuple[float, float, float], int]:
    rows, counts = np.unique(np.stack(columns, axis=1), axis=0, return_counts=True)
    return {tuple(row.tolist()): int(count) for row, count in zip(rows, counts, strict=True)}
