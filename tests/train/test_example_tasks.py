"""The tasks in `examples/tasks` keep to the rules that they are shown by, and train."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from debug import DEBUG

from vhs.cli import _parser
from vhs.config import load_config
from vhs.envs.opengl import has_library
from vhs.runs.rows import read_log

ROOT = Path(__file__).parents[2]
TASKS = sorted((ROOT / "examples" / "tasks").glob("*.py"))
NEEDED = {
    "babyai": "minigrid",
    "crafter_fetch": "crafter",
    "miniworld_sign": "miniworld",
    "pointmaze": "gymnasium_robotics",
    "vizdoom_fetch": "vizdoom",
}
"""What an example needs beside what trains."""


def command(path: Path) -> list[str]:
    """The command in the docstring of an example, without `vhs`."""
    found = re.search(r"^vhs (train .*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None, path
    return found[1].split()


@pytest.mark.parametrize("path", TASKS, ids=lambda path: path.stem)
def test_an_example_is_short_and_says_its_command(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 40
    monkeypatch.chdir(ROOT)
    options = _parser().parse_args(command(path))
    config = load_config(options.config, options.set, task=options.task)
    assert config.task == str(path)


def run(*arguments: str) -> None:
    """A command in its own process: one that forks with OpenGL in it, as earlier tests leave it, can hang."""
    subprocess.run([sys.executable, "-m", "vhs", *arguments], check=True, timeout=100)


@pytest.mark.slow
@pytest.mark.parametrize("path", TASKS, ids=lambda path: path.stem)
def test_an_example_trains(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By its own configuration, with networks and numbers of the debug configuration over them."""
    if (needed := NEEDED.get(path.stem)) and find_spec(needed) is None:
        pytest.skip(f"needs {needed}")
    if needed == "miniworld" and not has_library("libEGL.so.1"):
        pytest.skip("needs libegl1")
    monkeypatch.chdir(ROOT)
    few = ["train.episodes=16", "train.log_every=8", "env.num_envs=4"]
    few += ["method.supcon_batch=null", "train.schedule_episodes=8"]
    arguments = [*command(path)[:-2], "--config", str(DEBUG), "--out", str(tmp_path / "run")]
    run(*arguments, *(part for one in few for part in ("--set", one)))
    assert [row["episodes"] for row in read_log(tmp_path / "run")] == [8, 16]
    run("eval", str(tmp_path / "run"), "--episodes", "2")
    run("play", str(tmp_path / "run"), "--episodes", "1", "--out", str(tmp_path / "film.gif"))
    assert os.path.getsize(tmp_path / "film.gif") > 1000
