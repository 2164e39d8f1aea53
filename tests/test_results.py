"""The tools that look closer at agents than `vhs eval` does; `docs/results` has what they found."""

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vhs.acting.policy import load_agent

ROOT = Path(__file__).parents[1]


def look(tool: str, tmp_path: Path, *arguments: str) -> Any:
    """What a tool writes about the shipped agent of Task 2."""
    command = [sys.executable, ROOT / "docs" / "results" / tool, ROOT / "pretrained" / "task2"]
    subprocess.run([*command, *arguments, "--out", tmp_path / "found.json"], check=True, cwd=tmp_path)
    return json.loads((tmp_path / "found.json").read_text())


@pytest.mark.slow
def test_overlooked_counts_every_episode_once(tmp_path: Path) -> None:
    picture = tmp_path / "missed.png"
    found = look("overlooked.py", tmp_path, "--episodes", "75", "--seed", "5", "--picture", str(picture))
    agent = found["agents"]["task2"]
    for rows in (agent["pixels"], agent["aside"]):
        assert sum(row["episodes"] for row in rows) == 75
        assert all(row["episodes"] == row["success"] + row["failure"] + row["timeout"] for row in rows)
    assert [one["seed"] for one in found["missed"]] == sorted(one["seed"] for one in agent["timeouts"])
    assert all(one["agents"] == ["task2"] for one in found["missed"])
    assert picture.exists() == bool(found["missed"])


@pytest.mark.slow
def test_ways_are_divided_at_the_first_view_of_the_goal(tmp_path: Path) -> None:
    (agent,) = look("ways.py", tmp_path, "--episodes", "40")["agents"].values()
    assert agent["episodes"] == 40
    assert 30 <= agent["successes"] <= 40
    assert agent["search"] + agent["after"] >= agent["shortest"] > agent["plan"] > 0
    assert agent["spl_of_successes"] <= agent["spl_with_plans_after"] <= 1
    assert all(row["walked_on"] <= row["views"] for row in agent["ahead"])


@pytest.mark.slow
def test_sight_asks_for_views_of_every_size(tmp_path: Path) -> None:
    (agent,) = look("sight.py", tmp_path, "--rooms", "12")["agents"].values()
    rows = agent["recall"]["classifier"]
    assert sum(row["objects"] for row in rows) > 0
    assert all(row["recall"] is None or 0 <= row["recall"] <= 1 for row in rows)


@pytest.mark.slow
def test_new_objects_shows_what_it_asks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """The shipped agent knows milk: pictures of it name it as well as its prototype does."""
    monkeypatch.syspath_prepend(ROOT / "docs" / "results")
    tool = import_module("new_objects")
    pictures = tool.pictures_of("milk", 2, tool.ROOMS_OF_PICTURES)
    assert (pictures.shape, pictures.dtype) == ((2, 84, 84, 3), np.uint8)
    agent = load_agent("task2")
    agent.show("milk", pictures)
    rates = tool.asked(agent, tool.asking_for("milk"), 4)
    assert rates["success"] >= 0.5
    assert rates["reached"]["milk"] == 4 * rates["success"]
    assert sum(rates["reached"].values()) == 4 * (1 - rates["timeout"])


def test_tables_hold_the_newest_sampled_evaluations_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs")
    tables = import_module("results.tables")
    entry = {"seed": 0, "greedy": False, "trained_episodes": 30_000, "success": 0.9, "spl": 0.8}
    others = [{"greedy": True}, {"seed": 9}, {"trained_episodes": 500}]
    run = {
        "columns": ["episodes", "success"],
        "curve": [[500 * (row + 1), 0.5] for row in range(10)],
        "evaluations": [entry, *({**entry, "success": 0.1, "spl": 0.1} | other for other in others)],
    }
    text = tables._on_the_way({"it-seed0": run}, {"it": "it"}, (1_000,), (0, 1, 2), "in the end")
    assert "| 90.0 %, SPL 0.80 |" in text
