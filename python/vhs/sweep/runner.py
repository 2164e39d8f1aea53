"""Runs a sweep: every run as a job of its own on cores of its own, `vhs train` and then `vhs eval`.

Nothing about progress is kept but the runs themselves: a sweep that starts again looks at each and does what
is left.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from vhs.console import Output
from vhs.errors import CheckpointError, ConfigError, VhsError
from vhs.interrupt import StopRequest, stop_on_signal
from vhs.runs.directory import LOCK_NAME
from vhs.runs.files import writing
from vhs.runs.lock import hold
from vhs.sweep.cluster import RayPlace
from vhs.sweep.display import SweepDisplay, describe_result
from vhs.sweep.file import EvalSection, Sweep, read_sweep
from vhs.sweep.local import LocalPlace, available_cores
from vhs.sweep.place import Job, Place
from vhs.sweep.plan import PlannedRun, evaluation
from vhs.sweep.runs import Grids, Runs
from vhs.sweep.search import Search
from vhs.sweep.state import Stage, find_evaluation, newest_row, next_stage

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
    cores = place.cores_per_run if sys.platform.startswith("linux") else 1
    runs: Runs
    if content.search is None:
        runs = Grids(path, content, out, cores)
    else:
        runs = Search(path, content, content.search, out, cores)
    with (
        _hold(out, output) as lock,
        SweepDisplay(runs.total, output) as display,
        stop_on_signal() as stop,
    ):
        place.settle(out, lock)
        runs.begin()
        status = _Sweep(runs, content.eval, out, place, display).run(stop)
        for line in runs.conclude() if status == 0 else ():
            display.say(line)
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
    is_hopeless: bool = False
    """Whether it was told to end early."""


class _Sweep:
    """The runs that wait, and those that have a job."""

    def __init__(
        self,
        runs: Runs,
        evaluation: EvalSection,
        out: Path,
        place: Place,
        display: SweepDisplay,
    ) -> None:
        self._runs = runs
        self._is_exhausted = False
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
            while not stop.is_set:
                self._fill()
                if self._is_exhausted and not self._active:
                    break
                time.sleep(_POLL_S)
                self._reap()
                if time.monotonic() - shown > _DISPLAY_S:
                    shown = time.monotonic()
                    self._look()
            if stop.is_set:
                self._stop(stop.signal_name)
                return 130
        finally:
            self._end()
        return 1 if self._failed else 0

    def _look(self) -> None:
        """Show how far the runs are, and end those that are not worth their end."""
        for active in self._active:
            self._display.advance(active.run, self._out / active.run.name)
            if not active.is_hopeless and self._is_hopeless(active):
                active.is_hopeless = True
                active.job.stop()

    def _is_hopeless(self, active: _Active) -> bool:
        return active.stage == "train" and self._runs.is_hopeless(active.run)

    def _fill(self) -> None:
        """Give free cores to waiting runs; what is finished or cannot go on needs none."""
        self._is_exhausted = False
        while self._place.has_room and not self._is_exhausted:
            try:
                run = self._runs.next()
            except (ConfigError, CheckpointError) as error:
                self._failed += 1
                self._display.say(f"failed: {error}")
                continue
            if run is None:
                self._is_exhausted = True
                continue
            stage = self._next_stage(run)
            if stage == "finished":
                self._finish(run, "finished before: ")
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
            if self._is_hopeless(active):
                self._runs.abandon(active.run)
                self._display.end(active.run, f"ended early, at {self._progress(active.run)}")
                continue
            stage = self._stage_after(active, why)
            if stage == "eval":
                self._start(active.run, stage)
            elif stage == "finished":
                self._finish(active.run)

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

    def _finish(self, run: PlannedRun, when: str = "") -> None:
        directory = self._out / run.name
        try:
            self._runs.finish(run, find_evaluation(directory, self._evaluation) or {})
        except (ConfigError, CheckpointError) as error:
            self._fail(run, str(error))
        else:
            self._display.end(run, f"{when}{describe_result(directory, self._evaluation)}")

    def _fail(self, run: PlannedRun, why: str) -> None:
        self._failed += 1
        self._display.end(run, f"failed: {why} (see {self._log_path(run)})")

    def _stop(self, signal_name: str) -> None:
        """Ask every run to save and end, and wait for them."""
        self._display.say(f"{signal_name}: {len(self._active)} runs save and end; the same command resumes")
        for active in self._active:
            if not active.is_hopeless:  # which was told before
                active.job.stop()
        for active in self._active:
            # A second Ctrl-C raises here, and `run` asks a second time, which ends what is left at once.
            while active.job.poll() is None:
                time.sleep(_POLL_S)
            self._display.say(f"{active.run.name}: stopped at {self._progress(active.run)}")

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

    def _progress(self, run: PlannedRun) -> str:
        row = newest_row(self._out / run.name)
        return f"episode {row['episodes'] if row else 0:,}"

    def _log_path(self, run: PlannedRun) -> Path:
        return self._out / "logs" / f"{run.name}.txt"
