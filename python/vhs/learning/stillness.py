"""Steps that changed nothing: after them an observation is what it was before.

Owns what counts as the same. Such steps are not imitated (`vhs.learning.learner`), and of a stride dead
reckoning counts no way (`vhs.learning.reckoning`). Only what an agent sees is compared, no state of an
environment.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vhs import EpisodeBatch
from vhs.buffer import beside
from vhs.task import TaskSpec

STILL_LEVELS = 0.5
"""Mean difference of two pictures, in levels of 0..255, below which a camera that actions move has not moved.
In the rooms a robot that stands makes up to .2, whose servos still settle, and one that moves at all 1.4."""
EVERY = 4
"""Of each so many rows and columns one is compared then: a camera that moves changes a picture everywhere."""


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
            frames = frames[:, ::EVERY, ::EVERY]
        one, other = frames[before], frames[before + 1]
        inside = tuple(range(1, one.ndim))
        if self._moves:
            # Of unsigned bytes, whose difference would wrap.
            is_still = (np.maximum(one, other) - np.minimum(one, other)).mean(axis=inside) < STILL_LEVELS
        else:
            is_still = (one == other).all(axis=inside)
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
