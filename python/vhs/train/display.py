"""How a person sees a training: a bar on a terminal, a line a row elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from vhs.console import Output, make_console


class TrainingDisplay:
    """Shows rows, how far the training is, and what else there is to say; it never fails the training."""

    def __init__(self, output: Output, total_episodes: int, first_episode: int) -> None:
        """Begin at an episode of so many."""
        self._output = output
        self._bar: Progress | None = None
        if output.isatty():
            self._bar = Progress(
                BarColumn(bar_width=8),
                MofNCompleteColumn(),
                TextColumn("{task.description}", markup=False),
                TimeRemainingColumn(),
                console=make_console(output),
            )
            self._bar.start()
            self._task = self._bar.add_task("collecting", total=total_episodes, completed=first_episode)

    def advance(self, episodes: int) -> None:
        """Move the bar."""
        if self._bar is not None:
            self._bar.update(self._task, completed=episodes)

    def write(self, row: Mapping[str, Any]) -> None:
        """Show a row of the log."""
        rates = "  ".join(f"{name} {row[f'rate/{name}']:.1%}" for name in ("success", "failure", "timeout"))
        line = f"{rates}  {row['speed/steps_per_s']:.0f} steps/s"
        if self._bar is not None:
            self._bar.update(self._task, description=line)
        else:
            self.say(f"{row['time/minutes']:7.1f} min  {row['episodes']:>7} episodes  {line}")

    def say(self, text: str) -> None:
        """Tell a line; a bar stays below it."""
        if self._bar is not None:
            self._bar.console.print(text, soft_wrap=True)
        else:
            self._output.say(text)

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self._bar is not None:
            self._bar.stop()
