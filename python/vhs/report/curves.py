"""Sections about training: success, outcomes, losses, speed.

A curve is the mean over seeds, its band one standard deviation; of one seed there is no band.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from vhs.config.variants import Label
from vhs.eval.paper import SUCCESS
from vhs.report.names import group_title, task_title
from vhs.report.page import Section, card, legend, missing, table
from vhs.report.svg import Axes, FloatArray, Line, line_chart, stacked_chart
from vhs.runs.reader import Group
from vhs.runs.rows import Row

OUTCOMES = {"success": "var(--success)", "failure": "var(--failure)", "timeout": "var(--timeout)"}

LOSSES = {
    "loss/entropy": "entropy of the policy (nats)",
    "loss/policy": "policy loss",
    "loss/value": "value loss",
    "loss/supcon": "SupCon loss",
    "loss/discriminator": "goal-discriminator loss",
    "loss/localise": "localisation loss",
    "loss/imitation_policy": "imitation loss, policy",
    "loss/imitation_value": "imitation loss, value",
    "loss/grad_norm": "gradient norm before clipping",
    "loss/relabelled": "share of relabelled episodes",
}
COSTS = {
    "rate/steps": "steps per episode",
    "rate/return": "return (undiscounted)",
    "speed/steps_per_s": "environment steps per second",
    "time/minutes": "minutes since the start",
}
_METHODS = ("vhs", "pg", "gdan", "a3c", "gcsl")
"""The methods that have a colour of their own, the first ones of the style sheet."""
_COLOURS = 8
"""Of the style sheet, for groups."""
_POINTS = 400
"""Most points of a drawn curve: as many as a chart has pixels."""
_SHORT = 6
"""Letters of a name that fits beside the end of its curve."""
_SMOOTHED_SHARE = 40
"""A curve is smoothed over a 40th of its rows: enough to see the trend, too little to move it."""


def curve_section(groups: Sequence[Group]) -> Section:
    """Success over training, a chart a task, then how episodes end: a chart, or a small one a group."""
    colours = _colours(groups)
    cards = [chart for name, members in _charts(groups) for chart in _success_card(name, members, colours)]
    if not cards:
        return Section("curves", "Learning curves", missing("no log with a row in it"))
    if len(groups) == 1:
        body = f'<div class="grid">{"".join([*cards, *_outcome_card(groups[0])])}</div>'
        return Section("curves", "Learning curves", body)
    body = f'{_results(groups)}<div class="grid">{"".join(cards)}</div>{_outcome_grid(groups)}'
    return Section("curves", "Learning curves", body)


def _success_card(name: str, members: Sequence[Group], colours: Mapping[Label, str]) -> list[str]:
    lines = _lines(members, "rate/success", colours)
    if not lines:
        return []
    paper = SUCCESS.get(members[0].task or "", {})
    # Its method, and its strongest baseline from elsewhere.
    marks = tuple((f"paper {method.upper()}", paper[method]) for method in ("vhs", "gdan") if method in paper)
    is_short = all(len(line.label) <= _SHORT for line in lines)
    axes = Axes(f"{name}: success over training", is_share=True, has_labels=is_short, marks=marks)
    names = _legend(members, colours) if len(members) > 1 and not is_short else ""
    return [card(f"{name}: success", names + line_chart(axes, lines), _note(lines, is_marked=bool(marks)))]


def _outcome_card(group: Group) -> list[str]:
    lines = _outcome_lines(group)
    if not lines:
        return []
    task, name = task_title(group.task), group_title(group)
    axes = Axes(f"{task}, {name}: outcomes over training", is_share=True)
    return [card(f"{task}: how episodes end, {name}", line_chart(axes, lines), _seeds(group))]


def _outcome_grid(groups: Sequence[Group]) -> str:
    """A small chart a group, the outcomes on top of each other; a row of them a task."""
    parts = []
    for task in dict.fromkeys(group.task for group in groups):
        cards = []
        for group in groups:
            lines = _outcome_lines(group)
            if group.task == task and len(lines) == len(OUTCOMES):
                name = group_title(group)
                about = f"{task_title(task)}, {name}: outcomes over training"
                axes = Axes(about, "", "episodes", is_share=True, width=240, height=150, has_labels=False)
                cards.append(card(name, stacked_chart(axes, lines), ""))
        if cards:
            parts.append(f'<h4>{escape(task_title(task))}</h4><div class="grid tiny">{"".join(cards)}</div>')
    if not parts:
        return ""
    return f"<h3>How episodes end</h3>{legend(list(OUTCOMES.items()))}{''.join(parts)}"


def _outcome_lines(group: Group) -> list[Line]:
    lines = (_line(group, f"rate/{outcome}", outcome, colour) for outcome, colour in OUTCOMES.items())
    return [line for line in lines if line is not None]


def loss_section(groups: Sequence[Group]) -> Section:
    """Losses and entropy."""
    return Section("losses", "Losses and entropy", _small_charts(groups, LOSSES))


def cost_section(groups: Sequence[Group]) -> Section:
    """Steps, returns and speed."""
    return Section("speed", "Steps and speed", _small_charts(groups, COSTS))


def _charts(groups: Sequence[Group]) -> Iterator[tuple[str, list[Group]]]:
    """What is drawn together, and its name: the groups of a task; of many, variants apart from methods."""
    for task in dict.fromkeys(group.task for group in groups):
        members = [group for group in groups if group.task == task]
        plain = [group for group in members if _is_plain(group.label)]
        variants = [group for group in members if not _is_plain(group.label)]
        if len(members) <= _COLOURS or len(plain) < 2 or not variants:
            yield task_title(task), members
        else:
            varied = {group.label.method for group in variants}
            yield task_title(task), plain
            yield f"{task_title(task)}, variants", [g for g in plain if g.label.method in varied] + variants


def _is_plain(label: Label) -> bool:
    """Whether it is a method as it is, no variant of one."""
    return not label.changes


def _colours(groups: Sequence[Group]) -> dict[Label, str]:
    """A colour for each label, the same on every task, and for a method as it is the same on every page.

    Others have the colours that are left; when all are taken they repeat.
    """
    ordered = sorted({group.label for group in groups}, key=lambda label: (not _is_plain(label), label))
    own = {label: _METHODS.index(label.method) for label in ordered if _is_method(label)}
    spare = range(len(_METHODS), _COLOURS)
    left = [*spare, *(slot for slot in range(len(_METHODS)) if slot not in own.values())]
    others = cycle(left)
    slots = {label: own[label] if label in own else next(others) for label in ordered}
    return {label: f"var(--c{slot})" for label, slot in slots.items()}


def _is_method(label: Label) -> bool:
    """Whether a label has a colour of its own."""
    return _is_plain(label) and not label.copy and label.method in _METHODS


def _small_charts(groups: Sequence[Group], keys: dict[str, str]) -> str:
    """A small chart a key, with one legend for all of a task."""
    parts = []
    colours = _colours(groups)
    for name, members in _charts(groups):
        cards = []
        for key, title in keys.items():
            lines = _lines(members, key, colours)
            if lines:
                axes = Axes(f"{name}: {title}", width=340, height=210, has_labels=False)
                cards.append(card(title, line_chart(axes, lines), ""))
        if cards:
            head = f"<h3>{escape(name)}</h3>{_legend(members, colours)}" if len(groups) > 1 else ""
            parts.append(f'{head}<div class="grid small">{"".join(cards)}</div>')
    return "".join(parts) or missing("no log holds any of these")


def _legend(members: Sequence[Group], colours: Mapping[Label, str]) -> str:
    return legend([(group_title(group), colours[group.label]) for group in members])


def _lines(groups: Sequence[Group], key: str, colours: Mapping[Label, str]) -> list[Line]:
    found = (_line(group, key, group_title(group), colours[group.label]) for group in groups)
    return [line for line in found if line is not None]


def _line(group: Group, key: str, label: str, colour: str) -> Line | None:
    """Mean over the seeds of a group, and the band of one standard deviation where there are several."""
    curves = [curve for run in group.runs if (curve := _series(run.rows, key)) is not None]
    if not curves:
        return None
    dashed = not _is_plain(group.label)
    if len(curves) == 1:
        x, y = curves[0]
        rows, smooth = _drawn(x), _smooth(y)
        raw = y[rows] if len(y) > _SMOOTHED_SHARE else None
        return Line(label, colour, x[rows], smooth[rows], raw=raw, is_dashed=dashed)
    # The coarsest log gives the points; beyond the shortest run a mean would be over other seeds.
    end = min(x[-1] for x, _ in curves)
    x = min((x for x, _ in curves), key=len)
    x = np.unique(np.append(x[x <= end], end))
    values = np.stack([np.interp(x, *curve) for curve in curves])
    mean, deviation = _smooth(values.mean(axis=0)), _smooth(values.std(axis=0, ddof=1))
    rows = _drawn(x)
    x, mean, deviation = x[rows], mean[rows], deviation[rows]
    return Line(label, colour, x, mean, mean - deviation, mean + deviation, is_dashed=dashed)


def _drawn(x: FloatArray) -> NDArray[np.intp]:
    """Rows of a curve that are drawn: all, or evenly so many of them."""
    return np.unique(np.linspace(0, len(x) - 1, min(len(x), _POINTS)).round().astype(np.intp))


def _series(rows: Sequence[Row], key: str) -> tuple[FloatArray, FloatArray] | None:
    points = [(row["episodes"], row[key]) for row in rows if isinstance(row.get(key), int | float)]
    if not points:
        return None
    x, y = np.array(points, dtype=np.float64).T
    spans = np.diff(x, prepend=0.0)
    if len(x) > 2 and spans[-1] < np.median(spans) / 2:
        # A stopped run logs what was left: a rate over a few episodes, whose noise would end the curve.
        return x[:-1], y[:-1]
    return x, y


def _smooth(values: FloatArray) -> FloatArray:
    """Centred moving mean; at the ends over what there is."""
    half = len(values) // _SMOOTHED_SHARE // 2
    if half == 0:
        return values
    sums = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(len(values))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(values))
    smooth: FloatArray = (sums[high] - sums[low]) / (high - low)
    return smooth


def _note(lines: Sequence[Line], *, is_marked: bool) -> str:
    """How to read a chart of success."""
    bands = any(line.low is not None for line in lines)
    note = "Mean and standard deviation over seeds." if bands else "One seed: no band."
    thin = " Thin: before smoothing." if any(line.raw is not None for line in lines) else ""
    dotted = " Dotted: final rates in the paper." if is_marked else ""
    return f"{note} Actions sampled.{dotted}{thin}"


def _seeds(group: Group) -> str:
    seeds = [str(run.config.seed) for run in group.runs if run.found_config is not None]
    return f"seed{'s' if len(seeds) > 1 else ''} {', '.join(seeds)}" if seeds else ""


def _results(groups: Sequence[Group]) -> str:
    """Where each group ended."""
    rows = []
    for group in groups:
        logged = [run for run in group.runs if run.rows]
        if not logged:
            continue
        final = np.array([run.final_success for run in logged])
        spread = f" ± {100 * final.std(ddof=1):.1f}" if len(final) > 1 else " (one seed)"
        episodes = [run.rows[-1]["episodes"] for run in logged]
        minutes = [run.rows[-1].get("time/minutes", float("nan")) for run in logged]
        rows.append(
            (task_title(group.task), group_title(group), str(len(logged)), f"{min(episodes):,}",
             f"{np.mean(minutes):.0f}", f"{100 * final.mean():.1f} %{spread}")
        )  # fmt: skip
    head = ("task", "method", "seeds", "episodes", "minutes", "success, last tenth")
    return table(head, rows, numbers_from=2)
