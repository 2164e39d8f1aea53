"""What a training writes down and tells: rows, pictures and films to its loggers, and words to the person."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from vhs.config import Config
from vhs.console import Output
from vhs.errors import OutputError
from vhs.runs.log import BoardLog, JsonLog, Logger, finite
from vhs.runs.loggers import open_loggers
from vhs.runs.rows import LOG_NAME
from vhs.train.display import TrainingDisplay


class Log:
    """What a session tells of its training; this one, of a rank for which another speaks, tells nobody."""

    def advance(self, episodes: int) -> None:
        """Say how far the training is."""

    def write(self, row: Mapping[str, Any]) -> None:
        """Add a row."""

    def show(self, name: str, path: Path, episodes: int) -> None:
        """Hand a picture or a film on."""

    def sync(self) -> None:
        """Put the rows on the disk."""

    def say(self, text: str) -> None:
        """Tell something that is no row."""


class TrainingLog(Log):
    """The log of a run, its further loggers and the terminal as one.

    A further logger that fails is told of once and left out: the run goes on.
    """

    def __init__(
        self,
        run: Path,
        total_episodes: int,
        first_episode: int,
        stream: TextIO | None = None,
        *,
        logged: int | None = None,
        config: Config | None = None,
    ) -> None:
        """Open the log for appending.

        Args:
            run: directory of the run.
            total_episodes: where the bar ends.
            first_episode: where it begins.
            stream: where a person reads along; standard output by default.
            logged: the last episode of the last whole row before the checkpoint; `first_episode` by default.
                Rows that end behind it are made again by the resumed run.
            config: names the further loggers; TensorBoard alone by default.

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
            self._loggers = open_loggers(config or Config(), run, kept)
            self._opened = opened.pop_all()
        if not BoardLog.takes(run):
            self.say(f"{run}: no TensorBoard events: it takes no path that is not UTF-8")
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
        row = finite(row)
        self._rows.write(row)
        self._display.write(row)
        self._to_each(lambda logger: logger.write(row), row["episodes"])

    def show(self, name: str, path: Path, episodes: int) -> None:
        """Hand a picture or a film to every logger; they keep what they take of it."""
        self._to_each(lambda logger: logger.show(name, path, episodes), episodes)

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
        with self._opened:
            self._to_each(lambda logger: logger.close())

    def _to_each(self, do: Callable[[Logger], None], episodes: int | None = None) -> None:
        """Do something with every further logger; what an earlier start did up to an episode stays done."""
        for logger in tuple(self._loggers):
            is_board = isinstance(logger, BoardLog)  # which drops what was written behind the checkpoint
            if episodes is not None and episodes <= self._rows.seen and not is_board:
                continue
            try:
                do(logger)
            except OutputError:
                raise
            except Exception as error:  # whatever somebody else's library raises
                self._loggers.remove(logger)
                self.say(f"{type(logger).__name__}: {error}; the run goes on without it")
