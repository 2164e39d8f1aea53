"""Draw the learning curve of a run: `python docs/results/plot.py LOG.jsonl PICTURE.png`.

Success, failure and timeout rate over episodes, each over the window of one log row, beside the paper's.
"""

import json
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt

from vhs.eval.paper import SUCCESS

COLOURS = {"success": "#1b7f4d", "failure": "#c0392b", "timeout": "#7f8c8d"}


def draw(log: Path, picture: Path) -> None:
    """Read the rows of `log` and write `picture`."""
    rows = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    episodes = [row["episodes"] for row in rows]
    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    for outcome, colour in COLOURS.items():
        axes.plot(
            episodes, [row[f"rate/{outcome}"] for row in rows], color=colour, label=outcome, linewidth=1.5
        )
    for method in ("vhs", "gdan"):
        rate, name = SUCCESS["task2"][method], method.upper()
        axes.axhline(rate, color="black", linewidth=0.7, linestyle=":")
        label = f"{name} in\nthe paper\n{rate:.1%}"
        axes.annotate(label, (1.01, rate), xycoords=("axes fraction", "data"), va="center", fontsize=8)
    minutes = rows[-1]["time/minutes"]
    axes.set(
        xlabel=f"episodes ({minutes:.0f} minutes in all)",
        ylabel="share of episodes",
        ylim=(0, 1),
        xlim=(0, None),
    )
    axes.legend(loc="center right", frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python docs/results/plot.py LOG.jsonl PICTURE.png")
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
