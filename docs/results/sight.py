"""What an agent's eyes can tell: `python docs/results/sight.py AGENT...`.

An AGENT is a run or an exported agent. Random walks through rooms give views, each with the pixels that the
simulator says every object covers. On the features f(o) of two thirds of the rooms a classifier of the size
of the agent's own heads learns which objects are in view, and on the others it is asked: of views that show
so many pixels of an object, how many does it tell from views without it, at .5 % false alarms? The same is
asked of the agent's own head, where it learned to localise.
"""

import argparse
import json
import shlex
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits
from visible import Visible

from vhs.acting.policy import Policy, load_agent
from vhs.acting.seeds import episode_seeds
from vhs.envs import OBJECT_NAMES, RoomEnv
from vhs.runs.directory import describe

BINS_PX = (10, 25, 50, 75, 100, 150, 84 * 84)
"""Fewer pixels than the first are neither in view nor out of it."""
FALSE_ALARMS = 0.005
FORWARD, TURN_LEFT, TURN_RIGHT = 0, 1, 2
PASSES, BATCH = 30, 512


class Views(NamedTuple):
    """N views of some rooms."""

    features: Tensor
    """f(o), shape [N, feature_dim]."""
    pixels: NDArray[np.int64]
    """Of each object, shape [N, objects]."""


def look_around(trained: Policy, rooms: int, seed: int) -> list[Views]:
    """Views of a random walk through each room."""
    env = trained.task.new_env()
    room: RoomEnv = env.unwrapped  # type: ignore[assignment]
    visible, rng = Visible(room), np.random.default_rng(seed)
    stack = trained.config.model.frame_stack
    found = []
    for _, room_seed in zip(range(rooms), episode_seeds(seed, purpose=1), strict=False):
        frames, pixels = [env.reset(seed=int(room_seed))[0]["image"]], [visible()]
        is_over = False
        while not is_over:
            action = int(rng.choice((FORWARD, TURN_LEFT, TURN_RIGHT)))
            observation, _, terminated, truncated, _ = env.step(action)
            frames.append(observation["image"])
            pixels.append(visible())
            is_over = terminated or truncated
        # Before the first frame an agent sees it as often as the stack is deep.
        padded = [frames[0]] * (stack - 1) + frames
        stacked = [padded[t : t + stack] for t in range(len(frames))]
        found.append(Views(trained.embed(np.array(stacked)), np.array(pixels)))
    return found


def joined(views: list[Views]) -> Views:
    """The views of several rooms as one."""
    return Views(torch.cat([one.features for one in views]), np.concatenate([one.pixels for one in views]))


def fit(views: Views, hidden: int) -> Callable[[Tensor], Tensor]:
    """A classifier from f(o) to the log-odds that each object is in view."""
    torch.manual_seed(0)
    inputs, classes = views.features.shape[1], views.pixels.shape[1]
    head = nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, classes))
    optimiser = torch.optim.Adam(head.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, PASSES)
    is_seen = torch.from_numpy(views.pixels >= BINS_PX[0]).float()
    is_clear = torch.from_numpy((views.pixels == 0) | (views.pixels >= BINS_PX[0])).float()
    for _ in range(PASSES):
        for chosen in torch.randperm(len(views.features)).split(BATCH):
            logits = head(views.features[chosen])
            surprise = binary_cross_entropy_with_logits(logits, is_seen[chosen], reduction="none")
            optimiser.zero_grad()
            (surprise * is_clear[chosen]).mean().backward()
            optimiser.step()
        schedule.step()
    return head


def recall(scores: NDArray[np.float32], pixels: NDArray[np.int64]) -> list[dict[str, Any]]:
    """How many objects are told, by their pixels.

    Args:
        scores: the higher, the surer that an object is in view, shape [N, objects].
        pixels: of each object, shape [N, objects].

    Returns:
        A row for each bin: its pixels, the objects seen in it, and the share that scores above all but
        `FALSE_ALARMS` of the views without that object.
    """
    limits = [
        np.quantile(own[seen == 0], 1 - FALSE_ALARMS) for own, seen in zip(scores.T, pixels.T, strict=True)
    ]
    is_told = scores > np.array(limits)
    rows = []
    for low, high in pairwise(BINS_PX):
        inside = (pixels >= low) & (pixels < high)
        told = float(is_told[inside].mean()) if inside.any() else None
        rows.append({"pixels": [low, high], "objects": int(inside.sum()), "recall": told})
    return rows


def probe(trained: Policy, rooms: int, seed: int) -> dict[str, list[dict[str, Any]]]:
    """Recall of a classifier on f and, where there is one, of the agent's own head."""
    views = look_around(trained, rooms, seed)
    learned, asked = joined(views[: 2 * rooms // 3]), joined(views[2 * rooms // 3 :])
    heads: dict[str, Callable[[Tensor], Tensor]] = {"classifier": fit(learned, trained.config.model.head_dim)}
    if trained.agent.sight is not None:
        heads["head"] = trained.agent.see
    with torch.no_grad():
        return {name: recall(head(asked.features).numpy(), asked.pixels) for name, head in heads.items()}


def show(agent: Path, tables: dict[str, list[dict[str, Any]]]) -> None:
    """Print the tables of an agent."""
    for name, rows in tables.items():
        print(f"{agent}, {name}, {len(OBJECT_NAMES)} objects, at {FALSE_ALARMS:.1%} false alarms")
        for row in rows:
            low, high = row["pixels"]
            told = "-" if row["recall"] is None else f"{row['recall']:.3f}"
            print(f"{low:5}..{high - 1:<5} px {row['objects']:6} objects  recall {told}")


def main() -> None:
    """Print the tables; with --out write them as JSON."""
    parser = argparse.ArgumentParser(description="How many pixels of an object an agent needs to tell it.")
    parser.add_argument("agents", type=Path, nargs="+")
    parser.add_argument("--rooms", type=int, default=1500, help="21 views each")
    parser.add_argument("--seed", type=int, default=9)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    found = {}
    for agent in options.agents:
        trained = load_agent(agent)
        tables = probe(trained, options.rooms, options.seed)
        show(agent, tables)
        found[agent.name] = {"trained_episodes": trained.trained_episodes, "recall": tables}
    if options.out:
        made = {**describe(), "command": shlex.join(["python", *sys.argv])}
        options.out.write_text(json.dumps({**made, "agents": found}) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
