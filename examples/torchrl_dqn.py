"""TorchRL's DQN loss on our batches, and its environment interface on our pool: bit flipping.

python examples/torchrl_dqn.py                 # success 1.00, in half a minute on one core
python examples/torchrl_dqn.py --no-hindsight  # success 0.00 or so
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss, SoftUpdate

import vhs
from bit_flipping import BitFlipping
from vhs.adapters.tensordict import tensordict_of
from vhs.adapters.torchrl import PoolEnv

ENVS = 8


class Network(nn.Module):
    """A value for each bit that may be flipped."""

    def __init__(self, bits: int) -> None:
        """Of so many bits."""
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(2 * bits, 128), nn.ReLU(), nn.Linear(128, bits))

    def forward(self, observation: Tensor, goal: Tensor) -> Tensor:
        """Both [n, bits]; an observation of the buffer is a stack of one, [n, 1, bits]."""
        return self.layers(torch.cat([observation.reshape(goal.shape), goal], -1).float())


def record(buffer: vhs.EpisodeBuffer, step: TensorDict) -> list[bool]:
    """Record a step of every environment; whether each episode that ended was a success."""
    shown = {key: step[key].numpy() for key in ("observation", "achieved_goal", "desired_goal", "action")}
    after = {key: step["next", key].numpy() for key in ("observation", "achieved_goal", "reward", "done")}
    for env in np.flatnonzero(~buffer.open).tolist():
        goals = {key: shown[key][env] for key in ("achieved_goal", "desired_goal")}
        buffer.begin(env, shown["observation"][env], **goals)
    streams, rewards = np.arange(ENVS), after["reward"][:, 0]
    buffer.append_batch(
        streams, shown["action"], rewards, None, after["observation"], achieved_goals=after["achieved_goal"]
    )
    terminated, ended = step["next", "terminated"][:, 0].tolist(), []
    for env in np.flatnonzero(after["done"][:, 0]).tolist():
        ended.append(terminated[env])
        buffer.finish(env, "success" if terminated[env] else "timeout")
    return ended


def train(bits: int, steps: int, hindsight: bool, seed: int = 0) -> float:
    """Success rate over the last 100 episodes."""
    torch.manual_seed(seed)
    env = PoolEnv(lambda: BitFlipping(bits), num_workers=1, envs_per_worker=ENVS, seed=seed)
    # --- ours in place of torchrl.data.TensorDictReplayBuffer
    buffer = vhs.EpisodeBuffer(
        (bits,),
        dtype="int8",
        frame_stack=1,
        goals="vectors",
        goal_shape=(bits,),
        goal_dtype="int8",
        num_actions=bits,
        num_streams=ENVS,
        max_episode_steps=bits,
        capacity_steps=50_000,
        seed=seed,
    )
    how: dict[str, Any] = {"relabel": "future", "ratio": 4} if hindsight else {}
    # ---
    actor = QValueActor(Network(bits), in_keys=["observation", "desired_goal"], action_space="categorical")
    loss = DQNLoss(actor, action_space="categorical", delay_value=True)
    loss.make_value_estimator(gamma=0.95)
    optimiser, target = torch.optim.Adam(loss.parameters(), 1e-3), SoftUpdate(loss, eps=0.98)
    now, successes = env.reset(), []
    for step in range(steps):
        with torch.no_grad():
            now = actor(now)
        explores = torch.rand(ENVS) < (0.2 if step < 0.8 * steps else 0.0)
        now["action"] = torch.where(explores, torch.randint(bits, (ENVS,)), now["action"])
        lived, now = env.step_and_maybe_reset(now)
        successes += record(buffer, lived)
        if not len(buffer):
            continue
        batch = tensordict_of(buffer.sample_transitions(128, **how))
        optimiser.zero_grad()
        loss(batch)["loss"].backward()
        optimiser.step()
        target.step()
    env.close()
    return float(np.mean(successes[-100:]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--bits", type=int, default=10)
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--no-hindsight", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print(f"success {train(arguments.bits, arguments.steps, not arguments.no_hindsight):.2f}")
