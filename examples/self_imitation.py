"""Self-imitation in hindsight with an environment and a network of one's own, put together from the library.

An agent walks on tiles and is asked for a colour. It imitates its successes, and its failures as if the
colour that they reached had been asked for: their goal is the last picture, through the same network that
gives each colour the mean of its pictures, its prototype. In a quarter of a minute on one core:

    python examples/self_imitation.py                 # success 0.53
    python examples/self_imitation.py --no-hindsight  # success 0.23
"""

from __future__ import annotations

import argparse
from itertools import product
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor, nn

import vhs
from vhs.losses import hindsight_imitation_loss, supcon_loss
from vhs.recorder import HindsightRecorder, make_buffer

COLOURS = np.array(list(product((0, 255), repeat=3))[1:], np.uint8)
WAYS = ((0, 1), (0, -1), (1, 0), (-1, 0))
STREAMS = 16


class Tiles(gymnasium.Env[dict[str, Any], Any]):
    """Seven of 5x5 tiles have a colour each; they are seen from the one stood on, and have no edges.

    An episode ends on the first coloured tile: a success where it is the one asked for; or after 8 steps.
    """

    observation_space = spaces.Dict(image=spaces.Box(0, 255, (5, 5, 3), np.uint8), goal=spaces.Discrete(7))
    action_space = spaces.Discrete(4)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """New tiles and a colour to reach."""
        super().reset(seed=seed)
        tiles = np.zeros((25, 3), np.uint8)
        tiles[np.delete(np.arange(25), 12)[self.np_random.permutation(24)[:7]]] = COLOURS
        self.tiles, self.goal, self.time = tiles.reshape(5, 5, 3), int(self.np_random.integers(7)), 0
        return self._seen(), {}

    def step(self, action: Any) -> Any:
        """Walk to a neighbouring tile."""
        self.tiles = np.roll(self.tiles, WAYS[action], (0, 1))
        self.time += 1
        here = self.tiles[2, 2]
        return self._seen(), float((here == COLOURS[self.goal]).all()), bool(here.any()), self.time == 8, {}

    def _seen(self) -> dict[str, Any]:
        return {"image": self.tiles, "goal": self.goal}


class Network(nn.Module):
    """Features of a picture, and a policy that a goal's features gate."""

    def __init__(self) -> None:
        """Random weights."""
        super().__init__()
        self.pixels = nn.Sequential(nn.Linear(3, 32), nn.ReLU())
        self.features = nn.Sequential(nn.Flatten(), nn.Linear(800, 64), nn.LayerNorm(64))
        self.gate = nn.Sequential(nn.Linear(64, 32), nn.Sigmoid())
        self.policy = nn.Sequential(nn.Flatten(), nn.Linear(800, 128), nn.ReLU(), nn.Linear(128, 4))

    def embed(self, pictures: Tensor) -> Tensor:
        """Features [n, 64] of pictures uint8 [n, 5, 5, 3]."""
        return self.features(self.pixels(pictures / 255))

    def forward(self, pictures: Tensor, goals: Tensor) -> Tensor:
        """Log-probabilities of the actions, [n, 4], at pictures for goals [n, 64]."""
        gated = self.pixels(pictures / 255) * self.gate(goals)[:, None, None]
        return self.policy(gated).log_softmax(-1)


def train(episodes: int, hindsight: bool, seed: int = 0) -> float:
    """Success rate over the last 320 episodes, which take the likeliest actions."""
    torch.manual_seed(seed)
    buffer = make_buffer(Tiles(), capacity_steps=10_000, max_episode_steps=8, num_streams=STREAMS, seed=seed)
    envs = [HindsightRecorder(Tiles(), buffer, stream=stream) for stream in range(STREAMS)]
    for stream, env in enumerate(envs):
        env.reset(seed=seed + stream)
    goals = vhs.GoalStore(7, buffer.observation_shape, capacity_per_class=200, seed=seed)
    prototypes = vhs.Prototypes(7, 64, seed=seed)
    net = Network()
    optimiser, wins = torch.optim.Adam(net.parameters(), 2e-3), []
    for begun in range(0, episodes, STREAMS):
        is_last = begun >= episodes - 320
        told = [env.reset()[0]["goal"] for env in envs]
        embedded = torch.from_numpy(prototypes.embed(told))
        while len(running := np.flatnonzero(buffer.open)):
            with torch.no_grad():
                log_probs = net(torch.from_numpy(buffer.observe(running))[:, 0], embedded[running])
            sampled = torch.multinomial(log_probs.exp(), 1)[:, 0]
            for stream, action in zip(running, log_probs.argmax(-1) if is_last else sampled, strict=True):
                envs[stream].step(int(action))
        ids = buffer.ids[-STREAMS:]
        wins += (buffer.gather(ids).outcomes == vhs.Outcome.SUCCESS).tolist()
        goals.collect(buffer, ids)
        for _ in range(0 if is_last else 4):
            loss = imitate(net, buffer, prototypes, hindsight) + recognise(net, goals, prototypes)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    return float(np.mean(wins[-320:]))


def imitate(net: Network, buffer: vhs.EpisodeBuffer, prototypes: vhs.Prototypes, hindsight: bool) -> Tensor:
    """Do as episodes did, where they succeeded and, in hindsight, where they failed."""
    batch = buffer.sample_episodes(64, "final", probability=float(hindsight), padded=True)
    pictures, actions = torch.from_numpy(batch.observations)[:, :, 0], torch.from_numpy(batch.actions)
    new = torch.from_numpy(batch.hindsight.selected)
    ends = pictures.flatten(0, 1)[batch.hindsight.goal_rows]
    goals = torch.where(new[:, None], net.embed(ends), torch.from_numpy(prototypes.embed(batch.goals)))
    steps = actions.shape[1]
    log_probs = net(pictures[:, :-1].flatten(0, 1), goals.repeat_interleave(steps, 0)).unflatten(
        0, actions.shape
    )
    is_taught = new | torch.from_numpy(batch.outcomes == vhs.Outcome.SUCCESS)
    valid = torch.from_numpy(batch.mask) * is_taught[:, None].float()
    taken = log_probs.gather(-1, actions.unsqueeze(-1)).squeeze(-1)
    zeros = torch.zeros_like(valid)  # no critic here
    return hindsight_imitation_loss(taken, zeros, zeros, valid, valid.sum()).policy


def recognise(net: Network, goals: vhs.GoalStore, prototypes: vhs.Prototypes) -> Tensor | float:
    """Features of one colour close to each other and far from the others', and the prototypes their means."""
    if not len(goals):
        return 0.0
    pictures, labels = goals.sample(64)
    features = net.embed(torch.from_numpy(pictures)[:, 0])
    prototypes.update(features.detach().numpy(), labels)
    return supcon_loss(features, torch.from_numpy(labels), temperature=0.2)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--episodes", type=int, default=4000)
    parser.add_argument("--no-hindsight", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print(f"success {train(arguments.episodes, not arguments.no_hindsight):.2f}")
