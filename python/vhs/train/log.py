"""What a training writes down and tells: every row to each of its loggers, and words to the person."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from vhs.console import Output
from vhs.runs.log import BoardLog, JsonLog, Logger, finite
from vhs.runs.rows import LOG_NAME
from vhs.train.display import TrainingDisplay


class TrainingLog:
    """The log of a run, TensorBoard and the terminal as one."""

    def __init__(
        self,
        run: Path,
        total_episodes: int,
        first_episode: int,
        stream: TextIO | None = None,
        *,
        logged: int | None = None,
    ) -> None:
        """Open the log for appending.

        Args:
            run: directory of the run.
            total_episodes: where the bar ends.
            first_episode: where it begins.
            stream: where a person reads along; standard output by default.
            logged: the last episode of the last whole row before the checkpoint; `first_episode` by default.
                Rows that end behind it are made again by the resumed run.

        Raises:
            CheckpointError: a line of the present log is damaged.
            OutputError: the log cannot be written.
        """
        kept = first_episode if logged is None else logged
        is_lost = kept > 0 and not (run / LOG_NAME).exists()
        with ExitStack() as opened:
            self._rows = opened.enter_context(closing(JsonLog(run, kept)))
            self._display = opened.enter_context(
                closing(TrainingDisplay(Output(stream), total_episodes, first_episode))
            )
            self._loggers: list[Logger] = [self._rows, self._display]
            if BoardLog.takes(run):
                self._loggers.append(opened.enter_context(closing(BoardLog(run, kept))))
            else:
                self.say(f"{run}: no TensorBoard events: it takes no path that is not UTF-8")
            self._opened = opened.pop_all()
        if is_lost:
            self.say(f"{run / LOG_NAME}: is gone; the log goes on behind episode {kept}")

    def advance(self, episodes: int) -> None:
        """Move the bar."""
        self._display.advance(episodes)

    def write(self, row: Mapping[str, Any]) -> None:
        """Add a row to every log; numbers that JSON cannot hold become null.

        Raises:
            OutputError: it cannot be written.
        """
        for logger in self._loggers:
            logger.write(finite(row))

    def sync(self) -> None:
        """Put the rows on the disk: a checkpoint that counts on them is about to be put there."""
        self._rows.sync()

    def say(self, text: str) -> None:
        """Tell the person something that is no row."""
        self._display.say(text)

    def __enter__(self) -> TrainingLog:
        """The log itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close everything, whatever happened."""
        self._opened.close()
