"""Draw success of summarised runs: `python docs/results/plot_tasks.py IN.json PICTURE.png`.

Every method on each of the three tasks, and on Task 2 what changes when failures are relabelled otherwise or
the goal is a word; runs that differ by seed alone are a mean and, from the lowest to the highest, a band.
"""

import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from vhs.eval.paper import SUCCESS

METHODS = {
    "vhs": "#1b7f4d",
    "pg": "#cc79a7",
    "gdan": "#e69f00",
    "gdan-learning_rate=0.0005": "#8c510a",
    "gcsl": "#56b4e9",
    "a3c": "#7f8c8d",
}
ABLATIONS = {
    "vhs": ("vhs: failures, probability 0.8", "#1b7f4d"),
    "vhs-relabel_probability=0.4": ("probability 0.4", "#56b4e9"),
    "vhs-relabel_probability=0.6": ("probability 0.6", "#0072b2"),
    "vhs-relabel_probability=1.0": ("probability 1", "#08306b"),
    "vhs-relabel_on=timeout": ("timeouts", "#e69f00"),
    "vhs-relabel_on=failure+timeout": ("failures and timeouts", "#d55e00"),
    "pg": ("none: pg", "#cc79a7"),
    "pg-embedding=word": ("none, goal as a word", "#7f8c8d"),
}

Curves = dict[tuple[str, str], list[np.ndarray[Any, Any]]]


def draw(records: Path, picture: Path) -> None:
    """Read the curves of `records`, called TASK-METHOD-...-seedN, and write `picture`."""
    curves: Curves = defaultdict(list)
    for name, run in json.loads(records.read_text(encoding="utf-8")).items():
        task, _, variant = name.rpartition("-seed")[0].partition("-")
        curves[task, variant].append(np.array([(row[0], row[2]) for row in run["curve"]]))
    tasks = [task for task in SUCCESS if any(task == known for known, _ in curves)]
    has_ablations = any(("task2", variant) in curves for variant in ABLATIONS.keys() - METHODS.keys())
    rows = (len(tasks) + has_ablations + 1) // 2
    figure, grid = plt.subplots(
        rows, 2, figsize=(13, 4.3 * rows), layout="constrained", sharey=True, squeeze=False
    )
    for task, axes in zip(tasks, grid.flat, strict=False):
        for method, colour in METHODS.items():
            _band(axes, curves[task, method], method.replace("-learning_rate=0.0005", " at 5e-4"), colour)
        axes.axhline(SUCCESS[task]["vhs"], color=METHODS["vhs"], linewidth=0.8, linestyle=":")
        axes.set(title=f"Task {task[-1]} (dotted: VHS in the paper)")
    if has_ablations:
        ablations = grid.flat[len(tasks)]
        for variant, (label, colour) in ABLATIONS.items():
            _band(ablations, curves["task2", variant], label, colour)
        ablations.set(title="Task 2: what is relabelled")
    for axes in list(grid.flat)[len(tasks) + has_ablations :]:
        axes.remove()
    for axes in figure.axes:
        axes.set(xlabel="episodes", ylim=(0, 1), xlim=(0, None))
        axes.legend(loc="best", framealpha=0.85, edgecolor="none", fontsize=8)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in grid[:, 0]:
        axes.set(ylabel="success in training")
    figure.savefig(picture, dpi=110)


def _band(axes: Axes, runs: list[np.ndarray[Any, Any]], label: str, colour: str) -> None:
    if not runs:
        return
    length = min(len(run) for run in runs)
    success = np.array([run[:length, 1] for run in runs])
    episodes = runs[0][:length, 0]
    seeds = f", {len(runs)} seeds" if len(runs) > 1 else ""
    axes.plot(episodes, success.mean(axis=0), color=colour, linewidth=1.5, label=label + seeds)
    axes.fill_between(
        episodes, success.min(axis=0), success.max(axis=0), color=colour, alpha=0.2, linewidth=0
    )


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python docs/results/plot_tasks.py IN.json PICTURE.png")
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
