"""Evaluation episodes played for the page, with the true state: what was asked, reached, and the way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from vhs import Outcome
from vhs.acting.episodes import episode_seeds
from vhs.acting.policy import Policy
from vhs.envs import OBJECT_NAMES, RoomConfig, RoomEnv, plan
from vhs.envs.config import FIRST_INTERACTION, MOVE_FORWARD, TURN_LEFT
from vhs.envs.kinematics import Footprint, strided, turned
from vhs.envs.oracle import NoPlanError
from vhs.eval.evaluate import success_weighted_by_path_length
from vhs.play.room import make_room
from vhs.show.moments import Moment, run_episode


@dataclass(frozen=True, slots=True)
class Track:
    """One episode."""

    number: int
    """Its place among the evaluation episodes of the seed."""
    goal: int
    """Label of the instructed object."""
    moments: tuple[Moment, ...]
    footprints: tuple[Footprint, ...]
    """Outlines of the objects, in order of labels."""
    shortest: tuple[tuple[float, float], ...]
    """Places on a shortest way, in metres, the start included; empty where there is none."""
    optimal_steps: int | None
    room: RoomConfig

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
    """Play the first rooms that `vhs eval --seed` takes, actions sampled."""
    room, actor = make_room(agent.config, is_drawn=False), agent.actor(seed, greedy=False)
    tracks = []
    for number, episode_seed in enumerate(islice(episode_seeds(seed, purpose=1), episodes)):
        moments = run_episode(agent, actor, room, episode_seed)
        first = next(moments)  # the room has now been reset
        shortest, optimal = _shortest(room)
        objects = room.world.footprints
        tracks.append(Track(number, room.goal, (first, *moments), objects, shortest, optimal, room.config))
    return tracks


def confusion(tracks: Sequence[Track]) -> NDArray[np.int64]:
    """How often each object was asked for (row) and reached (column; the last column: none).

    Returns:
        Counts, shape [classes, classes + 1].
    """
    counts = np.zeros((len(OBJECT_NAMES), len(OBJECT_NAMES) + 1), dtype=np.int64)
    for track in tracks:
        counts[track.goal, track.moments[-1].reached] += 1
    return counts


def success_and_spl(tracks: Sequence[Track]) -> tuple[float, float]:
    """Success rate, and success weighted by optimal / taken steps over the episodes that can be solved."""
    success = np.array([track.outcome is Outcome.SUCCESS for track in tracks])
    optimal = np.array([math.inf if t.optimal_steps is None else float(t.optimal_steps) for t in tracks])
    taken = np.array([track.steps for track in tracks], dtype=np.float64)
    can = np.isfinite(optimal)
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


def _shortest(room: RoomEnv) -> tuple[tuple[tuple[float, float], ...], int | None]:
    try:
        actions = plan(room)
    except NoPlanError:
        return (), None
    pose, places = room.world.start_pose, [room.world.start_pose[:2]]
    for action in actions:
        if action == MOVE_FORWARD:
            pose = strided(pose, room.world.footprints, room.config)
            places.append(pose[:2])
        elif action < FIRST_INTERACTION:
            pose = turned(pose, 1 if action == TURN_LEFT else -1)
    return tuple(places), len(actions)
