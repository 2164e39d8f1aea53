"""Which seeds the episodes of a run have: training and evaluation never share one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def episode_seeds(run_seed: int, *, first: int = 0, stride: int = 1, purpose: int = 0) -> Iterator[int]:
    """Independent seeds for the episodes of a run, without end.

    Args:
        run_seed: the one seed that the user gives.
        first: index of the first episode wanted, so that a resumed run goes on where it stopped.
        stride: from one index to the next: each of several ranks takes every so manieth.
        purpose: 0 for training, 1 for evaluation: the same run seed never gives the same episodes to both.
    """
    index = first
    while True:
        yield int(np.random.SeedSequence((run_seed, purpose, index)).generate_state(1)[0])
        index += stride


def own_seed(run_seed: int, rank: int, first: int) -> int:
    """The seed of what a rank draws for itself from the episode of index `first` on; rank 0 has the run's."""
    if not rank:
        return run_seed
    return int(np.random.SeedSequence((run_seed, 2, rank, first)).generate_state(1, np.uint64)[0])
