"""Formulas of the comparison: numbers in, numbers out.

Sources: sample requirement ratio and sample efficiency improvement, Kim et al., "Visual Hindsight
Self-Imitation Learning for Interactive Navigation", appendix "Sample Efficiency Measure"; interquartile mean
and bootstrap interval, Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical
Precipice", as the library `rliable` computes them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 2_000
"""Bootstrap resamples behind an interval."""


def mean_and_deviation(values: Sequence[float]) -> tuple[float, float | None]:
    """Mean and sample standard deviation (n - 1) over seeds; one value has no deviation."""
    numbers = np.asarray(values, dtype=np.float64)
    return float(numbers.mean()), float(numbers.std(ddof=1)) if len(numbers) > 1 else None


def interquartile_mean(values: Sequence[float]) -> tuple[float, tuple[float, float] | None]:
    """Interquartile mean over seeds and its 95 % percentile bootstrap interval.

    A quarter of the seeds, rounded down, is cut at each end: below four seeds it is the plain mean.

    Args:
        values: one score a seed.

    Returns:
        The mean; lower and upper bound, or None for one seed, which says nothing about the others.
    """
    if len(values) == 1:
        return float(values[0]), None
    # rliable takes seconds to import: only who needs it pays.
    from rliable import library, metrics

    scores = {"scores": np.asarray(values, dtype=np.float64)[:, np.newaxis]}
    with _repeatable():
        means, intervals = library.get_interval_estimates(
            scores, lambda sample: np.array([metrics.aggregate_iqm(sample)]), reps=RESAMPLES
        )
    low, high = intervals["scores"][:, 0]
    return float(means["scores"][0]), (float(low), float(high))


def first_row_at_rate(
    episodes: NDArray[np.int64], success: NDArray[np.float64], rate: float, window: int
) -> int | None:
    """Where a run first reaches a success rate that is more than one lucky window.

    Args:
        episodes: episodes of training at the end of each row of the log, rising, shape [rows].
        success: share of successes in the episodes of the row, shape [rows].
        rate: share to reach.
        window: episodes to average over.

    Returns:
        The first row at which the mean success over the last `window` episodes (whole rows, so up to one row
        more) is at least `rate`; None if there is none. A row before episode `window` never counts.
    """
    ends = np.concatenate([[0], episodes])
    successes = np.concatenate([[0.0], np.cumsum(np.diff(ends) * success)])
    starts = np.maximum(np.searchsorted(ends, episodes - window, side="right") - 1, 0)
    means = (successes[1:] - successes[starts]) / (episodes - ends[starts])
    # The sums are inexact in the last digits: a mean that equals the rate has reached it.
    reached = np.flatnonzero((episodes >= window) & (means >= rate - 1e-9))
    return int(reached[0]) if len(reached) else None


def sample_requirement_ratio(episodes: float, reference: float) -> float:
    """SRR = n_B / n_A: episodes to the rate over those of the reference; lower is better."""
    return episodes / reference


def sample_efficiency_improvement(episodes: float, reference: float) -> float:
    """SEI = (n_A - n_B) / n_B: what the reference needs more, as a share; higher is better."""
    return (reference - episodes) / episodes


@contextmanager
def _repeatable() -> Iterator[None]:
    """Same scores, same interval: rliable resamples from numpy's global generator, whatever it is given."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(0)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002
