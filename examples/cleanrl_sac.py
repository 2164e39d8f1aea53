"""SAC in the shape of CleanRL's `sac_continuous_action.py`, with our buffer: changes are between `# vhs`.

The code is ours; the shape (one file, one loop, the names) is that of github.com/vwxyzjn/cleanrl.
The task is to bring a point in a square to another one, for 0 a step there and -1 elsewhere.

    python examples/cleanrl_sac.py                 # success 1.00, in half a minute on one core
    python examples/cleanrl_sac.py --no-hindsight  # success 0.00
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import torch
import torch.nn as nn
import torch.nn.functional as F
import torch.optim as optim
from gymnasium import spaces

# vhs: in place of `from cleanrl_utils.buffers import ReplayBuffer`
import vhs
from vhs.adapters.torch import tensors_of
from vhs.recorder import HindsightRecorder, make_buffer

# vhs

STEPS, NEAR = 20, 0.1


class Reach(gym.Env[dict[str, Any], Any]):
    """A point in the square from -1 to 1, moved by up to 0.2 a step; it is there within 0.1 of its goal."""

    def __init__(self) -> None:
        """One square."""
        place = spaces.Box(-1, 1, (2,), np.float32)
        self.observation_space = spaces.Dict(observation=place, achieved_goal=place, desired_goal=place)
        self.action_space = spaces.Box(-1, 1, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Two places anywhere."""
        super().reset(seed=seed)
        self.place, self.goal = self.np_random.uniform(-1, 1, (2, 2)).astype(np.float32)
        self.time = 0
        return self._seen(), {}

    def step(self, action: Any) -> Any:
        """Move."""
        self.place = np.clip(self.place + 0.2 * np.clip(action, -1, 1), -1, 1).astype(np.float32)
        self.time += 1
        there = bool(np.linalg.norm(self.place - self.goal) <= NEAR)
        return self._seen(), float(there) - 1, False, self.time == STEPS, {"is_success": there}

    def _seen(self) -> dict[str, Any]:
        return {"observation": self.place, "achieved_goal": self.place, "desired_goal": self.goal}


@dataclass
class Args:
    """Settings."""

    seed: int = 1
    total_timesteps: int = 4000
    buffer_size: int = 50_000
    gamma: float = 0.95
    tau: float = 0.02
    batch_size: int = 256
    learning_starts: int = 400
    policy_lr: float = 1e-3
    q_lr: float = 1e-3
    train_frequency: int = 2
    alpha: float = 0.05
    hindsight: bool = True


def mlp(inputs: int, outputs: int) -> nn.Sequential:
    """Two hidden layers."""
    return nn.Sequential(
        nn.Linear(inputs, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, outputs)
    )


class SoftQNetwork(nn.Module):
    """The value of an action."""

    def __init__(self) -> None:
        """Of two numbers, as places and goals have."""
        super().__init__()
        self.network = mlp(6, 1)

    def forward(self, x: torch.Tensor, goal: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
        """All [n, 2]."""
        return self.network(torch.cat([x, goal, a], 1)).view(-1)


class Actor(nn.Module):
    """A squashed normal distribution of actions."""

    def __init__(self) -> None:
        """Of two numbers."""
        super().__init__()
        self.network = mlp(4, 4)

    def get_action(self, x: torch.Tensor, goal: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """A drawn action [n, 2] and its log-probability [n]."""
        mean, log_std = self.network(torch.cat([x, goal], 1)).chunk(2, -1)
        normal = torch.distributions.Normal(mean, log_std.clamp(-5, 1).exp())
        x_t = normal.rsample()
        squashed = 2 * (np.log(2) - x_t - F.softplus(-2 * x_t))  # log of the derivative of tanh
        return torch.tanh(x_t), (normal.log_prob(x_t) - squashed).sum(1)


def train(args: Args) -> float:
    """Success rate over the last 50 episodes."""
    torch.manual_seed(args.seed)
    env = Reach()
    env.action_space.seed(args.seed)
    actor, qf1, qf2, qf1_target, qf2_target = Actor(), *(SoftQNetwork() for _ in range(4))
    qf1_target.load_state_dict(qf1.state_dict())
    qf2_target.load_state_dict(qf2.state_dict())
    q_optimizer = optim.Adam(itertools.chain(qf1.parameters(), qf2.parameters()), lr=args.q_lr)
    actor_optimizer = optim.Adam(actor.parameters(), lr=args.policy_lr)

    # vhs: in place of `rb = ReplayBuffer(args.buffer_size, env.observation_space, env.action_space, device)`
    rb = make_buffer(env, capacity_steps=args.buffer_size, max_episode_steps=STEPS, seed=args.seed)
    env = HindsightRecorder(env, rb)
    # Reaching the goal pays, and ends nothing.
    reward = vhs.SparseReward(0.0, -1.0, tolerance=NEAR, terminates=False)
    how: dict[str, Any] = {"relabel": "future", "ratio": 4, "reward": reward} if args.hindsight else {}
    # vhs

    successes = []
    obs, _ = env.reset(seed=args.seed)
    for global_step in range(args.total_timesteps):
        if global_step < args.learning_starts:
            action = env.action_space.sample()
        else:
            with torch.no_grad():
                shown = (torch.from_numpy(obs[key])[None] for key in ("observation", "desired_goal"))
                action = actor.get_action(*shown)[0][0].numpy()
        obs, _, terminated, truncated, info = env.step(action)
        # vhs: `rb.add(obs, real_next_obs, actions, rewards, terminations, infos)` is gone: `env` records
        if terminated or truncated:
            successes.append(info["is_success"])
            obs, _ = env.reset()

        if global_step > args.learning_starts and global_step % args.train_frequency == 0:
            # vhs: in place of `data = rb.sample(args.batch_size)`
            data = tensors_of(rb.sample_transitions(args.batch_size, **how))
            x, next_x, goals = data["observations"][:, 0], data["next_observations"][:, 0], data["goals"]
            # vhs
            with torch.no_grad():
                next_actions, next_log_pi = actor.get_action(next_x, goals)
                next_q = (qf(next_x, goals, next_actions) for qf in (qf1_target, qf2_target))
                soft = torch.min(*next_q) - args.alpha * next_log_pi
                target = data["rewards"] + ~data["terminated"] * args.gamma * soft
            qf_loss = sum(F.mse_loss(qf(x, goals, data["actions"]), target) for qf in (qf1, qf2))
            q_optimizer.zero_grad()
            qf_loss.backward()
            q_optimizer.step()

            pi, log_pi = actor.get_action(x, goals)
            actor_loss = (args.alpha * log_pi - torch.min(qf1(x, goals, pi), qf2(x, goals, pi))).mean()
            actor_optimizer.zero_grad()
            actor_loss.backward()
            actor_optimizer.step()

            for qf, qf_target in ((qf1, qf1_target), (qf2, qf2_target)):
                for current, slow in zip(qf.parameters(), qf_target.parameters(), strict=True):
                    slow.data.lerp_(current.data, args.tau)
    return float(np.mean(successes[-50:]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-hindsight", action="store_true")
    given = parser.parse_args()
    torch.set_num_threads(1)
    print(f"success {train(Args(seed=given.seed, hindsight=not given.no_hindsight)):.2f}")
