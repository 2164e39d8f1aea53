"""The rooms on the pool: the same episodes as in this process, for any number of workers."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import vhs.envs
from vhs.rollout import RolloutPool

pytestmark = pytest.mark.timeout(300)
STEPS, ENVS = 30, 4


def room() -> gym.Env[Any, Any]:
    vhs.envs.register_envs()
    return gym.make("vhs/InteractiveObjectNav-v0")


def actions_of(step: int) -> np.ndarray:
    return np.random.default_rng(step).integers(0, 4, ENVS)


def alone() -> list[list[bytes]]:
    """The reference: environments in this process, each ended one begun anew with the next seed."""
    envs, seeds = [room() for _ in range(ENVS)], iter(range(100, 200))
    shown = [env.reset(seed=next(seeds))[0]["image"] for env in envs]
    history = [[image.tobytes() for image in shown]]
    for step in range(STEPS):
        ended = []
        for stream, (env, action) in enumerate(zip(envs, actions_of(step), strict=True)):
            observation, _, terminated, truncated, _ = env.step(action)
            shown[stream] = observation["image"]
            if terminated or truncated:
                ended.append(stream)
        history.append([image.tobytes() for image in shown])
        for stream in ended:
            shown[stream] = envs[stream].reset(seed=next(seeds))[0]["image"]
        history.append([image.tobytes() for image in shown])
    return history


def on_pool(workers: int) -> list[list[bytes]]:
    """The same in lock-step: the learner hands the next seed to each ended environment, in their order."""
    seeds = iter(range(100, 200))
    with RolloutPool(room, workers, ENVS // workers, autoreset="Disabled") as pool:
        pool.reset(seeds=[next(seeds) for _ in range(ENVS)])
        shown = list(pool.recv().observation["image"])
        history = [[image.tobytes() for image in shown]]
        for step in range(STEPS):
            pool.send(actions_of(step))
            batch = pool.recv()
            shown = list(batch.observation["image"])
            history.append([image.tobytes() for image in shown])
            ended = np.flatnonzero(batch.terminated | batch.truncated)
            assert all("outcome" in batch.infos[row] for row in ended)
            if len(ended):
                pool.reset(ended, seeds=[next(seeds) for _ in ended])
                for stream, image in zip(ended, pool.recv().observation["image"], strict=True):
                    shown[stream] = image
            history.append([image.tobytes() for image in shown])
    return history


@pytest.mark.slow
def test_rooms_show_the_same_images_alone_and_on_any_number_of_workers() -> None:
    expected = alone()
    for workers in (1, 2, 4):
        assert on_pool(workers) == expected
