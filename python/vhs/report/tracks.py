"""Evaluation episodes played for the page: what was asked, reached, and the way where it can be drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from vhs import Outcome
from vhs.acting.policy import Policy
from vhs.acting.seeds import episode_seeds
from vhs.acting.setup import make_env
from vhs.eval.evaluate import success_weighted_by_path_length
from vhs.report.room import RoomWatch, RoomWay
from vhs.show.moments import Moment, play_moments


@dataclass(frozen=True, slots=True)
class Track:
    """One evaluation episode as it was played."""

    number: int
    """Its place among the evaluation episodes of the seed."""
    moments: tuple[Moment, ...]
    optimal_steps: int | None
    """Fewest steps to success; None where there is no way, or the task does not say."""
    way: RoomWay | None
    """What a drawing from above shows, where the episode was in a room."""

    @property
    def goal(self) -> int:
        """Instructed goal class."""
        return self.moments[0].goal

    @property
    def outcome(self) -> Outcome:
        """How it ended."""
        outcome = self.moments[-1].outcome
        assert outcome is not None
        return outcome

    @property
    def steps(self) -> int:
        """Actions taken."""
        return len(self.moments) - 1


def play_tracks(agent: Policy, episodes: int, seed: int) -> list[Track]:
    """Play the first episodes that `vhs eval --seed` takes, actions sampled."""
    env = make_env(agent.task, agent.spec)
    seeds = islice(episode_seeds(seed, purpose=1), episodes)
    played = play_moments(agent, env, seeds, seed, greedy=False)
    tracks: list[Track] = []
    for first in played:
        optimal = None if agent.task.shortest is None else agent.task.shortest(env.unwrapped)
        watch = RoomWatch.of(env)
        moments = [first]
        for moment in played:
            moments.append(moment)
            if watch is not None:
                watch.look()
            if moment.outcome is not None:
                break
        way = None if watch is None else watch.way
        tracks.append(Track(len(tracks), tuple(moments), optimal, way))
    return tracks


def confusion(tracks: Sequence[Track], num_goals: int) -> NDArray[np.int64]:
    """How often each goal was asked for (row) and reached (column; the last column: none).

    Returns:
        Counts, shape [num_goals, num_goals + 1]; of tracks that say what was reached.
    """
    counts = np.zeros((num_goals, num_goals + 1), dtype=np.int64)
    for track in tracks:
        reached = track.moments[-1].reached
        if reached is not None:
            counts[track.goal, reached] += 1
    return counts


def success_and_spl(tracks: Sequence[Track]) -> tuple[float, float | None]:
    """Success rate, and success weighted by optimal / taken steps over the episodes that can be solved.

    The latter is None where no episode has one, as where the task does not say.
    """
    success = np.array([track.outcome is Outcome.SUCCESS for track in tracks])
    optimal = np.array([math.inf if t.optimal_steps is None else float(t.optimal_steps) for t in tracks])
    taken = np.array([track.steps for track in tracks], dtype=np.float64)
    can = np.isfinite(optimal)
    if not can.any():
        return float(success.mean()), None
    return float(success.mean()), success_weighted_by_path_length(success[can], optimal[can], taken[can])


def wilson_interval(share: float, count: int) -> tuple[float, float]:
    """95 % interval of a share of `count` episodes (Wilson 1927)."""
    z = 1.96
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    return middle - half, middle + half


def pick(tracks: Sequence[Track], an_outcome: int = 2) -> list[Track]:
    """The first `an_outcome` episodes of each outcome: nobody chose them for their looks."""
    return [
        track for outcome in Outcome for track in [t for t in tracks if t.outcome is outcome][:an_outcome]
    ]
