"""The runs that a report is about: what their directories hold, and which differ in their seed alone."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vhs.config import Config
from vhs.config.variants import label
from vhs.errors import CheckpointError
from vhs.runs.checkpoint import has_checkpoint
from vhs.runs.directory import CONFIG_NAME, META_NAME, read_config, read_meta
from vhs.runs.log import LOG_NAME
from vhs.runs.reader import settings

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Run:
    """What is left of one training run."""

    path: Path
    name: str
    """Its path below the directory that the report is about."""
    config: Config | None
    rows: tuple[Row, ...]
    """Of the log, in order of episodes."""
    meta: Row
    """Of `run.json`; empty where there is none."""
    notes: tuple[str, ...]
    """What is missing or damaged, a sentence each."""

    @property
    def has_checkpoint(self) -> bool:
        """Whether there is an agent to look at."""
        return self.config is not None and has_checkpoint(self.path)

    @property
    def final_success(self) -> float:
        """Mean success rate over the last tenth of training; -1 without a log."""
        return final_mean(self.rows, "rate/success") if self.rows else -1.0


@dataclass(frozen=True, slots=True)
class Group:
    """Runs that differ in their seed alone."""

    label: str
    """``VHS``, or ``VHS, relabel_on=timeout`` for a variant."""
    task: str
    runs: tuple[Run, ...]

    @property
    def method(self) -> str:
        """The method as the paper writes it."""
        return self.label.partition(", ")[0]

    @property
    def variant(self) -> str:
        """What sets it apart from the plain method; empty for that."""
        return self.label.partition(", ")[2]


def final_mean(rows: Sequence[Row], key: str) -> float:
    """Mean of a value over the last tenth of the episodes, every row with the weight of its episodes."""
    end = rows[-1]["episodes"]
    spans = zip((0, *(row["episodes"] for row in rows)), rows, strict=False)
    late = [(row["episodes"] - before, row[key]) for before, row in spans if row["episodes"] > 0.9 * end]
    return float(sum(span * value for span, value in late) / sum(span for span, _ in late))


def find_runs(path: Path) -> list[Run]:
    """The run in `path`, or every run below it.

    Raises:
        CheckpointError: there is none.
    """
    if not path.is_dir():
        raise CheckpointError(f"{path}: expected the directory of a run or of several, found no directory")
    if _is_run(path):
        return [_read(path, path.resolve().name)]
    found = sorted(_runs_below(path))
    if not found:
        raise CheckpointError(f"{path}: expected {CONFIG_NAME} or {LOG_NAME} in it or below, found neither")
    return [_read(run, str(run.relative_to(path))) for run in found]


def _runs_below(path: Path) -> Iterator[Path]:
    """Directories of runs, also behind links; each counts once, and no run holds another."""
    seen = set()
    for directory, below, _ in os.walk(path, followlinks=True):
        place = Path(directory)
        if place.resolve() in seen:
            below.clear()
        elif _is_run(place):
            below.clear()
            yield place
        below.sort()
        seen.add(place.resolve())


def group_runs(runs: Sequence[Run]) -> list[Group]:
    """Put runs of one configuration together, each of another seed; in order of task and label.

    The same seed again, as in a copy, is no other seed: it stands in a further group.
    """
    by_key: dict[tuple[str, int], list[Run]] = {}
    met: Counter[tuple[str, int]] = Counter()
    for run in runs:
        key = run.name if run.config is None else json.dumps(settings(run.config), sort_keys=True)
        seed = (key, 0 if run.config is None else run.config.seed)
        by_key.setdefault((key, met[seed]), []).append(run)
        met[seed] += 1
    groups = [Group(_label(members, runs), _task(members[0]), tuple(members)) for members in by_key.values()]
    repeated = Counter((group.task, group.label) for group in groups)
    named = [
        group if repeated[group.task, group.label] == 1
        else Group(f"{group.label} ({group.runs[0].name})", group.task, group.runs)
        for group in groups
    ]  # fmt: skip
    return sorted(named, key=lambda group: (group.task, group.label))


def _task(run: Run) -> str:
    return "unknown task" if run.config is None else f"Task {run.config.task.removeprefix('task')}"


def _label(members: Sequence[Run], runs: Sequence[Run]) -> str:
    """The method as the paper writes it, and what sets it apart from others, the same on every task."""
    config = members[0].config
    if config is None:
        return members[0].name
    peers = [settings(run.config) | {"task": config.task} for run in runs if run.config]
    method, *changed = label(settings(config), peers).split()
    return ", ".join([method.upper(), *changed])


def _is_run(path: Path) -> bool:
    return (path / CONFIG_NAME).exists() or (path / LOG_NAME).exists()


def _read(path: Path, name: str) -> Run:
    notes: list[str] = []
    config = _config(path, notes)
    rows = _rows(path / LOG_NAME, notes)
    meta = _meta(path, notes)
    if config is not None and not has_checkpoint(path):
        notes.append("no checkpoint: no goal store, prototypes or episodes to show")
    return Run(path, name, config, rows, meta, tuple(notes))


def _config(path: Path, notes: list[str]) -> Config | None:
    try:
        return read_config(path)
    except CheckpointError as error:
        notes.append(str(error))
        return None


def _rows(path: Path, notes: list[str]) -> tuple[Row, ...]:
    """Rows of a log; a damaged line is left out and said so, for a page about the others is worth having."""
    if not path.exists():
        notes.append(f"no {LOG_NAME}: no learning curves")
        return ()
    rows = []
    text = path.read_text(encoding="utf-8", errors="replace")
    for number, line in enumerate(text.splitlines(), start=1):
        try:
            row = json.loads(line)
            # What every curve needs: a row without it is as good as damaged.
            if not (row["episodes"] > 0 and 0 <= row["rate/success"] <= 1):
                raise ValueError(line)
            rows.append(row)
        except (ValueError, KeyError, TypeError):
            notes.append(f"{LOG_NAME}: line {number} is damaged and was left out")
    if not rows:
        notes.append(f"{LOG_NAME}: no row yet")
    return tuple(sorted(rows, key=lambda row: row["episodes"]))


def _meta(path: Path, notes: list[str]) -> Row:
    try:
        return read_meta(path)
    except CheckpointError:
        notes.append(f"no readable {META_NAME}: what made the run is not known")
        return {}
