"""A comparison as Markdown for people, CSV for spreadsheets and JSON for programs."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from vhs.eval.compare import WINDOW, Comparison, GroupResult, RunResult, trained_episodes
from vhs.runs.files import write_files

_NONE = "-"


def write_comparison(comparison: Comparison, directory: Path) -> None:
    """Write `compare.md`, `compare.csv` and `compare.json`: all three or none.

    Raises:
        OutputError: the directory cannot be written; nothing was changed.
    """
    write_files(
        directory,
        {
            "compare.md": as_markdown(comparison),
            "compare.csv": as_csv(comparison),
            "compare.json": json.dumps(as_json(comparison), indent=2) + "\n",
        },
    )


def as_markdown(comparison: Comparison) -> str:
    """The table, what it means, its caveats, and what made each run."""
    rate = f"{comparison.rate:.1%}"
    header = ["group", "seeds", "trained", "success", "IQM [95 %]", "SPL"]
    header += [f"episodes to {rate}", f"minutes to {rate}", "SRR", "SEI"]
    runs = [result for group in comparison.groups for result in group.runs]
    return "\n".join(
        [
            f"# {comparison.task}: {len(comparison.groups)} groups, {len(runs)} runs",
            "",
            *_table(header, [_group_cells(group) for group in comparison.groups]),
            "",
            f"- Success and SPL: {comparison.protocol.describe()}; mean ± standard deviation over seeds.",
            "- A rate is reached at the first row of the log at which the mean success over the last "
            f"{WINDOW:,} training episodes reaches it.",
            f"- SRR = n_B / n_A and SEI = (n_A - n_B) / n_B in episodes, with `{comparison.reference}` as A.",
            *(f"- {note}" for note in comparison.notes),
            "",
            *_table(["run", "seed", "success", "SPL", "reached", "commit", "command"], map(_run_cells, runs)),
            "",
        ]
    )


def as_csv(comparison: Comparison) -> str:
    """A row a group, shares between 0 and 1, empty where there is no number."""
    rows = [_flat(group) | {"reference": str(comparison.reference)} for group in comparison.groups]
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def as_json(comparison: Comparison) -> dict[str, Any]:
    """Everything: the groups with their runs, and what made each run."""
    return {
        "task": comparison.task,
        "rate": comparison.rate,
        "window_episodes": WINDOW,
        "reference": str(comparison.reference),
        "evaluation": {
            "greedy": comparison.protocol.greedy,
            "sets": [{"seed": seed, "episodes": episodes} for seed, episodes in comparison.protocol.sets],
        },
        "groups": [_flat(group) | {"runs": list(map(_run_entry, group.runs))} for group in comparison.groups],
        "notes": list(comparison.notes),
    }


def _flat(group: GroupResult) -> dict[str, Any]:
    low, high = group.success_interval or (None, None)
    episodes, minutes = group.episodes_to_rate or (None, None), group.minutes_to_rate or (None, None)
    spl = group.spl or (None, None)
    trained = [trained_episodes(result.run) for result in group.runs]
    return {
        "group": str(group.label),
        "seeds": len(group.runs),
        "trained_episodes_min": min(trained),
        "trained_episodes_max": max(trained),
        "success_mean": group.success[0],
        "success_deviation": group.success[1],
        "success_iqm": group.success_iqm,
        "success_low": low,
        "success_high": high,
        "spl_mean": spl[0],
        "spl_deviation": spl[1],
        "seeds_reached": group.seeds_reached,
        "episodes_to_rate_mean": episodes[0],
        "episodes_to_rate_deviation": episodes[1],
        "minutes_to_rate_mean": minutes[0],
        "minutes_to_rate_deviation": minutes[1],
        "srr": group.srr,
        "sei": group.sei,
    }


def _run_entry(result: RunResult) -> dict[str, Any]:
    run = result.run
    return {
        "path": str(run.path),
        "seed": run.config.seed,
        "trained_episodes": trained_episodes(run),
        "success": result.success,
        "spl": result.spl,
        "episodes_to_rate": result.episodes_to_rate,
        "minutes_to_rate": result.minutes_to_rate,
        "made_by": dict(run.made_by),
    }


def _group_cells(group: GroupResult) -> list[str]:
    low_high = group.success_interval
    trained = sorted({trained_episodes(result.run) for result in group.runs})
    return [
        str(group.label),
        str(len(group.runs)),
        " to ".join(f"{count:,}" for count in dict.fromkeys((trained[0], trained[-1]))),
        _spread(group.success, _percent),
        f"{group.success_iqm:.1%}" + (f" [{low_high[0]:.1%}, {low_high[1]:.1%}]" if low_high else ""),
        _NONE if group.spl is None else _spread(group.spl, "{:.3f}".format),
        _reached(group, group.episodes_to_rate, "{:,.0f}".format),
        _reached(group, group.minutes_to_rate, "{:.1f}".format),
        _NONE if group.srr is None else f"{group.srr:.1%}",
        _NONE if group.sei is None else f"{group.sei:.1%}",
    ]


def _run_cells(result: RunResult) -> list[str]:
    episodes = result.episodes_to_rate
    made_by = result.run.made_by
    return [
        str(result.run.path),
        str(result.run.config.seed),
        _percent(result.success),
        _NONE if result.spl is None else f"{result.spl:.3f}",
        "not reached" if episodes is None else f"{episodes:,}",
        str(made_by.get("commit") or _NONE),
        f"`{made_by['command']}`" if "command" in made_by else _NONE,
    ]


def _reached(
    group: GroupResult, spread: tuple[float, float | None] | None, show: Callable[[float], str]
) -> str:
    if spread is not None:
        return _spread(spread, show)
    some = f" ({group.seeds_reached} of {len(group.runs)} seeds did)" if group.seeds_reached else ""
    return f"not reached{some}"


def _spread(spread: tuple[float, float | None], show: Callable[[float], str]) -> str:
    mean, deviation = spread
    return show(mean) if deviation is None else f"{show(mean)} ± {show(deviation)}"


def _percent(share: float) -> str:
    return f"{share:.1%}"


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Markdown whose columns line up in a terminal too."""
    lines = [list(header), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    padded = ["| " + " | ".join(map(str.ljust, line, widths)) + " |" for line in lines]
    return [padded[0], "|" + "|".join("-" * (width + 2) for width in widths) + "|", *padded[1:]]
