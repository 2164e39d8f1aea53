"""Print the tables of docs/results.md: `python docs/results/tables.py IN.json`, which `summarise.py` made.

First success of the five methods on the three tasks, beside the paper's; then where the mean success over
2,000 training episodes reaches a rate, as sharp as the log with `--every 500`; then the evaluations. Mean and
standard deviation over the seeds of each configuration.
"""

import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhs.eval.compare import WINDOW
from vhs.eval.metrics import first_row_at_rate
from vhs.eval.paper import REFERENCE_RATE, SUCCESS

RATES = (REFERENCE_RATE, 0.90, 0.92, 0.95)
ROOMS = (0, 1, 2)
"""Seeds of the evaluations to count: others chose between agents."""
METHODS = {"vhs": "VHS", "pg": "PG", "gdan": "GDAN", "a3c": "A3C", "gcsl": "GCSL"}
VARIANTS = {
    "gdan-learning_rate=0.0005": "GDAN at the others' rate, 5e-4",
    "pg-embedding=word": "PG with goal words",
    "vhs-relabel_on=failure+timeout": "VHS, failures and timeouts relabelled",
    "vhs-relabel_on=timeout": "VHS, timeouts relabelled",
    "vhs-relabel_probability=0.4": "VHS, relabel probability 0.4",
    "vhs-relabel_probability=0.6": "VHS, relabel probability 0.6",
    "vhs-relabel_probability=1.0": "VHS, relabel probability 1",
}
"""How the pages name what sweeps call so."""
Groups = dict[tuple[str, str], list[dict[str, float]]]
"""Configuration and rooms: the means of each of its runs, actions sampled."""


def comparison(groups: Groups) -> str:
    """Success with sampled actions beside the paper's."""
    lines = [
        "| | Task 1 | in the paper | Task 2 | in the paper | Task 3 | in the paper |",
        "|---|---|---|---|---|---|---|",
    ]
    for method in METHODS:
        cells = [METHODS[method]]
        for task, paper in SUCCESS.items():
            runs = groups.get((f"{task}-{method}", ", ".join(map(str, ROOMS))))
            shown = f"{_mean(runs, 'success', 100, ' %')} ({len(runs)})" if runs else "not run"
            cells += [shown, f"{paper[method]:.1%}".replace("%", " %")]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def milestones(records: dict[str, Any]) -> str:
    """Episodes to each rate, mean success of the last 5,000 episodes, minutes of each whole run."""
    groups: dict[str, list[NDArray[np.float64]]] = defaultdict(list)
    for name, run in records.items():
        groups[name.rpartition("-seed")[0]].append(np.array(run["curve"], dtype=np.float64))
    rates = " | ".join(f"{rate:.1%}" for rate in RATES)
    lines = [f"| | seeds | {rates} | last 5,000 | minutes |", "|---" * (4 + len(RATES)) + "|"]
    for name, curves in sorted(groups.items(), key=lambda item: _place(item[0])):
        cells = [_shown(name), str(len(curves)), *(_reached(curves, rate) for rate in RATES)]
        late = [{"success": float(c[c[:, 0] > c[-1, 0] - 5_000, 2].mean())} for c in curves]
        minutes = " / ".join(f"{curve[-1, 1]:.0f}" for curve in curves)
        lines.append(f"| {' | '.join([*cells, _mean(late, 'success', 100, ' %'), minutes])} |")
    return "\n".join(lines)


def _reached(curves: list[NDArray[np.float64]], rate: float) -> str:
    """Episodes to a rate: mean and deviation over the seeds, or how many of them reached it."""
    rows = [first_row_at_rate(curve[:, 0].astype(np.int64), curve[:, 2], rate, WINDOW) for curve in curves]
    reached = np.array([c[row, 0] for c, row in zip(curves, rows, strict=True) if row is not None])
    if len(reached) < len(curves):
        return f"{len(reached)} of {len(curves)} seeds" if len(reached) else "not reached"
    deviation = f" ± {reached.std(ddof=1):,.0f}" if len(reached) > 1 else ""
    return f"{reached.mean():,.0f}{deviation}"


def evaluated(records: dict[str, Any]) -> Groups:
    """Group the evaluations of runs that differ by seed alone."""
    groups: Groups = defaultdict(list)
    for name, run in records.items():
        newest = max(entry["trained_episodes"] for entry in run["evaluations"])
        entries = [
            entry
            for entry in run["evaluations"]
            if entry["trained_episodes"] == newest and entry["seed"] in ROOMS and not entry["greedy"]
        ]
        rooms = ", ".join(map(str, sorted(entry["seed"] for entry in entries)))
        means = {
            key: float(np.mean([entry[key] for entry in entries]))
            for key in ("success", "failure", "timeout", "spl")
        }
        groups[name.rpartition("-seed")[0], rooms].append(means)
    return groups


def evaluations(groups: Groups) -> str:
    """Success, outcomes and SPL of each configuration and task."""
    lines = [
        "| | rooms | seeds | success | failure | timeout | SPL |",
        "|---|---|---|---|---|---|---|",
    ]
    for (name, rooms), runs in sorted(groups.items(), key=lambda item: _place(item[0][0])):
        cells = [_shown(name), rooms, str(len(runs)), _mean(runs, "success", 100, " %")]
        cells += [
            _mean(runs, "failure", 100, " %"),
            _mean(runs, "timeout", 100, " %"),
            _mean(runs, "spl", 1, ""),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _place(name: str) -> tuple[bool, str, int]:
    """Methods by task, as the paper orders them, then variants."""
    task, _, variant = name.partition("-")
    return variant not in METHODS, task, [*METHODS, *VARIANTS].index(variant)


def _shown(name: str) -> str:
    task, _, variant = name.partition("-")
    return f"Task {task[-1]}, {(METHODS | VARIANTS)[variant]}"


def _mean(runs: list[dict[str, float]], key: str, factor: float, unit: str) -> str:
    values = np.array([run[key] for run in runs]) * factor
    digits = 1 if unit else 3
    deviation = f" ± {values.std(ddof=1):.{digits}f}" if len(values) > 1 else ""
    return f"{values.mean():.{digits}f}{deviation}{unit}"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python docs/results/tables.py IN.json")
    read = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    groups = evaluated(read)
    print(comparison(groups), milestones(read), evaluations(groups), sep="\n\n")
