"""The tools that look closer at agents than `vhs eval` does; `docs/results` has what they found."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]


def look(tool: str, tmp_path: Path, *arguments: str) -> Any:
    """What a tool writes about the shipped agent of Task 2."""
    command = [sys.executable, ROOT / "docs" / "results" / tool, ROOT / "pretrained" / "task2"]
    subprocess.run([*command, *arguments, "--out", tmp_path / "found.json"], check=True, cwd=tmp_path)
    return json.loads((tmp_path / "found.json").read_text())


@pytest.mark.slow
def test_overlooked_counts_every_episode_once(tmp_path: Path) -> None:
    found = look("overlooked.py", tmp_path, "--episodes", "3")
    assert sum(row["episodes"] for row in found["table"]) == 3
    assert all(row["episodes"] == row["success"] + row["failure"] + row["timeout"] for row in found["table"])


@pytest.mark.slow
def test_sight_asks_for_views_of_every_size(tmp_path: Path) -> None:
    (agent,) = look("sight.py", tmp_path, "--rooms", "12")["agents"].values()
    rows = agent["recall"]["classifier"]
    assert sum(row["objects"] for row in rows) > 0
    assert all(row["recall"] is None or 0 <= row["recall"] <= 1 for row in rows)
