"""What an installed package brings along, found by name from anywhere."""

import tomllib
from pathlib import Path

import pytest

from vhs import __version__
from vhs.acting.policy import load_agent
from vhs.cli import main
from vhs.config import load_config
from vhs.distribution import find_agent, find_config, find_sweep

ROOT = Path(__file__).parents[1]


def test_every_configuration_of_ours_has_a_name() -> None:
    for path in (ROOT / "configs").rglob("*.yaml"):
        find = find_sweep if path.parent.name == "sweeps" else find_config
        assert find(path.stem).samefile(path)


def test_a_name_is_a_configuration_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    config = load_config(["task3", "pg"])
    assert (config.task, config.method.name) == ("task3", "pg")


def test_a_name_is_an_agent_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_agent("task1").config.task == "task1"


def test_a_file_of_ones_own_goes_before_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    own = Path("task2")
    own.write_text("seed: 7")
    assert load_config([own]).seed == 7
    assert find_agent("task2") == own


def test_a_name_that_is_nowhere_is_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_agent("task9") == Path("task9")
    assert find_config("nosuch/task2") == Path("nosuch/task2")


def test_a_shipped_agent_is_evaluated_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["eval", "task2", "--episodes", "1"]) == 0
    assert "trained_episodes" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "ours"),
    [
        (["eval", "task7"], "task1, task2, task3"),
        (["train", "--config", "task7"], "paper, task1, task2"),
        (["sweep", "qick"], "paper, quick, search"),
    ],
)
def test_a_name_of_nothing_is_answered_with_those_that_there_are(
    arguments: list[str],
    ours: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) != 0
    assert ours in capsys.readouterr().err


def test_the_version_is_the_same_wherever_it_is_said() -> None:
    manifest = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]
    crates = {crate["version"] for crate in manifest["dependencies"].values() if "path" in crate}
    assert {manifest["package"]["version"]} == crates == {__version__}
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n## {__version__} (" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
