"""What a run writes down: a JSON line and TensorBoard scalars a window, and a line or bar for the person."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from torch.utils.tensorboard import SummaryWriter

from vhs import Outcome
from vhs.acting.episodes import EndedEpisode
from vhs.errors import CheckpointError
from vhs.runs.checkpoint import writing

LOG_NAME = "log.jsonl"


class EpisodeResult(NamedTuple):
    """What a row sums up of an episode."""

    outcome: Outcome
    steps: int
    episode_return: float


class Window:
    """Sums over the episodes and updates since the last whole row."""

    def __init__(self) -> None:
        """Start empty."""
        self.episodes: list[EpisodeResult] = []
        self._sums: dict[str, float] = {}
        self._counts: dict[str, int] = {}

    def state_dict(self) -> dict[str, Any]:
        """Everything, as plain values."""
        episodes = [(int(e.outcome), e.steps, e.episode_return) for e in self.episodes]
        return {"episodes": episodes, "sums": dict(self._sums), "counts": dict(self._counts)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Return to a state that `state_dict` gave."""
        self.episodes = [EpisodeResult(Outcome(outcome), *rest) for outcome, *rest in state["episodes"]]
        self._sums, self._counts = dict(state["sums"]), dict(state["counts"])

    def add_episodes(self, episodes: Iterable[EndedEpisode]) -> None:
        """Take episodes that have been learned from."""
        self.episodes += [EpisodeResult(e.outcome, e.steps, e.episode_return) for e in episodes]

    def add_update(self, metrics: Mapping[str, float]) -> None:
        """Take the losses of one update; a term is averaged over the updates that had it."""
        for name, value in metrics.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
            self._counts[name] = self._counts.get(name, 0) + 1

    def rates(self) -> dict[str, float]:
        """Shares of the three outcomes, mean steps and mean undiscounted return."""
        return summarise(self.episodes)

    def losses(self) -> dict[str, float]:
        """Mean of every loss term."""
        return {name: total / self._counts[name] for name, total in self._sums.items()}


def summarise(episodes: Sequence[EndedEpisode | EpisodeResult]) -> dict[str, float]:
    """Success, failure and timeout rate, mean steps and mean undiscounted return of some episodes."""
    count = len(episodes)
    row = {outcome.name.lower(): sum(e.outcome == outcome for e in episodes) / count for outcome in Outcome}
    row["steps"] = sum(e.steps for e in episodes) / count
    row["return"] = sum(e.episode_return for e in episodes) / count
    return row


class RunLog:
    """The log of a run: `log.jsonl`, TensorBoard events and the terminal."""

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
                Rows that end behind it are made again by the resumed run: they are dropped, so that the log
                holds each episode once.

        Raises:
            CheckpointError: a line of the present log is damaged.
            OutputError: the log cannot be written.
        """
        kept = first_episode if logged is None else logged
        self._run = run
        path = run / LOG_NAME
        with writing(run):
            _keep_rows_up_to(path, kept)
            self._file = path.open("a", encoding="utf-8")
            self._board = SummaryWriter(str(run / "tensorboard"), purge_step=kept + 1 if kept else None)
        self._console = Console(file=stream or sys.stdout)
        self._is_unread = False
        self._progress: Progress | None = None
        self._bar: TaskID | None = None
        if self._console.is_terminal:
            self._progress = Progress(
                BarColumn(bar_width=8),
                MofNCompleteColumn(),
                TextColumn("{task.description}"),
                TimeRemainingColumn(),
                console=self._console,
            )
            self._progress.start()
            self._bar = self._progress.add_task("collecting", total=total_episodes, completed=first_episode)

    def advance(self, episodes: int) -> None:
        """Move the bar."""
        if self._progress is not None and self._bar is not None:
            self._progress.update(self._bar, completed=episodes)

    def write(self, row: Mapping[str, Any]) -> None:
        """Add a row to every log; numbers that JSON cannot hold become null.

        Raises:
            OutputError: it cannot be written.
        """
        clean = {key: None if isinstance(v, float) and not math.isfinite(v) else v for key, v in row.items()}
        with writing(self._run):
            self._file.write(json.dumps(clean) + "\n")
            self._file.flush()
            for key, value in clean.items():
                if isinstance(value, int | float) and key != "episodes":
                    self._board.add_scalar(key, value, row["episodes"])
        self._show(row)

    def sync(self) -> None:
        """Put the rows on the disk: a checkpoint that counts on them is about to be put there."""
        with writing(self._run):
            os.fsync(self._file.fileno())

    def say(self, text: str) -> None:
        """Tell the person something that is no row; nobody reading (``vhs train | head``) is no error."""
        if self._console.is_terminal:
            self._console.print(text, highlight=False)
        elif not self._is_unread:
            # A pipe has no width to wrap at, and its reader wants the line now.
            try:
                print(text, file=self._console.file, flush=True)
            except BrokenPipeError:
                self._is_unread = True

    def _show(self, row: Mapping[str, Any]) -> None:
        rates = "  ".join(f"{name} {row[f'rate/{name}']:.1%}" for name in ("success", "failure", "timeout"))
        line = f"{rates}  {row['speed/steps_per_s']:.0f} steps/s"
        if self._progress is not None and self._bar is not None:
            self._progress.update(self._bar, description=line)
        else:
            self.say(f"{row['time/minutes']:7.1f} min  {row['episodes']:>7} episodes  {line}")

    def __enter__(self) -> RunLog:
        """The log itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close everything, whatever happened."""
        if self._progress is not None:
            self._progress.stop()
        with writing(self._run):
            try:
                self._file.close()
            finally:
                self._board.close()


def read_log(run: Path) -> list[dict[str, Any]]:
    """The rows of a run's log; a torn last line, as a kill leaves it, is left out.

    Raises:
        CheckpointError: another line is damaged; it is named.
    """
    path = run / LOG_NAME
    if not path.exists():
        return []
    whole = path.read_bytes().split(b"\n")[:-1]
    return [_parse(line, f"{path}:{number}") for number, line in enumerate(whole, 1)]


def _parse(line: bytes, where: str) -> dict[str, Any]:
    try:
        row = json.loads(line)
    except ValueError:
        row = None
    if not isinstance(row, dict) or not isinstance(row.get("episodes"), int):
        found = line[:40].decode(errors="replace")
        raise CheckpointError(
            f"{where}: damaged line: expected a JSON object with `episodes`, found {found!r}"
        )
    return row


def _keep_rows_up_to(path: Path, episode: int) -> None:
    rows = [row for row in read_log(path.parent) if row["episodes"] <= episode]
    text = "".join(json.dumps(row) + "\n" for row in rows)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)
