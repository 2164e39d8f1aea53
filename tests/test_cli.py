"""What the command says where nothing is run."""

import subprocess
import sys
from pathlib import Path

import pytest

from vhs import __version__
from vhs.cli import main


def test_the_version_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["--version"])
    assert __version__ in capsys.readouterr().out


def test_a_missing_package_names_the_extra_that_brings_it(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['torch'] = None; from vhs.cli import main; "
        "sys.exit(main(['eval', sys.argv[1]]))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False, timeout=60
    )
    assert result.returncode == 1
    assert "torch is not installed; pip install 'vhs-rl[train]'" in result.stderr


def test_ctrl_c_is_no_traceback(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("vhs.eval.evaluate", interrupted)
    assert main(["eval", "pretrained/task2", "--episodes", "1"]) == 130
    assert capsys.readouterr().err == "vhs: stopped\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["eval", "run", "--episodes", "0"], "--episodes"),
        (
            ["eval", "run", "--episodes", "2.5"],
            "--episodes: expected a whole number of at least 1, found 2.5",
        ),
        (["play", "run", "--seed", "-1"], "--seed"),
        (["play", "run", "--seed", "x"], "--seed: expected a whole number of at least 0, found x"),
        (["compare", "run", "--rate", "most"], "--rate: expected a share above 0 and up to 1, found most"),
        (["compare", "run", "--rate", "74.3"], "--rate"),
        (["sweep"], "FILE"),
    ],
)
def test_arguments_out_of_range_are_refused(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert message in capsys.readouterr().err
