"""Runs as everything that compares or shows some sees them: read from the disk, grouped by what differs.

There is one reader. Whether something that is missing or damaged is an error or a note beside the rest is the
caller's choice: a comparison is strict, a page about runs is not.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from vhs.config import Config
from vhs.config.variants import Label, flat_config, label
from vhs.errors import CheckpointError, ComparisonError
from vhs.runs.checkpoint import has_checkpoint
from vhs.runs.directory import CONFIG_NAME, MAY_CHANGE, META_NAME, read_config, read_meta
from vhs.runs.evaluations import read_evaluations
from vhs.runs.rows import LOG_NAME, Row, read_log

IGNORED = (MAY_CHANGE - {"train.episodes"}) | {"seed"}
"""Keys in which the runs of a group may differ: the seed, and what changes nothing that is learned."""

_Part = TypeVar("_Part")


@dataclass(frozen=True, slots=True)
class Run:
    """What the directory of one run holds."""

    path: Path
    name: str
    """Its path below the directory in which it was looked for, or the name of that directory."""
    found_config: Config | None
    """None where it cannot be read, which a strict reader does not take."""
    rows: Sequence[Row] = ()
    """Of the log, in order of episodes."""
    made_by: Mapping[str, Any] = field(default_factory=dict)
    """Command, version, commit, machine and time of every start, as `run.json` has them."""
    evaluations: Sequence[Mapping[str, Any]] = ()
    """Every entry of `eval.json`."""
    notes: Sequence[str] = ()
    """What is missing or damaged, a sentence each."""

    @property
    def config(self) -> Config:
        """The configuration.

        Raises:
            CheckpointError: it cannot be read.
        """
        if self.found_config is None:
            raise CheckpointError(f"{self.path}: expected a readable {CONFIG_NAME}, found none")
        return self.found_config

    @property
    def has_checkpoint(self) -> bool:
        """Whether there is an agent to look at."""
        return self.found_config is not None and has_checkpoint(self.path)

    @property
    def starts(self) -> list[Mapping[str, Any]]:
        """What made it, for its first start and every later one."""
        return [self.made_by, *self.made_by.get("resumed", ())]

    @property
    def final_success(self) -> float:
        """Mean success rate over the last tenth of training; -1 without a log."""
        return self.final_mean("rate/success") if self.rows else -1.0

    def final_mean(self, key: str) -> float:
        """Mean of a value over the last tenth of the episodes, every row with the weight of its episodes."""
        end = self.rows[-1]["episodes"]
        spans = zip((0, *(row["episodes"] for row in self.rows)), self.rows, strict=False)
        late = [(row["episodes"] - before, row[key]) for before, row in spans if row["episodes"] > 0.9 * end]
        return float(sum(span * value for span, value in late) / sum(span for span, _ in late))

    def column(self, key: str) -> NDArray[np.float64]:
        """A number of every row, shape [rows].

        Raises:
            CheckpointError: there are no rows, or one without the number; it is named.
        """
        log = self.path / LOG_NAME
        if not self.rows:
            raise CheckpointError(f"{log}: expected a row for every window of training, found none")
        for number, row in enumerate(self.rows, 1):
            if not isinstance(row.get(key), int | float):
                raise CheckpointError(
                    f"{log}:{number}: damaged line: expected a number as `{key}`, found {row.get(key)!r}"
                )
        return np.array([row[key] for row in self.rows], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Group:
    """Runs that differ by seed alone."""

    label: Label
    task: str | None
    """As `task` of their configuration; None where that cannot be read."""
    runs: Sequence[Run]


def find_runs(paths: Sequence[Path]) -> dict[Path, str]:
    """Directories of runs with their names: each path is one, or holds some at any depth, also behind links.

    Raises:
        CheckpointError: a path is neither.
    """
    found: dict[Path, str] = {}
    seen: set[Path] = set()
    for path in paths:
        if not path.is_dir():
            raise CheckpointError(
                f"{path}: expected the directory of a run or of several, found no directory"
            )
        below = [path] if _is_run(path) else sorted(_runs_below(path))
        if not below:
            raise CheckpointError(
                f"{path}: expected {CONFIG_NAME} or {LOG_NAME} in it or below, found neither"
            )
        for run in below:
            if run.resolve() not in seen:
                seen.add(run.resolve())
                found[run] = run.resolve().name if run == path else str(run.relative_to(path))
    return found


def read_run(path: Path, name: str = "", *, strict: bool = True) -> Run:
    """Read what there is of a run.

    Args:
        path: its directory.
        name: what it is called; the name of the directory by default.
        strict: whether what is damaged is raised, or left out and noted; what is only missing is noted.

    Raises:
        CheckpointError: of a strict reader: a file of the run is damaged, or the configuration missing; it is
            named, and the line of a log too.
    """
    notes: list[str] = []

    def damaged(error: CheckpointError) -> None:
        if strict:
            raise error
        notes.append(str(error).removeprefix(f"{path}{os.sep}"))

    def read(part: Callable[[Path], _Part], otherwise: _Part) -> _Part:
        try:
            return part(path)
        except CheckpointError as error:
            damaged(error)
            return otherwise

    config: Config | None = read(read_config, None)
    rows = read_log(path, damaged)
    if not rows:
        notes.append(f"{LOG_NAME}: no row yet" if (path / LOG_NAME).exists() else f"no {LOG_NAME}: no curves")
    made_by: dict[str, Any] = {}
    if (path / META_NAME).exists():
        made_by = read(read_meta, made_by)
    else:
        notes.append(f"no {META_NAME}: what made the run is not known")
    none: list[dict[str, Any]] = []
    evaluations = read(read_evaluations, none)
    if not has_checkpoint(path):
        notes.append("no checkpoint: no goal store, prototypes or episodes to show")
    return Run(path, name or path.resolve().name, config, rows, made_by, evaluations, notes)


def group_runs(runs: Sequence[Run], *, strict: bool = True) -> list[Group]:
    """Put runs that differ by seed alone together, in the order in which they come, seeds ascending.

    A label is the method's name, with what sets the group apart from others of that method and from the
    defaults; it is the same on every task.

    Args:
        runs: of any task.
        strict: whether the same seed again is refused; else it stands in a further group, whose label says
            of which run it is.

    Raises:
        ComparisonError: of the strict: two runs have the same configuration and seed.
    """
    by_key: dict[tuple[str, int], list[Run]] = {}
    met: dict[tuple[str, int], Run] = {}
    copies: Counter[tuple[str, int]] = Counter()
    for run in runs:
        own = (_identity(run), run.found_config.seed if run.found_config else 0)
        if strict and own in met:
            raise ComparisonError(
                f"expected one run a seed, found two of seed {own[1]} and one configuration: "
                f"{met[own].path} and {run.path}"
            )
        by_key.setdefault((own[0], copies[own]), []).append(run)
        met[own] = run
        copies[own] += 1
    groups = [_group(members, runs) for members in by_key.values()]
    repeated = Counter((group.task, group.label) for group in groups)
    return [
        replace(group, label=replace(group.label, copy=group.runs[0].name))
        if repeated[group.task, group.label] > 1
        else group
        for group in groups
    ]


def settings(config: Config) -> dict[str, Any]:
    """Every setting that tells groups of runs apart, by dotted key."""
    return {key: value for key, value in flat_config(config).items() if key not in IGNORED}


def _identity(run: Run) -> str:
    """The same for runs that differ by seed alone."""
    if run.found_config is None:
        return run.name
    return json.dumps(settings(run.found_config), sort_keys=True)


def _group(members: Sequence[Run], runs: Sequence[Run]) -> Group:
    config = members[0].found_config
    if config is None:
        return Group(Label(members[0].name), None, members)
    # What sets a method apart on one task shall be said on every task.
    peers = [settings(run.found_config) | {"task": config.task_name} for run in runs if run.found_config]
    ordered = sorted(members, key=lambda run: run.config.seed)
    return Group(label(settings(config), peers), config.task_name, ordered)


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


def _is_run(path: Path) -> bool:
    return (path / CONFIG_NAME).exists() or (path / LOG_NAME).exists()
