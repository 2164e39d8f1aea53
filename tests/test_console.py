"""Nothing that happens to an output fails whoever speaks, and texts are shown as they are."""

import errno
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from vhs.cli import main
from vhs.console import Output, make_console

CONFIGS = Path(__file__).parents[1] / "configs"
TRAIN = ["train", "--config", str(CONFIGS / "debug.yaml"), "--set", "train.episodes=4", "--set"]
TRAIN += ["env.num_workers=0", "--out"]
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/dev/full is one of Linux")


class Gone(io.StringIO):
    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number

    def write(self, text: str) -> int:
        raise OSError(self.number, os.strerror(self.number))


@pytest.mark.parametrize(
    ("number", "is_unread"),
    [(errno.ENOSPC, False), (errno.EIO, True), (errno.EPIPE, True), (errno.EDQUOT, False)],
)
def test_an_output_that_fails_is_remembered(number: int, is_unread: bool) -> None:
    output = Output(Gone(number))
    output.say("a row")
    assert output.failure is not None
    assert output.failure.errno == number
    assert output.is_unread == is_unread


def test_no_output_and_a_closed_one_are_unread(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = io.StringIO()
    closed.close()
    monkeypatch.setattr(sys, "stdout", None)
    for output in (Output(), Output(closed)):
        output.say("a row")
        assert output.is_unread
        assert not output.isatty()


def test_what_the_encoding_lacks_is_replaced() -> None:
    for encoding, shown in (("ascii", b"caf? 1 ? 2\n"), ("utf-8", "caf? 1 ± 2\n".encode())):
        stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="\n")
        Output(stream).say("caf\udce9 1 ± 2")
        assert stream.buffer.getvalue() == shown  # type: ignore[attr-defined]


def test_a_console_shows_brackets_and_colons_as_they_are() -> None:
    stream = io.StringIO()
    make_console(Output(stream)).print("runs/[/x] [bold]a[/] :smile:", soft_wrap=True)
    assert stream.getvalue() == "runs/[/x] [bold]a[/] :smile:\n"


def command(*arguments: str | bytes, **how: object) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(  # type: ignore[call-overload, no-any-return]
        [sys.executable, "-m", "vhs.cli", *arguments], stderr=subprocess.PIPE, timeout=120, **how
    )


@pytest.mark.slow
@linux
def test_a_full_output_ends_no_training_and_a_lost_result_is_said(tmp_path: Path) -> None:
    run = str(tmp_path / "run")
    with open("/dev/full", "w") as full:
        done = command(*TRAIN, run, stdout=full)
        assert (done.returncode, done.stderr) == (0, b"")
        done = command("eval", run, "--episodes", "2", stdout=full)
    assert done.returncode == 1
    assert done.stderr == b"vhs: standard output: cannot write: No space left on device\n"
    assert len(json.loads((tmp_path / "run" / "eval.json").read_text())) == 1, "recorded before it was told"


@pytest.mark.slow
@linux
def test_a_terminal_that_is_closed_ends_no_training(tmp_path: Path) -> None:
    import pty

    ours, theirs = pty.openpty()
    with open(theirs, "wb", closefd=True) as terminal:
        arguments = [sys.executable, "-m", "vhs.cli", *TRAIN, str(tmp_path / "run")]
        process = subprocess.Popen(arguments, stdout=terminal, stderr=subprocess.PIPE)
    assert os.read(ours, 1), "a bar"
    os.close(ours)
    _, told = process.communicate(timeout=120)
    assert (process.returncode, told) == (0, b"")
    assert (tmp_path / "run" / "checkpoints" / "episode-000000004").is_dir()


@pytest.mark.slow
@linux
def test_a_run_may_be_called_anything(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = os.path.join(os.fsencode(tmp_path), b"caf\xe9 [/x] [bold] :smile:")
    environment = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii:strict"}
    done = command(*TRAIN, run, stdout=subprocess.PIPE, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"caf? [/x] [bold] :smile: (4 episodes)" in done.stdout
    path = os.fsdecode(run)
    for arguments in (
        ["eval", path, "--episodes", "1"],
        ["export", path, f"{path} agent"],
        ["report", path, "--episodes", "1", "--out", f"{path}.html"],
        ["play", path, "--episodes", "1", "--out", f"{path}.gif"],
        ["eval", f"{path} none"],
    ):
        assert main(arguments) == int(arguments[-1] == f"{path} none")
    assert "caf? [/x] [bold] :smile: none: expected the directory of a run" in capsys.readouterr().err
    assert os.path.exists(run + b".html")
