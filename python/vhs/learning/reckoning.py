"""Dead reckoning of an update's episodes: where what each reached lay at all of its steps.

Owns which episodes reached something, and which strides went nowhere: those after which the picture is the
same. Everything is read off what the agent did and saw; the state of an environment is not.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhs import EpisodeBatch, Outcome, egomotion
from vhs.config import MethodSection
from vhs.task import TaskSpec

STILL_LEVELS = 1.0
"""Mean difference of two pictures, in levels of 0..255, below which nothing moved. In the rooms a robot that
stands makes up to .05, whose servos still settle, and one that moves by a centimetre 3."""
EVERY = 4
"""Of each so many rows and columns one is compared: a camera that moves changes a picture everywhere."""


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
            spec: of the task: how many actions, and the channels of a frame.
            ahead_m: what is reached lies so far in front of an episode's last pose.
        """
        self._moves = np.zeros((spec.num_actions, 3), np.float32)
        for action, change in moves.items():
            self._moves[action] = change
        self._channels = spec.frame_shape[-1]
        self._ahead_m = ahead_m

    def __call__(self, batch: EpisodeBatch) -> Reckoned:
        """Successes and failures of a batch whose observations are stacked in channels, newest last."""
        rows = np.flatnonzero(batch.outcomes != Outcome.TIMEOUT)
        actions, lengths = batch.actions[rows], batch.lengths[rows]
        bearings, _ = egomotion(
            actions, self._blocked(batch, rows), lengths, self._moves, ahead_m=self._ahead_m
        )
        return Reckoned(rows, bearings)

    def _blocked(self, batch: EpisodeBatch, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Strides after which the newest frame is the one before, bool [R, T]."""
        strides: NDArray[np.bool_] = self._moves[batch.actions[rows], :2].any(axis=-1) & batch.mask[rows]
        where, steps = np.nonzero(strides)
        before = batch.offsets[rows][where] + steps
        frames = batch.observations[:, ::EVERY, ::EVERY, -self._channels :]
        one, other = frames[before], frames[before + 1]
        # Of unsigned bytes, whose difference would wrap.
        change = (np.maximum(one, other) - np.minimum(one, other)).mean(axis=(1, 2, 3))
        strides[where, steps] = change < STILL_LEVELS
        return strides


def make_reckoning(method: MethodSection, spec: TaskSpec) -> Reckoning | None:
    """The reckoning of a method that was settled for a task; None where it does without."""
    if not (method.localisation_weight and spec.moves):
        return None
    return Reckoning(spec.moves, spec, method.localisation_ahead_m)
