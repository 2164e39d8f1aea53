"""The same recorded episodes in other libraries' replay buffers: what `bench_buffers` compares with.

Each function returns a call that draws a batch, or None where the library is not installed (they are the
extra `rivals`). Every library gets the observation pair as one image and the goal as an image, as its users
do it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

# An observation of two stacked frames, as channels.
IMAGE = (6, 84, 84)
Draw = Callable[[int], object]


class _ImageGoals:
    """What stable-baselines3 asks of an environment: its spaces and its reward."""

    num_envs = 1

    def env_method(self, name: str, achieved: Any, desired: Any, info: Any, indices: Any = None) -> list[Any]:
        equal = (achieved == desired).reshape(len(achieved), -1).all(1)
        return [np.where(equal, 0.0, -1.0)]


def stable_baselines3(steps: int, length: int, images: NDArray[np.uint8]) -> Draw | None:
    """`HerReplayBuffer`, strategy future, 4 to 1."""
    try:
        from gymnasium import spaces
        from stable_baselines3 import HerReplayBuffer
    except ImportError:
        return None
    image = spaces.Box(0, 255, IMAGE, np.uint8)
    space = spaces.Dict(dict.fromkeys(("observation", "achieved_goal", "desired_goal"), image))
    env: Any = _ImageGoals()
    buffer = HerReplayBuffer(steps, space, spaces.Discrete(4), env, n_sampled_goal=4)
    for step in range(steps):
        here, there = (images[(step + more) % len(images)][None] for more in (0, 1))
        seen, after = (dict.fromkeys(space.spaces, image) for image in (here, there))
        done = np.array([step % length == length - 1])
        buffer.add(seen, after, np.zeros((1, 1)), np.array([-1.0]), done, [{}])
    return buffer.sample


def torchrl(steps: int, length: int, images: NDArray[np.uint8]) -> Draw | None:
    """`TensorDictReplayBuffer` with image, next image and goal; it does not relabel, which saves it time."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import torch
            from tensordict import TensorDict
            from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
    except ImportError:
        return None
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(steps), batch_size=64)
    tensors = torch.from_numpy(images)
    for start in range(0, steps, 100):
        rows = torch.arange(start, min(start + 100, steps))
        pick = [tensors[(rows + more) % len(images)] for more in (0, 1, length)]
        parts = {"observation": pick[0], "next": {"observation": pick[1]}, "goal": pick[2]}
        buffer.extend(TensorDict({**parts, "action": torch.zeros(len(rows))}, batch_size=[len(rows)]))
    return lambda n: buffer.sample(n)


def cpprb(steps: int, length: int, images: NDArray[np.uint8]) -> Draw | None:
    """`HindsightReplayBuffer`, strategy future, 4 to 1; it stores the relabelled copies."""
    try:
        from cpprb import HindsightReplayBuffer
    except ImportError:
        return None
    buffer = HindsightReplayBuffer(
        steps,
        {
            "obs": {"shape": IMAGE, "dtype": np.uint8},
            "act": {},
            "next_obs": {"shape": IMAGE, "dtype": np.uint8},
        },
        max_episode_len=length,
        reward_func=lambda state, action, goal: -np.ones((len(state), 1)),
        goal_shape=IMAGE,
        state="obs",
        action="act",
        next_state="next_obs",
        strategy="future",
        additional_goals=4,
    )
    # Each recorded step is stored five times: so many fill the buffer.
    for step in range(steps // 5):
        here, there = (images[(step + more) % len(images)] for more in (0, 1))
        buffer.add(obs=here, act=0, next_obs=there)
        if step % length == length - 1:
            buffer.on_episode_end(images[(step + 2) % len(images)])
    return buffer.sample


RIVALS = {"SB3": stable_baselines3, "TorchRL": torchrl, "cpprb": cpprb}
