"""Steps that changed nothing: after them an observation is what it was before.

Owns what counts as the same. Such steps are not imitated (`vhs.learning.learner`), and of a stride dead
reckoning counts no way (`vhs.learning.reckoning`). Only what an agent sees is compared, no state of an
environment.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhs import EpisodeBatch
from vhs.buffer import beside
from vhs.task import TaskSpec

STILL_LEVELS = 0.5
"""Mean difference of two pictures, in 255ths of the brightest number in them, below which a camera that
actions move has not moved. In the rooms a robot that stands makes up to .3, whose servos still settle, and
one that moves at all .6."""
OTHER_LEVELS = 24
"""Difference of a number, likewise, that is no settling of servos, ..."""
OTHER_SHARE = 0.002
"""... and the share of such numbers that shows a move all the same, of a small thing before a plain wall."""
EVERY = 4
"""Of each so many rows and columns one is compared at first: what differs there need not be looked at."""


class Stillness:
    """Finds the steps of an update's episodes that changed nothing."""

    def __init__(self, spec: TaskSpec) -> None:
        """Take what is known of a task: how its frames lie in an observation, and whether actions move it.

        Without `moves` a small part of a picture may be all that a step changes, so nothing but an equal
        observation is still.
        """
        is_picture = len(spec.frame_shape) == 3
        # Frames are stacked in channels or, where they are no pictures, one after the other; the newest last.
        self._newest = (..., slice(-spec.frame_shape[-1], None)) if is_picture else (slice(None), -1)
        self._moves = bool(spec.moves) and is_picture

    def __call__(self, batch: EpisodeBatch, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Those of some steps that changed nothing.

        Args:
            batch: packed, its observations stacked as an update has them.
            chosen: steps to look at, inside their episodes, bool [B, T].

        Returns:
            bool [B, T], False where a step was not chosen.
        """
        rows, steps = np.nonzero(chosen)
        before = batch.offsets[rows] + steps
        frames = batch.observations[self._newest]
        if self._moves:
            is_still = _is_alike(frames[:, ::EVERY, ::EVERY], before, most=1.0)
            is_still[is_still] = _is_alike(frames, before[is_still], most=OTHER_SHARE)
        else:
            one, other = frames[before], frames[before + 1]
            is_still = (one == other).all(axis=tuple(range(1, one.ndim)))
        told = beside(batch.fields)
        for part in (told, batch.achieved_goals):
            if part is not None:
                is_same = part[before] == part[before + 1]
                is_still &= is_same.all(axis=tuple(range(1, part.ndim)))
        found = np.zeros_like(chosen)
        found[rows[is_still], steps[is_still]] = True
        return found

    def before_ends(
        self, batch: EpisodeBatch, rows: NDArray[np.int64], lengths: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Of some episodes the steps that changed nothing; the last is none, as it reached something.

        Args:
            batch: packed.
            rows: which episodes of it, shape [R].
            lengths: steps of each until it reached what it is imitated under, int64 [R].

        Returns:
            bool [B, T], False in other episodes.
        """
        chosen = np.zeros_like(batch.mask)
        chosen[rows] = np.arange(chosen.shape[1]) < lengths[:, None] - 1
        return self(batch, chosen)


def _is_alike(frames: NDArray[Any], before: NDArray[np.int64], most: float) -> NDArray[np.bool_]:
    """Whether frames of unsigned bytes look like those behind them, with at most a share of other numbers."""
    one, other = frames[before], frames[before + 1]
    inside = tuple(range(1, one.ndim))
    brighter = np.maximum(one, other)
    difference = brighter - np.minimum(one, other)  # a plain difference would wrap
    level = brighter.max(axis=inside, keepdims=True, initial=1) / 255
    is_near: NDArray[np.bool_] = difference.mean(axis=inside) < STILL_LEVELS * level.reshape(-1)
    is_near &= (difference >= OTHER_LEVELS * level).mean(axis=inside) <= most
    return is_near
