"""The log of a run as it is read: the one parser of `log.jsonl`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from vhs.errors import CheckpointError
from vhs.reading import read_bounded
from vhs.runs.seal import unsealed

LOG_NAME = "log.jsonl"
_MOST_BYTES = 2**30

Row = dict[str, Any]


def _refuse(error: CheckpointError) -> NoReturn:
    raise error


def read_log(run: Path, on_damage: Callable[[CheckpointError], None] = _refuse) -> list[Row]:
    """The rows of a log, each with rising `episodes` and its `rate/success`; none where there is no log.

    A torn last line, as a kill leaves it, is left out.

    Args:
        run: directory of the run.
        on_damage: gets what is wrong with a line, which is then left out; by default that is raised.

    Raises:
        CheckpointError: the log cannot be read, or a line is damaged; it is named.
    """
    path = run / LOG_NAME
    try:
        whole = read_bounded(path, _MOST_BYTES).split(b"\n")[:-1]
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        on_damage(CheckpointError(f"{path}: cannot be read: {why}"))
        return []
    rows: list[Row] = []
    for number, line in enumerate(whole, 1):
        try:
            rows.append(_parse(line, rows[-1]["episodes"] if rows else 0))
        except ValueError as error:
            on_damage(CheckpointError(f"{path}:{number}: damaged line: expected {error}"))
    return rows


def _parse(line: bytes, before: int) -> Row:
    """The row of a line.

    Raises:
        ValueError: what was expected, and what was found.
    """
    try:
        row = json.loads(line, parse_constant=_no_number)
    except (ValueError, RecursionError):
        row = None
    if not isinstance(row, dict) or type(row.get("episodes")) is not int:
        raise ValueError(f"a JSON object with `episodes`, found {line[:40].decode(errors='replace')!r}")
    row = unsealed(row)
    if row["episodes"] <= before:
        raise ValueError(f"more than {before} episodes, found {row['episodes']}")
    if not all(value is None or isinstance(value, int | float) for value in row.values()):
        raise ValueError("numbers and nothing else in a row, found something else")
    share = row.get("rate/success")
    if not isinstance(share, int | float) or not 0 <= share <= 1:
        raise ValueError(f"a share as `rate/success`, found {share!r}")
    return row


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"a finite number, found {text}")
