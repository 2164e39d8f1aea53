"""Draw the figures of the results: `python docs/results/draw.py` writes SVG files beside this script.

Curves are means over the seeds that there are, bands from the lowest to the highest of them.
"""

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parents[1]))

from results import records
from results.records import FINAL, HERE, METHODS, SHORT_METHODS, TASKS, VARIANTS, Curve, curves, load
from results.tables import LONG, NEW_OBJECTS, OVERLOOKED
from vhs.eval.paper import SUCCESS

COLOURS = {
    "vhs": "#093dbe",
    "once": "#0a1f5c",
    "paper": "#7a9ff0",
    "pg": "#8f498a",
    "gdan": "#e47711",
    "a3c": "#191a1b",
    "gcsl": "#17a874",
}
"""Those of reports: told apart whatever kind of colour-blindness one has."""
OTHERS = ("#093dbe", "#7a9ff0", "#4c6fd0", "#0a1f5c", "#e47711", "#7b312c", "#8f498a", "#17a874")
PARTS = ("#093dbe", "#e47711", "#8b939e")
STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "vhs",
    "font.family": "sans-serif",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


def methods(runs: Any, shown_methods: dict[str, str]) -> Figure:
    """Success over training, a panel a task."""
    found = curves(runs)
    figure, panels = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained", sharey=True)
    for task, axes in zip(TASKS, panels, strict=True):
        for method, shown in shown_methods.items():
            _band(axes, found.get(f"{task}-{method}", []), shown, COLOURS[method])
        axes.axhline(SUCCESS[task]["vhs"], color=COLOURS["vhs"], linewidth=1, linestyle=":")
        axes.set(title=f"Task {task[-1]} (dotted: VHS in the paper)")
        _success(axes)
    lines = panels[1].get_legend_handles_labels()[0]  # Task 2 has all methods
    figure.legend(lines, shown_methods.values(), loc="outside upper center", ncols=len(shown_methods))
    return figure


def relabelling() -> Figure:
    """Success over training, Task 2, by what is relabelled."""
    found = curves(load(FINAL))
    figure, axes = plt.subplots(figsize=(9, 4.4), layout="constrained")
    for colour, (variant, shown) in zip(OTHERS, VARIANTS.items(), strict=True):
        _band(axes, found[f"task2-{variant}"], shown, colour)
    _success(axes)
    axes.legend(loc="lower right")
    return figure


def localisation() -> Figure:
    """Success over training, Task 2, with and without hindsight localisation."""
    return _two(load("localisation-2026-11.json"), {"m1": "with localisation", "base": "without"})


def replay() -> Figure:
    """Success over training, Task 2, where what reached something is imitated once and again."""
    found = load("localisation-2026-11.json") | load("replay-2026-11.json")
    return _two(found, {"replay": "imitated again", "m1": "once"})


def memory() -> Figure:
    """Success over training, Task 2, before and after the memory was asked."""
    return _two(records.memory_runs(), {"after": "after", "before": "before"})


def again() -> Figure:
    """Success over training, Task 2, before and after missed seeds began again."""
    return _two(records.again_runs(), {"after": "after", "before": "before"})


def new_objects() -> Figure:
    """Success with an object that was left out, a panel each: with the weights kept, and from scratch."""
    found = [record for record in load(NEW_OBJECTS).values() if "learned" in record]
    figure, panels = plt.subplots(1, len(found), figsize=(9, 4), layout="constrained", sharey=True)
    for record, axes in zip(found, panels, strict=True):
        before = {"episodes": 0, "new": record["not_shown"], "known": record["known"]}
        for (kind, said), colour in zip(records.BEGUN.items(), ("vhs", "gdan"), strict=True):
            runs = [*([before] if kind == "from" else []), *record["learned"][kind]]
            for asked, style in (("new", "-"), ("known", ":")):
                points = np.array([[one["episodes"], one[asked]["success"]] for one in runs])
                name = {"new": "the new object", "known": "the other four"}[asked]
                line: dict[str, Any] = {"color": COLOURS[colour], "linewidth": 1.6, "linestyle": style}
                axes.plot(*points.T, label=f"{name}, {said}", **line)
        most = max(one["pictures"] for one in record["shown"])
        rates = [one["success"] for one in record["shown"] if one["pictures"] == most]
        told = f"the new object, shown {most} pictures, nothing learned"
        axes.plot(0, np.mean(rates), "o", color=PARTS[2], clip_on=False, zorder=3, label=told)
        axes.set(title=f"new: {record['left_out'].replace('_', ' ')}")
        _success(axes)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=9)
    return figure


def elsewhere() -> Figure:
    """Success over minutes of a core, a panel an environment of others."""
    found = records.elsewhere()
    figure, panels = plt.subplots(2, 3, figsize=(12, 6.4), layout="constrained", sharey=True, sharex=True)
    for (task, title), axes in zip(records.ELSEWHERE.items(), panels.flat, strict=True):
        for colour, (method, shown) in zip(("vhs", "pg", "a3c", "gdan"), records.RIVALS.items(), strict=True):
            runs = found.get((task, method), [])
            for number, run in enumerate(runs):
                style: dict[str, Any] = {"color": COLOURS[colour], "linewidth": 1.4}
                style |= {"marker": "o"} if len(run) == 1 else {}  # one row makes no line
                axes.plot(run[:, 0], _smooth(run[:, 1]), label=None if number else shown, **style)
        axes.set(title=title, ylim=(0, 1), xlim=(0, None))
        axes.yaxis.set_major_formatter(lambda y, _: f"{y:.0%}")
    for axes in panels[-1]:
        axes.set(xlabel="minutes of a core")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def _two(found: dict[str, Any], names: dict[str, str]) -> Figure:
    """Success over training of runs of two names."""
    runs = curves(found)
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    for (name, shown), method in zip(names.items(), ("vhs", "gdan"), strict=True):
        _band(axes, runs[name], shown, COLOURS[method])
    _success(axes)
    axes.legend(loc="lower right")
    return figure


def overlooked() -> Figure:
    """Outcomes of the shipped agent by how much of the goal can be seen."""
    rows = load(OVERLOOKED)["agents"]["shipped"]["pixels"]
    names = [f"{row['from']}-{row['to'] - 1}" if row["to"] < 84 * 84 else f"{row['from']}+" for row in rows]
    figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
    counts = np.array([[row["success"], row["failure"] + row["timeout"]] for row in rows])
    shares = 100 * counts / counts.sum(axis=1, keepdims=True)
    axes.bar(names, shares[:, 0], color=COLOURS["vhs"], label="success")
    axes.bar(names, shares[:, 1], bottom=shares[:, 0], color=PARTS[2], label="timeout or failure")
    for place, count in enumerate(counts.sum(axis=1)):
        axes.text(place, 3, f"{count}", ha="center", color="white", fontsize=9)
    axes.set(
        xlabel="pixels of the goal in the best of eight views from the start (in the bars: episodes)",
        ylabel="% of episodes",
    )
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    return figure


def profile() -> Figure:
    """Where the time of a training step goes."""
    figure, axes = plt.subplots(figsize=(9, 2.4), layout="constrained")
    groups = {
        "network: forward, backward, losses, optimiser": (
            "backward",
            "extractor",
            "LSTM",
            "optimiser",
            "SupCon",
        ),
        "environments: physics, drawing, reset": ("rooms",),
        "acting, and the rest": ("acting", "update", "goal images", "python"),
    }
    for row, (shown, name) in enumerate(
        (("float32", "profile-2026-11"), ("bfloat16", "profile-bfloat16-2026-11"))
    ):
        us, left = load(f"{name}.json")["us_per_step"], 0.0
        for colour, (group, starts) in zip(PARTS, groups.items(), strict=True):
            width = sum(value for part, value in us.items() if part.startswith(starts))
            axes.barh(shown, width, left=left, color=colour, label=group if row else None)
            axes.text(left + width / 2, row, f"{width:.0f}", ha="center", va="center", color="white")
            left += width
    axes.set(xlabel="microseconds per environment step, one core")
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, fontsize=9)
    return figure


FIGURES = {
    "methods-long.svg": lambda: methods(load(LONG), METHODS),
    "methods-short.svg": lambda: methods(records.short_runs(), SHORT_METHODS),
    "relabelling.svg": relabelling,
    "localisation.svg": localisation,
    "replay.svg": replay,
    "memory.svg": memory,
    "again.svg": again,
    "new-objects.svg": new_objects,
    "elsewhere.svg": elsewhere,
    "overlooked.svg": overlooked,
    "profile.svg": profile,
}


def _success(axes: Axes) -> None:
    axes.set(xlabel="episodes", ylim=(0, 1), xlim=(0, None))
    axes.xaxis.set_major_formatter(lambda x, _: f"{x / 1000:g}k")
    axes.yaxis.set_major_formatter(lambda y, _: f"{y:.0%}")


def _band(axes: Axes, runs: list[Curve], label: str, colour: str) -> None:
    """A line without drawn steps: of each curve as many points as a figure shows."""
    if not runs:
        return
    length = min(len(run) for run in runs)
    success = np.array([_smooth(run[:length, 1]) for run in runs])
    episodes = runs[0][:length, 0]
    seeds = f", {len(runs)} seeds" if len(runs) > 1 else ""
    line: dict[str, Any] = {"color": colour, "linewidth": 1.6, "label": label + seeds}
    axes.plot(episodes, success.mean(axis=0).round(3), **line)
    if len(runs) > 1:
        low, high = success.min(axis=0), success.max(axis=0)
        axes.fill_between(episodes, low, high, color=colour, alpha=0.18, linewidth=0)


def _smooth(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Mean over three rows; at the ends over two."""
    if len(values) < 3:
        return values
    sums = np.convolve(values, np.ones(3), mode="same")
    return sums / np.convolve(np.ones_like(values), np.ones(3), mode="same")


if __name__ == "__main__":
    for name, draw in FIGURES.items():
        with mpl.rc_context(STYLE):
            draw().savefig(HERE / name, metadata={"Date": None})
