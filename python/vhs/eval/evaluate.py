"""Success rate and SPL of a trained agent over episodes that training never saw.

SPL is success weighted by optimal over taken steps (Anderson et al. 2018, "On Evaluation of Embodied
Navigation Agents", Eq. 1), with actions as the length; a task says the shortest way, or there is no SPL.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from vhs import Outcome
from vhs.acting.episodes import EndedEpisode, Episodes
from vhs.acting.policy import Policy, load_agent
from vhs.acting.seeds import episode_seeds
from vhs.acting.setup import make_buffer, make_env
from vhs.acting.stepping import LocalStepping
from vhs.asking import asking
from vhs.runs.window import summarise
from vhs.task import Task


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Rates over the evaluated episodes."""

    success: float
    failure: float
    timeout: float
    spl: float | None
    """Success weighted by optimal / taken steps, over the episodes that have a way to success; None where the
    task does not say the shortest way."""
    steps: float
    """Mean actions an episode."""
    optimal_steps: float | None
    """Mean actions of the shortest ways of those episodes; None likewise."""
    episodes: int
    seed: int
    greedy: bool
    trained_episodes: int
    metrics: Mapping[str, float] = field(default_factory=dict)
    """Means of the further numbers that the task says of its ends, by name."""

    def as_dict(self) -> dict[str, Any]:
        """The fields by name, and each further number as ``metric/NAME``."""
        fields = asdict(self)
        metrics = fields.pop("metrics")
        return fields | {f"metric/{name}": value for name, value in metrics.items()}


def evaluate(
    run: Path | Policy,
    *,
    episodes: int = 300,
    seed: int = 0,
    greedy: bool = False,
    task: Task | None = None,
) -> Evaluation:
    """Evaluate the newest checkpoint of a run, an exported agent, or one that was loaded.

    Args:
        run: directory of the run or of the exported agent; or what `load_agent` gave, which has its task.
        episodes: how many, each under a seed of its own (paper: 300).
        seed: which episodes; the same seed gives the same ones to every run.
        greedy: take the likeliest action instead of sampling from the policy.
        task: what it was trained on; None: the task that its configuration names.

    Raises:
        CheckpointError: the run is missing or damaged.
    """
    trained = run if isinstance(run, Policy) else load_agent(run, task)
    torch.set_num_threads(trained.config.train.threads)
    ended = _play(trained, episodes=episodes, seed=seed, greedy=greedy)
    shortest = _shortest(trained.task, [episode.seed for episode in ended])
    spl, optimal = (None, None) if shortest is None else _path_lengths(ended, shortest)
    rates = summarise(ended)
    return Evaluation(
        success=rates["success"],
        failure=rates["failure"],
        timeout=rates["timeout"],
        spl=spl,
        steps=rates["steps"],
        optimal_steps=optimal,
        episodes=episodes,
        seed=seed,
        trained_episodes=trained.trained_episodes,
        greedy=greedy,
        metrics={
            name: float(np.mean([episode.metrics[name] for episode in ended]))
            for name in trained.task.metrics
        },
    )


def success_weighted_by_path_length(
    success: NDArray[np.bool_], optimal: NDArray[np.float64], taken: NDArray[np.float64]
) -> float:
    """SPL: the mean of success times optimal / max(taken, optimal), each of shape [episodes]; 0 of none."""
    return float((success * optimal / np.maximum(taken, optimal)).mean()) if len(success) else 0.0


def _play(trained: Policy, *, episodes: int, seed: int, greedy: bool) -> list[EndedEpisode]:
    """Run every episode once; their order does not matter to any mean."""
    streams = min(trained.config.env.num_envs, episodes)
    stepping = LocalStepping([make_env(trained.task, trained.spec) for _ in range(streams)])
    buffer = make_buffer(trained.config, trained.spec, streams, streams)
    seeds = islice(episode_seeds(seed, purpose=1), episodes)
    played = Episodes(stepping, trained.player(buffer, seed, greedy), buffer, seeds)
    played.start()
    ended: list[EndedEpisode] = []
    while not played.is_done:
        ended += played.step()
    return ended


def _shortest(task: Task, seeds: list[int]) -> NDArray[np.float64] | None:
    """Fewest steps to success for each seed, infinite where there is no way; None where nobody knows."""
    if task.shortest is None:
        return None
    lengths: list[float] = []
    with closing(task.new_env()) as env:
        for seed in seeds:
            env.reset(seed=seed)
            with asking(task.name, "shortest"):
                steps = task.shortest(env.unwrapped)
            lengths.append(math.inf if steps is None else steps)
    return np.array(lengths, dtype=np.float64)


def _path_lengths(ended: list[EndedEpisode], shortest: NDArray[np.float64]) -> tuple[float, float]:
    """SPL and the mean of the shortest ways, over the episodes that have one."""
    has_way = np.isfinite(shortest)
    taken = np.array([episode.steps for episode in ended], dtype=np.float64)
    success = np.array([episode.outcome == Outcome.SUCCESS for episode in ended])
    spl = success_weighted_by_path_length(success[has_way], shortest[has_way], taken[has_way])
    return spl, float(shortest[has_way].mean()) if has_way.any() else 0.0
