"""Runs as a comparison sees them: read from their directories, checked, grouped by what differs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhs.config import Config
from vhs.config.variants import flat_config, label
from vhs.errors import CheckpointError, ComparisonError
from vhs.runs.directory import CONFIG_NAME, MAY_CHANGE, META_NAME, read_config, read_meta
from vhs.runs.evaluations import EVALUATIONS_NAME, read_evaluations
from vhs.runs.log import LOG_NAME, read_log

IGNORED = (MAY_CHANGE - {"train.episodes"}) | {"seed"}
"""Keys in which the runs of a group may differ: the seed, and what changes nothing that is learned."""

_COLUMNS = ("rate/success", "time/minutes")


@dataclass(frozen=True, slots=True)
class Run:
    """One run: its configuration, its curve, its newest evaluations."""

    path: Path
    config: Config
    made_by: Mapping[str, Any]
    """Command, version, commit, machine and time of every start, as `run.json` has them."""
    episodes: NDArray[np.int64]
    """Episodes of training at the end of each row of the log, rising, shape [rows]."""
    success: NDArray[np.float64]
    """Share of successes in the episodes of each row, shape [rows]."""
    minutes: NDArray[np.float64]
    """Wall-clock of training at the end of each row, shape [rows]."""
    evaluations: Sequence[Mapping[str, Any]]
    """Those of the most trained checkpoint that was evaluated, at least one."""

    @property
    def trained_episodes(self) -> int:
        """Episodes behind the evaluated checkpoint."""
        return int(self.evaluations[0]["trained_episodes"])


@dataclass(frozen=True, slots=True)
class Group:
    """Runs that differ by seed alone, in ascending order of it."""

    label: str
    runs: Sequence[Run]


def find_runs(paths: Sequence[Path]) -> list[Path]:
    """Directories of runs: each path is one, or holds some.

    Raises:
        ComparisonError: a path is neither.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        runs = (
            [path]
            if (path / CONFIG_NAME).exists()
            else sorted(p.parent for p in path.glob(f"*/{CONFIG_NAME}"))
        )
        if not runs:
            raise ComparisonError(
                f"{path}: expected a run or a directory of runs, found no {CONFIG_NAME} in it"
            )
        found |= {run.resolve(): run for run in runs if run.resolve() not in found}
    return list(found.values())


def load_runs(paths: Sequence[Path]) -> list[Run]:
    """Read runs of one task, each with an evaluation.

    Raises:
        CheckpointError: a file of a run is missing or damaged; it is named, and the line of a log too.
        ComparisonError: runs of different tasks, or runs without an evaluation: all are named.
    """
    configs = {path: read_config(path) for path in paths}
    by_task: dict[str, list[Path]] = {}
    for path, config in configs.items():
        by_task.setdefault(config.task, []).append(path)
    if len(by_task) > 1:
        listed = "\n".join(f"  {task}: {', '.join(map(str, by_task[task]))}" for task in sorted(by_task))
        raise ComparisonError(
            f"expected runs of one task, found {len(by_task)}; compare them apart:\n{listed}"
        )
    evaluations = {path: read_evaluations(path) for path in paths}
    missing = [path for path in paths if not evaluations[path]]
    if missing:
        commands = "\n".join(f"  vhs eval {path}" for path in missing)
        raise ComparisonError(
            f"expected {EVALUATIONS_NAME} in every run, found none in {len(missing)}; first run:\n{commands}"
        )
    return [_load(path, config, evaluations[path]) for path, config in configs.items()]


def group_runs(runs: Sequence[Run]) -> list[Group]:
    """Put runs that differ by seed alone together, in the order in which they come.

    A label is the method's name, with what sets the group apart from others of that method and from the
    defaults.

    Raises:
        ComparisonError: two runs have the same configuration and seed.
    """
    groups: dict[str, list[Run]] = {}
    variants: dict[str, dict[str, Any]] = {}
    for run in runs:
        variant = settings(run.config)
        identity = json.dumps(variant, sort_keys=True)
        variants[identity] = variant
        groups.setdefault(identity, []).append(run)
    return [
        Group(label(variants[identity], list(variants.values())), _by_seed(members))
        for identity, members in groups.items()
    ]


def settings(config: Config) -> dict[str, Any]:
    """Every setting that tells groups of runs apart, by dotted key."""
    return {key: value for key, value in flat_config(config).items() if key not in IGNORED}


def _by_seed(runs: Sequence[Run]) -> list[Run]:
    ordered = sorted(runs, key=lambda run: run.config.seed)
    for first, second in pairwise(ordered):
        if first.config.seed == second.config.seed:
            raise ComparisonError(
                f"expected one run a seed, found two of seed {first.config.seed} and one configuration: "
                f"{first.path} and {second.path}"
            )
    return ordered


def _load(path: Path, config: Config, evaluations: Sequence[Mapping[str, Any]]) -> Run:
    newest = max(entry["trained_episodes"] for entry in evaluations)
    episodes, success, minutes = _read_curve(path)
    return Run(
        path=path,
        config=config,
        made_by=_read_made_by(path),
        episodes=episodes,
        success=success,
        minutes=minutes,
        evaluations=[entry for entry in evaluations if entry["trained_episodes"] == newest],
    )


def _read_curve(run: Path) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    rows = read_log(run)
    if not rows:
        raise CheckpointError(f"{run / LOG_NAME}: expected a row for every window of training, found none")
    before = 0
    for number, row in enumerate(rows, 1):
        where = f"{run / LOG_NAME}:{number}: damaged line"
        for column in _COLUMNS:
            if not isinstance(row.get(column), int | float):
                raise CheckpointError(f"{where}: expected a number as `{column}`, found {row.get(column)!r}")
        if row["episodes"] <= before:
            raise CheckpointError(f"{where}: expected more than {before} episodes, found {row['episodes']}")
        before = row["episodes"]
    success, minutes = (np.array([row[column] for row in rows], dtype=np.float64) for column in _COLUMNS)
    return np.array([row["episodes"] for row in rows], dtype=np.int64), success, minutes


def _read_made_by(run: Path) -> dict[str, Any]:
    return read_meta(run) if (run / META_NAME).exists() else {}
