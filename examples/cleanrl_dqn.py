"""A DQN in the shape of CleanRL's `dqn.py`, with our buffer: what changes is between `# vhs` marks.

The code is ours; the shape (one file, one loop, the names) is that of github.com/vwxyzjn/cleanrl.

    python examples/cleanrl_dqn.py                 # success 1.00, in a minute on one core
    python examples/cleanrl_dqn.py --no-hindsight  # success 0.00 or so
"""

from __future__ import annotations

import argparse
import random
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import torch
import torch.nn as nn
import torch.nn.functional as F
import torch.optim as optim

from bit_flipping import BitFlipping

# vhs: in place of `from cleanrl_utils.buffers import ReplayBuffer`
from vhs.adapters.torch import tensors_of
from vhs.recorder import HindsightRecorder, make_buffer

# vhs


@dataclass
class Args:
    """Settings."""

    seed: int = 1
    bits: int = 10
    total_timesteps: int = 10_000
    learning_rate: float = 1e-3
    buffer_size: int = 50_000
    gamma: float = 0.95
    tau: float = 1.0
    target_network_frequency: int = 100
    batch_size: int = 128
    start_e: float = 1.0
    end_e: float = 0.02
    exploration_fraction: float = 0.5
    learning_starts: int = 200
    train_frequency: int = 2
    hindsight: bool = True


class QNetwork(nn.Module):
    """A value of each action."""

    def __init__(self, env: gym.Env) -> None:
        """For an environment."""
        super().__init__()
        bits = env.action_space.n
        self.network = nn.Sequential(nn.Linear(2 * bits, 128), nn.ReLU(), nn.Linear(128, bits))

    def forward(self, x: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
        """Of observations and goals, [n, bits] each."""
        return self.network(torch.cat([x, goal], -1).float())


def linear_schedule(start_e: float, end_e: float, duration: float, t: int) -> float:
    """Share of random actions."""
    return max((end_e - start_e) / duration * t + start_e, end_e)


def train(args: Args) -> float:
    """Success rate over the last 100 episodes."""
    random.seed(args.seed)
    torch.manual_seed(args.seed)
    env = BitFlipping(args.bits)
    env.action_space.seed(args.seed)
    q_network, target_network = QNetwork(env), QNetwork(env)
    optimizer = optim.Adam(q_network.parameters(), lr=args.learning_rate)
    target_network.load_state_dict(q_network.state_dict())

    # vhs: in place of `rb = ReplayBuffer(args.buffer_size, env.observation_space, env.action_space, device)`
    rb = make_buffer(env, capacity_steps=args.buffer_size, max_episode_steps=args.bits, seed=args.seed)
    env = HindsightRecorder(env, rb)
    how = {"relabel": "future", "ratio": 4} if args.hindsight else {}
    # vhs

    successes = []
    obs, _ = env.reset(seed=args.seed)
    for global_step in range(args.total_timesteps):
        duration = args.exploration_fraction * args.total_timesteps
        if random.random() < linear_schedule(args.start_e, args.end_e, duration, global_step):
            action = env.action_space.sample()
        else:
            with torch.no_grad():
                shown = (torch.from_numpy(obs[key]) for key in ("observation", "desired_goal"))
                action = int(q_network(*shown).argmax())
        obs, _, terminated, truncated, info = env.step(action)
        # vhs: `rb.add(obs, real_next_obs, actions, rewards, terminations, infos)` is gone: `env` records
        if terminated or truncated:
            successes.append(info["is_success"])
            obs, _ = env.reset()

        if global_step > args.learning_starts:
            if global_step % args.train_frequency == 0:
                # vhs: in place of `data = rb.sample(args.batch_size)`
                data = tensors_of(rb.sample_transitions(args.batch_size, **how))
                x, next_x, goals = data["observations"][:, 0], data["next_observations"][:, 0], data["goals"]
                # vhs
                with torch.no_grad():
                    target_max, _ = target_network(next_x, goals).max(dim=1)
                    # `terminated` says where the task under the row's goal was over: a limit of time is not
                    td_target = data["rewards"] + args.gamma * target_max * ~data["terminated"]
                old_val = q_network(x, goals).gather(1, data["actions"][:, None]).squeeze()
                loss = F.mse_loss(td_target, old_val)
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
            if global_step % args.target_network_frequency == 0:
                for target, current in zip(target_network.parameters(), q_network.parameters(), strict=True):
                    target.data.lerp_(current.data, args.tau)
    return float(np.mean(successes[-100:]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-hindsight", action="store_true")
    given = parser.parse_args()
    torch.set_num_threads(1)
    print(f"success {train(Args(seed=given.seed, hindsight=not given.no_hindsight)):.2f}")
