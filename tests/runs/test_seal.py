"""Of a run's JSON files no changed bit is read as another value."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from vhs.errors import CheckpointError
from vhs.runs.directory import describe, read_meta
from vhs.runs.evaluations import read_evaluations, record_evaluation
from vhs.runs.log import JsonLog
from vhs.runs.rows import read_log
from vhs.runs.seal import KEY, sealed

EVALUATION = {
    "trained_episodes": 30, "seed": 1, "greedy": False, "episodes": 300,
    "success": 0.75, "failure": 0.2, "timeout": 0.05, "spl": 0.5,
}  # fmt: skip


def write_log(run: Path) -> None:
    log = JsonLog(run, 0)
    log.write({"episodes": 10, "rate/success": 0.25, "loss/actor": -1.5e-7})
    log.write({"episodes": 20, "rate/success": 0.5, "loss/actor": None})
    log.close()


def write_meta(run: Path) -> None:
    (run / "run.json").write_text(json.dumps(sealed(describe() | {"resumed": [{"episodes": 3}]}), indent=2))


@pytest.mark.parametrize(
    ("name", "write", "read"),
    [
        ("log.jsonl", write_log, read_log),
        ("run.json", write_meta, read_meta),
        ("eval.json", lambda run: record_evaluation(run, EVALUATION), read_evaluations),
    ],
)
def test_a_flipped_bit_is_refused_or_changes_nothing(
    name: str, write: Callable[[Path], None], read: Callable[[Path], Any], tmp_path: Path
) -> None:
    write(tmp_path)
    path, whole = tmp_path / name, read(tmp_path)
    content = path.read_bytes()
    refused = 0
    # The last line end is what tells a whole row from a torn one.
    for bit in range(8 * (len(content.rstrip()))):
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        try:
            found = read(tmp_path)
        except CheckpointError:
            refused += 1
            continue
        pairs = zip(found, whole, strict=True) if isinstance(whole, list) else [(found, whole)]
        for now, before in pairs:
            # Where the bit is in the name of the digest itself, it is one more key.
            assert {key: now[key] for key in before} == before
            assert len(now) <= len(before) + 1
    assert refused > 6 * len(content)


def test_what_has_no_digest_is_taken(tmp_path: Path) -> None:
    write_log(tmp_path)
    rows = read_log(tmp_path)
    assert KEY not in rows[0]
    (tmp_path / "log.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert read_log(tmp_path) == rows
