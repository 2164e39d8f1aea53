"""What charts rest on: ticks, labels that keep apart, means over seeds, intervals."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from vhs.config.variants import Label
from vhs.report.command import _title
from vhs.report.curves import _charts, _colours, _line
from vhs.report.svg import Axes, Line, line_chart, nice_ticks, spread
from vhs.report.tracks import wilson_interval
from vhs.runs.reader import Group, Run


def run_of(*points: tuple[int, float]) -> Run:
    rows = tuple({"episodes": x, "rate/success": y} for x, y in points)
    return Run(Path(), "run", None, rows)


def group_of(task: str, method: str, *changes: str, runs: tuple[Run, ...] = ()) -> Group:
    return Group(Label(method, changes), task, runs)


def test_ticks_are_round_and_cover_the_range() -> None:
    assert nice_ticks(0, 1) == [0, 0.2, 0.4, 0.6, 0.8, 1.0]
    assert nice_ticks(0, 116_000, 3) == [0, 50_000, 100_000]
    assert nice_ticks(0, 10, 4) == [0, 5, 10]
    assert nice_ticks(-0.3, 0.3)[0] <= -0.3


def test_labels_keep_apart_and_above_the_limit() -> None:
    assert spread([10, 12, 50], 17, 100) == [10, 27, 50]
    assert spread([90, 95, 99], 17, 100) == [66, 83, 100]


def test_a_band_is_mean_and_deviation_over_seeds_where_all_have_data() -> None:
    group = group_of(
        "task2", "vhs", runs=(run_of((10, 0.2), (20, 0.4)), run_of((10, 0.4), (20, 0.6), (30, 0.9)))
    )
    line = _line(group, "rate/success", "VHS", "red")
    assert line is not None
    assert line.low is not None
    assert line.x.tolist() == [10, 20]
    assert line.y == pytest.approx([0.3, 0.5])
    assert line.y - line.low == pytest.approx([0.2 / 2**0.5] * 2)


def test_one_seed_has_no_band() -> None:
    line = _line(group_of("task2", "vhs", runs=(run_of((10, 0.2), (20, 0.4)),)), "rate/success", "VHS", "red")
    assert line is not None
    assert line.low is None


def test_of_many_groups_variants_have_a_chart_of_their_own_beside_their_method() -> None:
    plain = [group_of("task2", method) for method in ("a3c", "pg", "vhs")]
    variants = [group_of("task2", "vhs", f"vhs_weight={number}") for number in range(6)]
    first, second = [*plain, *variants], [group_of("task3", "vhs")]
    assert list(_charts(first + second)) == [
        ("Task 2", plain),
        ("Task 2, variants", [plain[2], *variants]),
        ("Task 3", second),
    ]
    assert [(name, len(groups)) for name, groups in _charts(first[1:])] == [("Task 2", 8)]


def test_a_method_has_one_colour_whatever_else_a_page_shows_of_a_task() -> None:
    labels = Label("vhs", ("relabel_on=timeout",)), Label("vhs"), Label("a3c")
    colours = _colours([Group(label, "task2", ()) for label in labels] + [group_of("task3", "vhs")])
    assert list(colours) == [labels[2], labels[1], labels[0]]
    assert len(set(colours.values())) == 3


def test_the_final_rate_weighs_rows_by_their_episodes() -> None:
    run = run_of((900, 0.1), (980, 0.5), (1000, 1.0))
    assert run.final_success == pytest.approx(0.6)


def test_a_chart_is_well_formed_whatever_a_run_is_called() -> None:
    x = np.array([1.0, 2.0])
    line = Line('<&">', "var(--c0)", x, x, x - 1, x + 1)
    chart = line_chart(Axes('a "title" & more'), [line, line])
    assert ElementTree.fromstring(chart).get("aria-label") == 'a "title" & more'


def test_a_flat_curve_and_a_single_point_have_axes() -> None:
    one = Line("a", "red", np.array([5.0]), np.array([0.0]))
    assert "nan" not in line_chart(Axes("flat"), [one])


def test_the_wilson_interval_by_hand() -> None:
    low, high = wilson_interval(0.5, 100)
    assert (low, high) == (pytest.approx(0.4038, abs=1e-3), pytest.approx(0.5962, abs=1e-3))
    assert wilson_interval(1.0, 20)[1] == pytest.approx(1.0)


def test_a_title_counts_methods_not_their_tasks() -> None:
    vhs, other_task, pg = group_of("task1", "vhs"), group_of("task2", "vhs"), group_of("task2", "pg")
    assert _title([vhs]) == "Task 1: VHS"
    assert _title([vhs, other_task]) == "VHS on Task 1, Task 2"
    assert _title([vhs, other_task, pg]) == "2 methods on Task 1, Task 2"
