"""The formulas of the comparison, by hand."""

import numpy as np
import pytest

from vhs.eval.metrics import (
    first_row_at_rate,
    interquartile_mean,
    mean_and_deviation,
    sample_efficiency_improvement,
    sample_requirement_ratio,
)


def test_mean_and_deviation_by_hand() -> None:
    # deviations -0.1, 0, 0.1: sqrt(0.02 / 2)
    assert mean_and_deviation([0.8, 0.9, 1.0]) == (pytest.approx(0.9), pytest.approx(0.1))
    assert mean_and_deviation([0.8]) == (0.8, None)


def test_srr_and_sei_give_the_numbers_of_the_papers_table_where_its_formula_does() -> None:
    gdan, pg, vhs = 500_000, 345_116, 103_002
    assert sample_requirement_ratio(vhs, gdan) == pytest.approx(0.206, abs=5e-4)
    assert sample_efficiency_improvement(vhs, gdan) == pytest.approx(3.854, abs=5e-4)
    assert sample_requirement_ratio(pg, gdan) == pytest.approx(0.690, abs=5e-4)
    # The paper prints 222.8 %.
    assert sample_efficiency_improvement(pg, gdan) == pytest.approx(0.449, abs=5e-4)
    assert sample_requirement_ratio(gdan, gdan) == 1
    assert sample_efficiency_improvement(gdan, gdan) == 0


def row(episodes: list[int], success: list[float], rate: float = 0.5, window: int = 100) -> int | None:
    return first_row_at_rate(np.array(episodes), np.array(success), rate, window)


def test_a_lucky_row_does_not_reach_the_rate() -> None:
    # means over the last 100 episodes: -, 0.5 * (0.2 + 0.7) = 0.45, 0.45, 0.4, 0.55
    assert row([50, 100, 150, 200, 250], [0.2, 0.7, 0.2, 0.6, 0.5]) == 4


def test_a_mean_that_equals_the_rate_reaches_it() -> None:
    assert row([50, 100], [0.4, 0.6]) == 1
    assert row([50, 100], [0.4, 0.59]) is None


def test_less_than_a_window_of_episodes_never_reaches_the_rate() -> None:
    assert row([99], [1.0]) is None
    assert row([99, 100], [1.0, 1.0]) == 1
    assert row([], []) is None


def test_rows_weigh_by_their_episodes() -> None:
    # a stopped run left a row of 10 episodes: whole rows make 110 episodes, 10 * 1.0 + 100 * 0.5 successes
    assert row([10, 110], [1.0, 0.5], rate=60 / 110, window=101) == 1
    assert row([10, 110], [1.0, 0.5], rate=60 / 110 + 0.001, window=101) is None
    # the last 100 episodes alone are one whole row
    assert row([10, 110], [1.0, 0.5], rate=0.51, window=100) is None


def test_the_interquartile_mean_drops_a_quarter_at_each_end() -> None:
    # of 4: the lowest and the highest; of 3: none
    assert interquartile_mean([0.0, 0.6, 0.8, 1.0])[0] == pytest.approx(0.7)
    assert interquartile_mean([0.0, 0.5, 1.0])[0] == pytest.approx(0.5)


def test_the_interval_covers_the_mean_and_stays_within_the_scores() -> None:
    scores = [0.80, 0.84, 0.86, 0.90, 0.95]
    mean, interval = interquartile_mean(scores)
    assert interval is not None
    assert 0.80 <= interval[0] < mean < interval[1] <= 0.95


def test_one_seed_has_no_interval() -> None:
    assert interquartile_mean([0.9]) == (0.9, None)


def test_the_interval_is_repeatable_and_leaves_the_global_generator_alone() -> None:
    np.random.seed(7)  # noqa: NPY002
    expected = np.random.random(3)  # noqa: NPY002
    np.random.seed(7)  # noqa: NPY002
    first = interquartile_mean([0.8, 0.9, 0.7])
    assert np.array_equal(np.random.random(3), expected)  # noqa: NPY002
    assert interquartile_mean([0.8, 0.9, 0.7]) == first
