"""A line a run: bars of the running ones on a terminal, and one lasting line for each that ended."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from vhs.console import Output, make_console
from vhs.sweep.file import EvalSection
from vhs.sweep.plan import PlannedRun
from vhs.sweep.state import find_evaluation, newest_row


class SweepDisplay:
    """Tells a person how a sweep goes."""

    def __init__(self, total: int, output: Output) -> None:
        """Show `total` runs."""
        self._total = total
        self._ended = 0
        self._output = output
        self._tasks: dict[str, TaskID] = {}
        self._bars: Progress | None = None
        if output.isatty():
            self._bars = Progress(
                TextColumn("{task.fields[name]}", markup=False),
                BarColumn(bar_width=8),
                MofNCompleteColumn(),
                TextColumn("{task.description}", markup=False),
                TimeRemainingColumn(),
                console=make_console(output),
            )

    def begin(self, run: PlannedRun, directory: Path) -> None:
        """A run begins, or goes on."""
        if self._bars is not None:
            total = run.config.train.episodes
            self._tasks[run.name] = self._bars.add_task("starting", total=total, name=run.name)
            self.advance(run, directory)

    def advance(self, run: PlannedRun, directory: Path) -> None:
        """Move the bar of a running run to the newest row of its log."""
        row = newest_row(directory) if self._bars is not None else None
        if self._bars is not None and row is not None:
            success = f"success {row.get('rate/success', 0):.1%}"
            self._bars.update(self._tasks[run.name], completed=row["episodes"], description=success)

    def end(self, run: PlannedRun, text: str) -> None:
        """A run is over; its line stays."""
        self._ended += 1
        if self._bars is not None and run.name in self._tasks:
            self._bars.remove_task(self._tasks.pop(run.name))
            self._bars.refresh()
        self.say(f"[{self._ended:>{len(str(self._total))}}/{self._total}] {run.name}: {text}")

    def say(self, text: str) -> None:
        """A line; bars stay below it."""
        if self._bars is not None:
            self._bars.console.print(text, soft_wrap=True)
        else:
            self._output.say(text)

    def __enter__(self) -> SweepDisplay:
        """The display itself."""
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the terminal as it was."""
        if self._bars is not None:
            self._bars.stop()


def describe_result(directory: Path, evaluation: EvalSection) -> str:
    """``success 93.3%, SPL 0.612, 100,000 episodes, 55.1 min``."""
    found, row = find_evaluation(directory, evaluation), newest_row(directory)
    if found is None:
        return "not evaluated"
    minutes = f", {row['time/minutes']:.1f} min" if row and "time/minutes" in row else ""
    spl = "" if found["spl"] is None else f", SPL {found['spl']:.3f}"
    return f"success {found['success']:.1%}{spl}, {found['trained_episodes']:,} episodes{minutes}"
