"""Success rate and SPL of a trained agent over episodes that training never saw.

SPL is success weighted by optimal over taken steps (Anderson et al. 2018, "On Evaluation of Embodied
Navigation Agents", Eq. 1), with actions as the length; the optimum is the oracle's, which plans with the true
state.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from vhs import Outcome
from vhs.acting.episodes import EndedEpisode, Rollout, episode_seeds
from vhs.acting.policy import Policy, load_agent
from vhs.acting.stepping import LocalRooms
from vhs.config import Config
from vhs.envs import optimal_steps
from vhs.envs.oracle import NoPlanError
from vhs.runs.window import summarise
from vhs.train.build import make_buffer, make_envs, make_spec


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Rates over the evaluated episodes."""

    success: float
    failure: float
    timeout: float
    spl: float
    """Success weighted by optimal / taken steps, over the episodes that have a plan within the horizon."""
    steps: float
    """Mean actions an episode."""
    optimal_steps: float
    """Mean actions of the oracle in those episodes."""
    episodes: int
    seed: int
    greedy: bool
    trained_episodes: int

    def as_dict(self) -> dict[str, Any]:
        """The fields by name."""
        return asdict(self)


def evaluate(run: Path, *, episodes: int = 300, seed: int = 0, greedy: bool = False) -> Evaluation:
    """Evaluate the newest checkpoint of a run, or an exported agent.

    Args:
        run: directory of the run or of the exported agent.
        episodes: how many, each in a room of its own (paper: 300).
        seed: which rooms; the same seed gives the same rooms for every run.
        greedy: take the likeliest action instead of sampling from the policy.

    Raises:
        CheckpointError: the run is missing or damaged.
    """
    trained = load_agent(run)
    torch.set_num_threads(trained.config.train.threads)
    ended = _play(trained, episodes=episodes, seed=seed, greedy=greedy)
    optimal = _optimal(trained.config, [episode.seed for episode in ended])
    has_plan = np.isfinite(optimal)
    taken = np.array([episode.steps for episode in ended], dtype=np.float64)
    success = np.array([episode.outcome == Outcome.SUCCESS for episode in ended])
    rates = summarise(ended)
    return Evaluation(
        success=rates["success"],
        failure=rates["failure"],
        timeout=rates["timeout"],
        spl=success_weighted_by_path_length(success[has_plan], optimal[has_plan], taken[has_plan]),
        steps=rates["steps"],
        optimal_steps=float(optimal[has_plan].mean()) if has_plan.any() else 0.0,
        episodes=episodes,
        seed=seed,
        trained_episodes=trained.trained_episodes,
        greedy=greedy,
    )


def success_weighted_by_path_length(
    success: NDArray[np.bool_], optimal: NDArray[np.float64], taken: NDArray[np.float64]
) -> float:
    """SPL: the mean of success times optimal / max(taken, optimal), each of shape [episodes]; 0 of none."""
    return float((success * optimal / np.maximum(taken, optimal)).mean()) if len(success) else 0.0


def _play(trained: Policy, *, episodes: int, seed: int, greedy: bool) -> list[EndedEpisode]:
    """Run every episode once; their order does not matter to any mean."""
    config = trained.config
    envs = make_envs(config, min(config.env.num_envs, episodes))
    actor = trained.actor(seed, greedy, len(envs))
    buffer = make_buffer(config, make_spec(config, envs[0]), len(envs), len(envs))
    seeds = islice(episode_seeds(seed, purpose=1), episodes)
    rollout = Rollout(LocalRooms(envs), len(envs), actor, buffer, trained.goals.begin, seeds)
    ended: list[EndedEpisode] = []
    while not rollout.is_done:
        ended += rollout.step()
    return ended


def _optimal(config: Config, seeds: list[int]) -> NDArray[np.float64]:
    """Length of the oracle's plan for each seed; infinite where none fits the horizon."""
    env = make_envs(config, 1)[0]
    lengths: list[float] = []
    for seed in seeds:
        env.reset(seed=seed)
        try:
            lengths.append(optimal_steps(env))
        except NoPlanError:
            lengths.append(math.inf)
    return np.array(lengths, dtype=np.float64)
