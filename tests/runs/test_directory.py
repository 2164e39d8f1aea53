"""Whose a directory is, what made a run, and that only our own names are touched."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from vhs.config import load_config
from vhs.errors import CheckpointError
from vhs.runs import directory
from vhs.runs.directory import check_run, describe, open_run, read_meta

CONFIG = load_config()


def contents(path: Path) -> dict[str, bytes]:
    return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}


@pytest.mark.parametrize("name", ["thesis.tmp", "log.jsonl", "config.yaml", "run.json", ".gitignore"])
def test_a_directory_of_something_else_is_refused_untouched(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("seed: 0\n")
    before = contents(tmp_path)
    with pytest.raises(
        CheckpointError, match="expected a new or an empty directory, or that of a run, found"
    ):
        check_run(CONFIG, tmp_path)
    assert contents(tmp_path) == before


def test_a_file_is_no_directory_of_a_run(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("mine")
    with pytest.raises(CheckpointError, match="found a file; give another --out"):
        check_run(CONFIG, tmp_path / "run")


@pytest.mark.parametrize(
    "names", [[], [".lock"], [".lock", ".partial-12-config.yaml"], ["config.yaml", ".lock"]]
)
def test_what_a_kill_leaves_of_a_beginning_run_is_taken_up(names: list[str], tmp_path: Path) -> None:
    for name in names:
        (tmp_path / name).write_text("")
    check_run(CONFIG, tmp_path)
    with open_run(CONFIG, tmp_path, precision="float32", episodes=0):
        pass
    assert sorted(contents(tmp_path)) == [".lock", "config.yaml", "run.json"]


def test_foreign_files_beside_a_run_stay(tmp_path: Path) -> None:
    with open_run(CONFIG, tmp_path, precision="float32", episodes=0):
        pass
    for name in ("notes.tmp", ".partial-notes", "eval.tmp"):
        (tmp_path / name).write_text("mine")
    check_run(CONFIG, tmp_path)
    with open_run(CONFIG, tmp_path, precision="float32", episodes=0):
        pass
    assert all(
        (tmp_path / name).read_text() == "mine" for name in ("notes.tmp", ".partial-notes", "eval.tmp")
    )


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_the_commit_of_a_surrounding_repository_is_not_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", *identity, *arguments], cwd=tmp_path, check=True, capture_output=True)

    own, installed = tmp_path / "python" / "vhs", tmp_path / ".venv" / "site-packages" / "vhs"
    for package in (own, installed):
        package.mkdir(parents=True)
        (package / "__init__.py").write_text("")
    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "all")
    monkeypatch.setattr(directory, "PACKAGE", installed)
    assert describe()["commit"] is None
    monkeypatch.setattr(directory, "PACKAGE", own)
    assert len(describe()["commit"]) == 12


@pytest.mark.parametrize("content", ["[]", "{", '{"resumed": 3}', '{"resumed": [3]}', "[" * 100_000])
def test_a_damaged_description_is_named(content: str, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(CheckpointError, match=r"run\.json: expected"):
        read_meta(tmp_path)


def test_a_path_that_is_no_utf_8_can_be_described(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["vhs", "train", "--out", "caf\udce9"])
    assert json.loads(json.dumps(describe()))["command"] == "vhs train --out 'caf\udce9'"
