"""What the JSON files beside this script hold, as the tables and figures need it."""

import json
import shlex
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhs.eval.compare import WINDOW
from vhs.eval.metrics import first_row_at_rate

HERE = Path(__file__).parent
ROOMS = (0, 1, 2)
"""Seeds of the evaluations that count: others chose between agents."""
TASKS = ("task1", "task2", "task3")
METHODS = {"vhs": "VHS", "pg": "PG", "gdan": "GDAN", "a3c": "A3C", "gcsl": "GCSL"}
SHORT_METHODS = {
    "vhs": "VHS",
    "once": "VHS, every seed once",
    "paper": "VHS, the paper's terms",
    **METHODS,
}
"""Of 30,000 episodes: as configured, before missed seeds began again, with the paper's terms alone."""
FINAL, ONCE, MEMORY = "final-2026-11.json", "vhs-2026-11.json", "memory-2026-11.json"
"""Runs of 30,000 episodes: of all methods with the paper's terms, of VHS with its own, of what led there."""
AGAIN, NOW = "again-2026-11.json", "discount-2026-11.json"
"""The same whose episodes may last longer and whose missed seeds begin again, and as configured: that with a
discount that the task decides."""
VARIANTS = {
    "vhs": "failures, probability 0.8 (VHS)",
    "vhs-relabel_probability=0.4": "failures, probability 0.4",
    "vhs-relabel_probability=0.6": "failures, probability 0.6",
    "vhs-relabel_probability=1.0": "failures, probability 1",
    "vhs-relabel_on=failure+timeout": "failures and timeouts",
    "vhs-relabel_on=timeout": "timeouts",
    "pg": "nothing (PG)",
    "pg-embedding=word": "nothing, goals told by words",
}
"""What is relabelled, as sweeps call it and as the pages do."""

ELSEWHERE = {
    "grid": "a grid of ours",
    "babyai": "BabyAI-GoToLocal",
    "miniworld_sign": "MiniWorld-Sign",
    "pointmaze": "PointMaze",
    "vizdoom_fetch": "ViZDoom",
    "crafter_fetch": "Crafter",
}
"""Tasks of `examples/tasks` as pages call them."""
RIVALS = {"vhs": "VHS", "pg": "PG", "a3c": "A3C", "recurrent_ppo": "recurrent PPO"}

BEGUN = {"from": "weights kept", "scratch": "from scratch"}
"""How runs began that are asked for an object that was left out, by what `new_objects.py` calls them."""

Curve = NDArray[np.float64]


def load(name: str) -> Any:
    """The content of a file beside this script."""
    return json.loads((HERE / name).read_text(encoding="utf-8"))


def short_runs() -> Any:
    """Runs of 30,000 episodes by task and method: VHS as configured, every seed once, as in the paper."""
    paper = {name.replace("-vhs-seed", "-paper-seed"): run for name, run in load(FINAL).items()}
    once = {name.replace("-vhs-seed", "-once-seed"): run for name, run in load(ONCE).items()}
    return paper | once | load(NOW)


def memory_runs() -> Any:
    """Task 2 before still steps were left out and the memory was asked, and after."""
    after = {
        name.replace("task2-vhs", "after"): run
        for name, run in load(ONCE).items()
        if name.startswith("task2-vhs-seed")
    }
    return load(MEMORY) | after


def again_runs() -> Any:
    """Task 2 before missed seeds began again, and after."""
    return {
        name.replace("task2-vhs", shown): run
        for shown, file in (("before", ONCE), ("after", AGAIN))
        for name, run in load(file).items()
        if name.startswith("task2-vhs-seed")
    }


def elsewhere() -> dict[tuple[str, str], list[Curve]]:
    """Of tasks of others, by task and method, a curve a seed: processor minutes, success, episodes."""
    found: dict[tuple[str, str], list[Curve]] = defaultdict(list)
    for run in load("elsewhere-2026-11.json")["runs"]:
        rows = [[row["processor_s"] / 60, row["success"], row["episodes"]] for row in run["curve"]]
        found[run["task"], run["method"]].append(np.array(rows, dtype=np.float64))
    return found


def described(record: dict[str, Any]) -> str:
    """What was left out of a run, and what was changed of the method."""
    words = shlex.split(record["command"])
    changed = [after for word, after in pairwise(words) if word == "--set"]
    return ", ".join([record["left_out"].replace("_", " "), *(f"`{key}`" for key in changed)])


def at_the_end(curve: Curve, episodes: int = 500) -> float:
    """Success of at least so many last episodes of a curve of `elsewhere`."""
    counts = np.diff(curve[:, 2], prepend=0.0)
    first = max(np.flatnonzero(np.cumsum(counts[::-1])[::-1] >= min(episodes, counts.sum())))
    return float(np.average(curve[first:, 1], weights=counts[first:]))


def curves(records: dict[str, Any]) -> dict[str, list[Curve]]:
    """Episodes and success of every run, by what its name says before the seed; each of shape [rows, 2]."""
    found: dict[str, list[Curve]] = defaultdict(list)
    for name, run in records.items():
        at = [run["columns"].index(column) for column in ("episodes", "success")]
        found[name.rpartition("-seed")[0]].append(np.array(run["curve"], dtype=np.float64)[:, at])
    return found


def evaluations(records: dict[str, Any]) -> dict[str, list[dict[str, float]]]:
    """Means of each run over the rooms that count, actions sampled, of its most trained evaluation."""
    found: dict[str, list[dict[str, float]]] = defaultdict(list)
    for name, run in records.items():
        entries = counted(run["evaluations"], greedy=False)
        if entries:
            keys = ("success", "failure", "timeout", "spl")
            means = {key: float(np.mean([entry[key] for entry in entries])) for key in keys}
            found[name.rpartition("-seed")[0]].append(means)
    return found


def counted(
    entries: list[dict[str, Any]], *, greedy: bool, rooms: Sequence[int] = ROOMS
) -> list[dict[str, Any]]:
    """The newest evaluations in the rooms of some seeds, those that count unless others are said."""
    newest = max((entry["trained_episodes"] for entry in entries), default=0)
    return [
        entry
        for entry in entries
        if entry["trained_episodes"] == newest and entry["seed"] in rooms and entry["greedy"] == greedy
    ]


def episodes_to(rate: float, runs: list[Curve], window: int = WINDOW) -> NDArray[np.float64]:
    """Episodes until the mean success of the last `window` reached a rate, of each run that reached it."""
    rows = [first_row_at_rate(curve[:, 0].astype(np.int64), curve[:, 1], rate, window) for curve in runs]
    return np.array([curve[row, 0] for curve, row in zip(runs, rows, strict=True) if row is not None])
