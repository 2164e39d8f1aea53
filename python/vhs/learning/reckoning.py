"""Dead reckoning of an update's episodes: where what each reached lay at all of its steps.

Owns which episodes reached something. Strides that went nowhere are those that changed nothing
(`vhs.learning.stillness`). Everything is read off what the agent did and saw; the state of an environment is
not.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from vhs import EpisodeBatch, Outcome, egomotion
from vhs.config import MethodSection
from vhs.learning.stillness import Stillness
from vhs.learning.terms import Episodes, Remembered
from vhs.models import to_device
from vhs.task import TaskSpec


class Reckoned(NamedTuple):
    """The R episodes of a batch that reached something, and where it lay."""

    rows: NDArray[np.int64]
    """Which of the batch, shape [R]."""
    bearings_rad: NDArray[np.float32]
    """At the beginning of each step: 0 straight ahead, positive to the left, shape [R, T]."""


class Reckoning:
    """Finds what episodes reached in the eyes of each of their steps."""

    def __init__(
        self, moves: Mapping[int, tuple[float, float, float]], spec: TaskSpec, ahead_m: float
    ) -> None:
        """Take what is known of a task.

        Args:
            moves: action -> metres forward, metres and radians to the left; the others do not move.
            spec: of the task: how many actions, and what its frames are.
            ahead_m: what is reached lies so far in front of an episode's last pose.
        """
        self._moves = np.zeros((spec.num_actions, 3), np.float32)
        for action, change in moves.items():
            self._moves[action] = change
        self._stillness = Stillness(spec)
        self._ahead_m = ahead_m

    def __call__(self, batch: EpisodeBatch) -> Reckoned:
        """Successes and failures of a batch whose observations are stacked in channels, newest last."""
        rows = np.flatnonzero(batch.outcomes != Outcome.TIMEOUT)
        strides = self._moves[batch.actions, :2].any(axis=-1) & batch.mask
        strides[batch.outcomes == Outcome.TIMEOUT] = False
        blocked = self._stillness(batch, strides)[rows]
        actions, lengths = batch.actions[rows], batch.lengths[rows]
        bearings, _ = egomotion(actions, blocked, lengths, self._moves, ahead_m=self._ahead_m)
        return Reckoned(rows, bearings)


def remember(
    batch: EpisodeBatch, reckoned: Reckoned, passed: Mapping[str, Episodes], device: torch.device
) -> Remembered | None:
    """Hidden states on the way to what episodes reached, of all that were told it, when acting or after.

    Args:
        batch: an update's.
        reckoned: of it.
        passed: what the agent made of its episodes, by what terms call them.
        device: of the agent.

    Returns:
        None where no episode was told what it reached.
    """
    place = np.full(len(batch.lengths), -1)
    place[reckoned.rows] = np.arange(len(reckoned.rows))
    found = []
    for over, episodes in passed.items():
        is_told = place[episodes.rows] >= 0
        if over == "lived":
            is_told &= batch.outcomes[episodes.rows] == Outcome.SUCCESS
        (told,) = np.nonzero(is_told)
        if len(told):
            rows = episodes.rows[told]
            bearings, is_inside = reckoned.bearings_rad[place[rows]], batch.mask[rows]
            hidden = episodes.hidden[to_device(told, device)]
            found.append((hidden, to_device(bearings, device), to_device(is_inside, device).float()))
    if not found:
        return None
    return Remembered(*(torch.cat(parts) for parts in zip(*found, strict=True)))


def make_reckoning(method: MethodSection, spec: TaskSpec) -> Reckoning | None:
    """The reckoning of a method that was settled for a task; None where it does without."""
    if not ((method.localisation_weight or method.memory_weight) and spec.moves):
        return None
    return Reckoning(spec.moves, spec, method.localisation_ahead_m)
