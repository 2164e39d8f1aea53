"""Where the rows of a run are written: `log.jsonl`, which is the run's own, and TensorBoard events.

`Logger` is what a further place for numbers has to be.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from torch.utils.tensorboard import SummaryWriter

from vhs.errors import CheckpointError
from vhs.runs.files import write_files, writing
from vhs.runs.rows import LOG_NAME, read_log
from vhs.runs.seal import sealed


class Logger(Protocol):
    """Takes the rows of a run."""

    def write(self, row: Mapping[str, Any]) -> None:
        """Take a row: finite numbers by name or None, with the `episodes` of training at its end.

        Raises:
            OutputError: it cannot be written.
        """

    def show(self, name: str, path: Path, episodes: int) -> None:
        """Take a picture (.png) or a film (.gif) that was made at an episode.

        Raises:
            OutputError: it cannot be written.
        """

    def close(self) -> None:
        """End; further calls do nothing."""


class JsonLog:
    """`log.jsonl`: one JSON object a row."""

    def __init__(self, run: Path, kept: int) -> None:
        """Open it for appending.

        Args:
            run: directory of the run.
            kept: rows that end behind this episode are made again by the run: they are dropped, so that
                the log holds each episode once.

        Raises:
            CheckpointError: a line of the present log is damaged, or rows before `kept` are missing from it.
            OutputError: the log cannot be written.
        """
        self._path = run / LOG_NAME
        written = read_log(run)
        self.seen = max((row["episodes"] for row in written), default=0)
        """The last episode of a row that was ever written: those up to it are made again."""
        rows = [row for row in written if row["episodes"] <= kept]
        found = rows[-1]["episodes"] if rows else 0
        if found < kept and self._path.exists():
            raise CheckpointError(
                f"{self._path}: expected rows up to episode {kept}, as the checkpoint has them, found them "
                f"up to {found}: bring them back, or move the file away to go on with a log that begins here"
            )
        write_files(run, {LOG_NAME: "".join(json.dumps(sealed(row)) + "\n" for row in rows)})
        with writing(self._path):
            self._file = self._path.open("a", encoding="utf-8")

    def write(self, row: Mapping[str, Any]) -> None:
        """Append a row, at once."""
        with writing(self._path):
            self._file.write(json.dumps(sealed(row)) + "\n")
            self._file.flush()

    def sync(self) -> None:
        """Put the rows on the disk: a checkpoint that counts on them is about to be put there.

        Raises:
            OutputError: they cannot be put there.
        """
        with writing(self._path):
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        with writing(self._path):
            self._file.close()


class BoardLog:
    """TensorBoard events in `tensorboard/`: a scalar a number, over episodes."""

    def __init__(self, run: Path, kept: int) -> None:
        """Open them; what was written behind episode `kept` is shown no longer.

        Raises:
            OutputError: they cannot be written.
        """
        self._path = run / "tensorboard"
        with writing(self._path):
            self._board = SummaryWriter(str(self._path), purge_step=kept + 1 if kept else None)

    @staticmethod
    def takes(run: Path) -> bool:
        """Whether TensorBoard can write there at all."""
        try:
            str(run).encode()
        except UnicodeEncodeError:
            return False
        return True

    def write(self, row: Mapping[str, Any]) -> None:
        """Add the numbers of a row."""
        with writing(self._path):
            for key, value in row.items():
                if isinstance(value, int | float) and key != "episodes":
                    self._board.add_scalar(key, value, row["episodes"])

    def show(self, name: str, path: Path, episodes: int) -> None:
        """Add a picture or a film."""
        from tensorboard.compat.proto.summary_pb2 import Summary

        with writing(self._path):
            picture = Summary.Image(encoded_image_string=path.read_bytes(), colorspace=3)
            summary = Summary(value=[Summary.Value(tag=name, image=picture)])
            writer: Any = self._board.file_writer
            writer.add_summary(summary, episodes)

    def close(self) -> None:
        """Write out what waits."""
        with writing(self._path):
            self._board.close()


def finite(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row in which numbers that JSON cannot hold are None."""
    return {key: None if isinstance(v, float) and not math.isfinite(v) else v for key, v in row.items()}
