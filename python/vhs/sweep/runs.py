"""Which runs a sweep has, and in which order: what the runner asks of grids and of a search alike."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from vhs.acting.setup import check_runnable
from vhs.runs.directory import check_run
from vhs.sweep.file import Sweep
from vhs.sweep.plan import PlannedRun, plan_runs


class Runs(Protocol):
    """The runs of a sweep."""

    @property
    def total(self) -> int:
        """How many there are in all."""

    def begin(self) -> None:
        """Go on from what the directory of the sweep has, which is held from now on.

        Raises:
            CheckpointError: it has something else.
        """

    def next(self) -> PlannedRun | None:
        """A run that waits; None where none does, or none before another one has ended.

        Raises:
            ConfigError: what follows is no configuration; the one after it may be.
            CheckpointError: the directory of what follows holds another run.
            OutputError: what is kept about the runs cannot be written; so of the methods below.
        """

    def finish(self, run: PlannedRun, found: Mapping[str, Any]) -> None:
        """Hear how a run was evaluated.

        Raises:
            ConfigError: it was not, as the sweep asks for it.
        """

    def is_hopeless(self, run: PlannedRun) -> bool:
        """Whether the training of a run is not worth its end, by its log so far."""

    def abandon(self, run: PlannedRun) -> None:
        """Hear that a hopeless run has ended."""

    def conclude(self) -> list[str]:
        """What to say when all are finished."""


class Grids:
    """The runs of grids, known from the start."""

    def __init__(self, path: Path, sweep: Sweep, out: Path, cores_per_run: int) -> None:
        """Plan them, as `plan_runs` does.

        Raises:
            ConfigError: one cannot run.
            CheckpointError: a directory holds another configuration's run.
        """
        self._runs = plan_runs(path, sweep, cores_per_run)
        self._out = out
        for run in self._runs:
            check(run, out)
        self._waiting = deque(self._runs)

    @property
    def total(self) -> int:
        """Combinations times seeds, without repetitions."""
        return len(self._runs)

    def begin(self) -> None:
        """Nothing is kept about them."""

    def next(self) -> PlannedRun | None:
        """The next one of the list."""
        return self._waiting.popleft() if self._waiting else None

    def finish(self, run: PlannedRun, found: Mapping[str, Any]) -> None:
        """Nothing depends on it."""

    def is_hopeless(self, run: PlannedRun) -> bool:
        """Every run is wanted."""
        return False

    def abandon(self, run: PlannedRun) -> None:
        """None is."""

    def conclude(self) -> list[str]:
        """How to compare them, a line a task."""
        tasks = sorted({run.config.task_name for run in self._runs})
        return [f"compare them:  vhs compare {self._out / task}-*" for task in tasks]


def check(run: PlannedRun, out: Path) -> None:
    """Refuse a run that could not be started.

    Raises:
        ConfigError: nothing here can run it.
        CheckpointError: its directory holds another configuration's run.
    """
    check_runnable(run.config)
    check_run(run.config, out / run.name)
