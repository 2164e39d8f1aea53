"""Which seeds the episodes of a run have: training and evaluation never share one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def episode_seeds(run_seed: int, *, first: int = 0, purpose: int = 0) -> Iterator[int]:
    """Independent seeds for the episodes of a run, without end.

    Args:
        run_seed: the one seed that the user gives.
        first: index of the first episode wanted, so that a resumed run goes on where it stopped.
        purpose: 0 for training, 1 for evaluation: the same run seed never gives the same episodes to both.
    """
    index = first
    while True:
        yield int(np.random.SeedSequence((run_seed, purpose, index)).generate_state(1)[0])
        index += 1
