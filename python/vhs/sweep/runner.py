"""Runs a sweep: every run as a job of its own on cores of its own, `vhs train` and then `vhs eval`.

Nothing about progress is kept but the runs themselves: a sweep that starts again looks at each and does what
is left.
"""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from vhs.acting.setup import check_runnable
from vhs.console import Output
from vhs.errors import ConfigError, VhsError
from vhs.interrupt import StopRequest, stop_on_signal
from vhs.runs.directory import LOCK_NAME, check_run
from vhs.runs.files import writing
from vhs.runs.lock import hold
from vhs.sweep.cluster import RayPlace
from vhs.sweep.display import SweepDisplay, describe_result
from vhs.sweep.local import LocalPlace, available_cores
from vhs.sweep.place import Job, Place
from vhs.sweep.plan import EvalSection, PlannedRun, Sweep, evaluation, plan_runs, read_sweep
from vhs.sweep.state import Stage, newest_row, next_stage

_POLL_S = 0.2
_DISPLAY_S = 2.0
_PATIENCE_S = 60.0
"""Of a sweep that ends early with its runs, or that finds runs of a killed one: they save before they end."""


def sweep(
    path: Path,
    out: Path,
    jobs: int | None = None,
    stream: TextIO | None = None,
    *,
    overrides: Sequence[str] = (),
    ray: str | None = None,
) -> int:
    """Train and evaluate every run of a sweep file that is not finished yet.

    Args:
        path: the sweep file.
        out: directory of the runs; what they print goes to `logs/` in it.
        jobs: runs side by side, each on an equal share of the cores; None takes one core a run.
        stream: where a person reads along; standard output by default.
        overrides: ``key=value``, over the keys that the file sets and under those of its grids.
        ray: address of a Ray cluster whose cores are taken, as `ray.init` has it; None takes this machine's.

    Returns:
        0 when all runs are finished, 1 when some failed, 130 when a signal stopped the sweep.

    Raises:
        ConfigError: the sweep file, `jobs` or `overrides` cannot be used; nothing was started.
        CheckpointError: a directory holds another configuration's run; nothing was started.
        OutputError: `out` cannot be written, or another sweep is at work in it.
    """
    content = read_sweep(path, overrides)
    place = LocalPlace(available_cores(), jobs) if ray is None else RayPlace(ray, jobs)
    try:
        return _sweep(path, content, out, place, Output(stream))
    finally:
        place.leave()


def _sweep(path: Path, content: Sweep, out: Path, place: Place, output: Output) -> int:
    workers = sys.platform.startswith("linux")
    runs = plan_runs(path, content, place.cores_per_run if workers else 1)
    for run in runs:
        check_runnable(run.config)
        check_run(run.config, out / run.name)
    with (
        _hold(out, output) as lock,
        SweepDisplay(len(runs), output) as display,
        stop_on_signal() as stop,
    ):
        place.settle(out, lock)
        status = _Sweep(runs, content.eval, out, place, display).run(stop)
        if status == 0:
            for task in sorted({run.config.task_name for run in runs}):
                display.say(f"compare them:  vhs compare {out / task}-*")
        return status


def _hold(out: Path, output: Output) -> AbstractContextManager[int]:
    """Make the directory of a sweep, with `logs/`, and hold it as long as one of its runs lives."""
    if sys.platform == "win32":
        raise ConfigError(f"vhs sweep: expected Linux or macOS, found {sys.platform}")
    with writing(out):
        (out / "logs").mkdir(parents=True, exist_ok=True)
    return hold(
        out / LOCK_NAME,
        f"{out}: another sweep is at work here",
        by_children=True,
        patience_s=_PATIENCE_S,
        wait=lambda: output.say(f"{out}: waiting for another sweep, or for runs that it left behind to save"),
    )


@dataclass(slots=True)
class _Active:
    """A run with a job."""

    run: PlannedRun
    stage: Stage
    job: Job


class _Sweep:
    """The runs that wait, and those that have a job."""

    def __init__(
        self,
        runs: Sequence[PlannedRun],
        evaluation: EvalSection,
        out: Path,
        place: Place,
        display: SweepDisplay,
    ) -> None:
        self._waiting = deque(runs)
        self._evaluation = evaluation
        self._out = out
        self._place = place
        self._display = display
        self._active: list[_Active] = []
        self._failed = 0

    def run(self, stop: StopRequest) -> int:
        """Until nothing waits and nothing runs, or until a signal; no job is left in any case."""
        try:
            shown = time.monotonic()
            while (self._waiting or self._active) and not stop.is_set:
                self._fill()
                time.sleep(_POLL_S)
                self._reap()
                if time.monotonic() - shown > _DISPLAY_S:
                    shown = time.monotonic()
                    for active in self._active:
                        self._display.advance(active.run, self._out / active.run.name)
            if stop.is_set:
                self._stop(stop.signal_name)
                return 130
        finally:
            self._end()
        return 1 if self._failed else 0

    def _fill(self) -> None:
        """Give free cores to waiting runs; what is finished or cannot go on needs none."""
        while self._waiting and self._place.has_room:
            run = self._waiting.popleft()
            stage = self._next_stage(run)
            if stage == "finished":
                self._display.end(run, f"finished before: {self._result(run)}")
            elif stage is not None:
                self._display.begin(run, self._out / run.name)
                self._start(run, stage)

    def _start(self, run: PlannedRun, stage: Stage) -> None:
        directory = self._out / run.name
        is_trained = stage != "train"
        arguments = evaluation(directory, self._evaluation) if is_trained else run.training(directory)
        try:
            job = self._place.start(arguments, self._log_path(run))
        except OSError as error:
            self._fail(run, f"cannot start: {error.strerror}")
            return
        self._active.append(_Active(run, stage, job))

    def _reap(self) -> None:
        """Take leave of jobs that ended: on to the evaluation, on the same cores, or to another run."""
        for active in list(self._active):
            why = active.job.poll()
            if why is None:
                continue
            self._active.remove(active)
            stage = self._stage_after(active, why)
            if stage == "eval":
                self._start(active.run, stage)
            elif stage == "finished":
                self._display.end(active.run, self._result(active.run))

    def _stage_after(self, active: _Active, why: str) -> Stage | None:
        """What follows a job; None where it failed, which is then said."""
        if why:
            self._fail(active.run, why)
            return None
        stage = self._next_stage(active.run)
        if stage == active.stage:
            self._fail(active.run, f"`vhs {stage}` ended without a result")
            return None
        return stage

    def _next_stage(self, run: PlannedRun) -> Stage | None:
        try:
            return next_stage(run, self._out / run.name, self._evaluation)
        except VhsError as error:
            self._fail(run, str(error))
            return None

    def _fail(self, run: PlannedRun, why: str) -> None:
        self._failed += 1
        self._display.end(run, f"failed: {why} (see {self._log_path(run)})")

    def _stop(self, signal_name: str) -> None:
        """Ask every run to save and end, and wait for them."""
        self._display.say(f"{signal_name}: {len(self._active)} runs save and end; the same command resumes")
        for active in self._active:
            active.job.stop()
        for active in self._active:
            # A second Ctrl-C raises here, and `run` asks a second time, which ends what is left at once.
            while active.job.poll() is None:
                time.sleep(_POLL_S)
            row = newest_row(self._out / active.run.name)
            episodes = row["episodes"] if row else 0
            self._display.say(f"{active.run.name}: stopped at episode {episodes:,}")

    def _end(self) -> None:
        """Leave no job: those that an error of the sweep itself left may save, as after a signal."""
        deadline = time.monotonic() + _PATIENCE_S
        left = [active.job for active in self._active if active.job.poll() is None]
        try:
            for job in left:
                job.stop()
            while any(job.poll() is None for job in left) and time.monotonic() < deadline:
                time.sleep(_POLL_S)
        finally:
            for job in left:
                job.kill()

    def _result(self, run: PlannedRun) -> str:
        return describe_result(self._out / run.name, self._evaluation)

    def _log_path(self, run: PlannedRun) -> Path:
        return self._out / "logs" / f"{run.name}.txt"
