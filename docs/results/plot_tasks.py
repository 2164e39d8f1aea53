"""Draw success of summarised runs: `python docs/results/plot_tasks.py IN.json PICTURE.png`."""

import json
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt

PAPER_VHS = {"task1": 0.914, "task2": 0.920, "task3": 0.895}
"""Final success rates in the paper's table."""
COLOURS = {"task1": "#0072b2", "task2": "#1b7f4d", "task3": "#d55e00"}


def draw(records: Path, picture: Path) -> None:
    """Read the curves of `records` and write `picture`; forks of a run are dashed."""
    runs = json.loads(records.read_text(encoding="utf-8"))
    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    for name, run in runs.items():
        task = name.partition("-")[0]
        is_fork = "spread" in name
        curve = [row for row in run["curve"] if not is_fork or row[0] >= run["forked_at"]]
        axes.plot(
            [row[0] for row in curve],
            [row[2] for row in curve],
            color=COLOURS[task],
            linestyle="--" if is_fork else "-",
            linewidth=1.5,
            label=name,
        )
    for task, rate in PAPER_VHS.items():
        axes.axhline(rate, color=COLOURS[task], linewidth=0.7, linestyle=":")
    axes.set(
        xlabel="episodes", ylabel="success in training, mean of 1,000 episodes", ylim=(0, 1), xlim=(0, None)
    )
    axes.legend(loc="lower right", frameon=False, title="dotted: VHS in the paper")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python docs/results/plot_tasks.py IN.json PICTURE.png")
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
