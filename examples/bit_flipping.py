"""A DQN in sixty lines, of the kind that stable-baselines3 has, fed by our buffer: bit flipping.

The task of Andrychowicz et al. 2017, section 3.1: flip bits one at a time until they equal a goal; -1 a step,
0 on arrival. Chance all but never arrives, so a learner without hindsight learns nothing.

    python examples/bit_flipping.py                 # success 0.99 or so, in half a minute on one core
    python examples/bit_flipping.py --no-hindsight  # success 0.01 or so
"""

from __future__ import annotations

import argparse
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from torch import nn

from vhs.recorder import HindsightRecorder, make_buffer


class BitFlipping(gymnasium.Env[dict[str, Any], Any]):
    """`n` bits, and as many actions that each flip one; an episode has at most `n` steps."""

    def __init__(self, n: int) -> None:
        """So many bits."""
        bits = spaces.MultiBinary(n)
        self.observation_space = spaces.Dict(observation=bits, achieved_goal=bits, desired_goal=bits)
        self.action_space = spaces.Discrete(n)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Random bits and a random goal."""
        super().reset(seed=seed)
        self.bits, self.goal = self.np_random.integers(0, 2, (2, self.action_space.n), dtype=np.int8)
        self.time = 0
        return self._seen(), {}

    def step(self, action: Any) -> Any:
        """Flip one bit."""
        self.bits[action] ^= 1
        self.time += 1
        reached = bool((self.bits == self.goal).all())
        return self._seen(), float(reached) - 1, reached, self.time == len(self.bits), {"is_success": reached}

    def _seen(self) -> dict[str, Any]:
        return {"observation": self.bits.copy(), "achieved_goal": self.bits.copy(), "desired_goal": self.goal}


def values(net: nn.Module, bits: Any, goals: Any) -> torch.Tensor:
    """One value an action."""
    return net(torch.cat([torch.as_tensor(bits), torch.as_tensor(goals)], -1).float())


def train(n: int, episodes: int, hindsight: bool, seed: int = 0) -> float:
    """Success rate of the greedy policy over the last tenth of the episodes."""
    torch.manual_seed(seed)
    rng, env = np.random.default_rng(seed), BitFlipping(n)
    env.reset(seed=seed)
    buffer = make_buffer(env, capacity_steps=100_000, max_episode_steps=n, seed=seed)
    env = HindsightRecorder(env, buffer)
    net, target = (nn.Sequential(nn.Linear(2 * n, 256), nn.ReLU(), nn.Linear(256, n)) for _ in range(2))
    target.load_state_dict(net.state_dict())
    optimiser, successes = torch.optim.Adam(net.parameters(), 1e-3), []
    how = {"relabel": "future", "ratio": 4} if hindsight else {}
    for episode in range(episodes):
        observation, _ = env.reset()
        explore = 0.0 if episode >= 0.9 * episodes else 0.2
        done = False
        while not done:
            with torch.no_grad():
                q = values(net, observation["observation"], observation["desired_goal"])
            action = int(rng.integers(n)) if rng.random() < explore else int(q.argmax())
            observation, _, terminated, truncated, info = env.step(action)
            done = terminated or truncated
        successes.append(info["is_success"])
        for _ in range(n):
            batch = buffer.sample_transitions(128, **how)
            with torch.no_grad():
                best = values(target, batch.next_observations[:, 0], batch.goals).max(1).values
                wanted = torch.from_numpy(batch.rewards) + 0.98 * best * ~torch.from_numpy(batch.terminated)
            q = values(net, batch.observations[:, 0], batch.goals)
            loss = nn.functional.smooth_l1_loss(q[range(128), torch.from_numpy(batch.actions)], wanted)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            with torch.no_grad():
                for old, new in zip(target.parameters(), net.parameters(), strict=True):
                    old.lerp_(new, 0.02)
    return float(np.mean(successes[-episodes // 10 :]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--bits", type=int, default=12)
    parser.add_argument("--episodes", type=int, default=1500)
    parser.add_argument("--no-hindsight", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print(f"success {train(arguments.bits, arguments.episodes, not arguments.no_hindsight):.2f}")
