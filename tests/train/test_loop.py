"""The whole loop on the debug configuration: it runs, logs, stops, resumes, and refuses what cannot run."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from io import StringIO
from pathlib import Path

import pytest
import torch
from debug import CONFIGS, debug_config
from torch import Tensor

from vhs.cli import main
from vhs.errors import CheckpointError
from vhs.eval import read_evaluations
from vhs.learning.terms import TERMS, Forward, Term
from vhs.runs.checkpoint import load_checkpoint
from vhs.runs.rows import read_log
from vhs.runs.seal import sealed, unsealed
from vhs.train import train

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("task", ["task1", "task2", "task3"])
def test_every_task_trains_and_logs(task: str, tmp_path: Path) -> None:
    told = StringIO()
    assert train(debug_config(f"task={task}", "train.episodes=80"), tmp_path / "run", told)
    rows = read_log(tmp_path / "run")
    assert [row["episodes"] for row in rows] == [40, 80]
    for row in rows:
        rates = [row[f"rate/{name}"] for name in ("success", "failure", "timeout")]
        assert sum(rates) == pytest.approx(1.0)
        assert row["env_steps"] <= 2 * 20 * row["episodes"]
        assert row["updates"] == row["episodes"] / 4
        assert 0 < row["loss/entropy"] < 2
    assert "80 episodes" in told.getvalue()
    assert f"vhs eval {tmp_path / 'run'}" in told.getvalue()
    assert list((tmp_path / "run" / "tensorboard").iterdir())
    meta = json.loads((tmp_path / "run" / "run.json").read_text())
    assert meta["version"]
    assert meta["precision"] in ("float32", "bfloat16")


@pytest.mark.parametrize(
    ("overrides", "is_said"),
    [
        (["train.schedule_episodes=2"], True),
        (["train.schedule_episodes=4"], False),
        (
            ["train.schedule_episodes=2", "train.learning_rate_end=null", "train.entropy_weight_end=null"],
            False,
        ),
    ],
)
def test_a_schedule_that_ends_before_the_run_is_said(
    tmp_path: Path, overrides: list[str], is_said: bool
) -> None:
    told = StringIO()
    train(debug_config("train.episodes=4", *overrides), tmp_path / "run", told)
    assert ("train.schedule_episodes = 2 of train.episodes = 4" in told.getvalue()) == is_said


def test_same_seed_same_weights(tmp_path: Path) -> None:
    weights = []
    for name in "ab":
        train(debug_config("train.episodes=40"), tmp_path / name, StringIO())
        weights.append(load_checkpoint(tmp_path / name)[0]["learner"]["agent"])
    for name, value in weights[0].items():
        assert torch.equal(value, weights[1][name]), name


def test_a_finished_run_goes_on_when_more_episodes_are_asked_for(tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(debug_config("train.episodes=40"), run, StringIO())
    told = StringIO()
    train(debug_config("train.episodes=80"), run, told)
    assert "resuming" in told.getvalue()
    rows = read_log(run)
    assert [row["episodes"] for row in rows] == [40, 80]
    assert rows[1]["time/minutes"] > rows[0]["time/minutes"]
    assert rows[1]["updates"] == 20


def test_what_made_a_run_is_kept_and_each_resumption_added(tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(debug_config("train.episodes=4"), run, StringIO())
    first = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps(sealed(first | {"commit": "of the first start"})))
    for episodes in (8, 12):
        train(debug_config(f"train.episodes={episodes}"), run, StringIO())
    meta = json.loads((run / "run.json").read_text())
    assert meta["commit"] == "of the first start"
    assert [start["episodes"] for start in meta["resumed"]] == [4, 8]
    assert meta["resumed"][0].keys() == unsealed(first).keys() | {"episodes"}
    (run / "run.json").write_text("{")
    train(debug_config("train.episodes=16"), run, StringIO())
    assert [start["episodes"] for start in json.loads((run / "run.json").read_text())["resumed"]] == [12]


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of four episodes, to be copied."""
    run = tmp_path_factory.mktemp("short") / "run"
    train(debug_config("train.episodes=4", "env.num_workers=0"), run, StringIO())
    return run


def test_another_configuration_is_refused_by_key(short: Path, tmp_path: Path) -> None:
    run = shutil.copytree(short, tmp_path / "run")
    before = (run / "config.yaml").read_bytes()
    with pytest.raises(CheckpointError, match=r"other values of train\.gamma"):
        train(debug_config("train.gamma=0.5"), run, StringIO())
    assert (run / "config.yaml").read_bytes() == before


def test_a_run_that_diverges_says_so_and_keeps_its_checkpoint(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = shutil.copytree(short, tmp_path / "run")
    options = ["--config", str(CONFIGS / "debug.yaml"), "--set", "env.num_workers=0"]
    kept = {path: path.read_bytes() for path in (run / "checkpoints").rglob("*") if path.is_file()}

    def steep(x: Forward) -> Tensor:
        """0, with an infinite gradient."""
        bias = x.agent.policy[0].bias[0]
        return (bias - bias.detach()).sqrt()

    monkeypatch.setitem(TERMS, "value", Term(steep, "lived"))
    assert main(["train", *options, "--set", "train.episodes=8", "--out", str(run)]) == 1
    assert "vhs: update 2: expected a finite gradient, found norm inf" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in (run / "checkpoints").rglob("*") if path.is_file()} == kept


@pytest.mark.parametrize("victim", ["state.json", "state.safetensors", "goals.vhs", "manifest.json"])
@pytest.mark.parametrize("damage", ["truncate", "flip", "remove"])
def test_a_damaged_checkpoint_is_an_error_that_names_it(
    victim: str, damage: str, short: Path, tmp_path: Path
) -> None:
    run = shutil.copytree(short, tmp_path / "run")
    path = run / "checkpoints" / "episode-000000004" / victim
    content = path.read_bytes()
    if damage == "truncate":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "flip":
        path.write_bytes(bytes(byte ^ 0xFF for byte in content[:200]) + content[200:])
    else:
        path.unlink()
    with pytest.raises(CheckpointError, match=r"episode-000000004: damaged checkpoint"):
        train(debug_config("train.episodes=8"), run, StringIO())


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("env.room.strid_m=0.4", "unknown key `env.room.strid_m`; did you mean `env.room.stride_m`?"),
        ("env.room.stride_m=-1", "env.room.stride_m: expected a positive number, found -1"),
        ("env.room.stride_m=fast", "env.room.stride_m: expected a number, found 'fast'"),
        ("env.renderer=mujoko", "env.renderer: expected one of "),
        ("method.supcon_batch=5", "method.supcon_batch: expected more than 5, the number of goals, "),
        ("train.device=gpu", "train.device: 'gpu' cannot be used"),
    ],
)
def test_what_cannot_run_is_refused_before_anything_is_written(
    assignment: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["train", "--config", str(CONFIGS / "debug.yaml"), "--out", str(tmp_path / "run")]
    assert main([*arguments, "--set", assignment]) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_saves_and_the_same_command_resumes(
    kind: signal.Signals, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    arguments = ["train", "--config", str(CONFIGS / "debug.yaml"), "--out", str(run), "--set"]
    endless = [*arguments, "train.episodes=100000"]
    process = subprocess.Popen(
        [sys.executable, "-m", "vhs.cli", *endless],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"COLUMNS": "300"},
        # Whoever runs the tests may ignore hang-ups, as nohup does, and then training would too.
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 60
    while len(read_log(run)) < 1 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert main(endless) == 1
    assert "another process trains here" in capsys.readouterr().err
    process.send_signal(kind)
    told, _ = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "the same command resumes" in told
    saved = sorted((run / "checkpoints").iterdir())
    stopped = int(saved[-1].name.removeprefix("episode-"))
    assert read_log(run)[-1]["episodes"] == stopped
    assert main([*arguments, f"train.episodes={stopped + 40}"]) == 0
    assert read_log(run)[-1]["episodes"] == stopped + 40


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="worker processes need Linux")
def test_a_signal_is_heard_while_a_worker_hangs(tmp_path: Path) -> None:
    run = tmp_path / "run"
    arguments = ["train", "--config", str(CONFIGS / "debug.yaml"), "--out", str(run)]
    process = subprocess.Popen(
        [sys.executable, "-m", "vhs.cli", *arguments, "--set", "train.episodes=100000"],
        stdout=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60
    while len(read_log(run)) < 1 and time.monotonic() < deadline:
        time.sleep(0.05)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    for child in children:
        os.kill(int(child), signal.SIGSTOP)
    time.sleep(1)
    process.send_signal(signal.SIGTERM)
    told, _ = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "the same command resumes" in told
    assert not any(Path(f"/proc/{child}").exists() for child in children)


def test_eval_prints_rates_and_spl(short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = shutil.copytree(short, tmp_path / "run")
    assert main(["eval", str(run), "--episodes", "10", "--seed", "3"]) == 0
    lines = dict(line.split() for line in capsys.readouterr().out.splitlines())
    assert float(lines["success"]) + float(lines["failure"]) + float(lines["timeout"]) == pytest.approx(
        1.0, abs=2e-3
    )
    assert lines["episodes"] == "10"
    assert 0 <= float(lines["spl"]) <= float(lines["success"])
    assert main(["eval", str(run), "--episodes", "10", "--seed", "3", "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert f"{again['success']:.3f}" == lines["success"], "the same seed gives the same evaluation"


def run_unread(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command whose standard output nobody reads, as behind ``| head -0``."""
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "wb") as unread:
        command = [sys.executable, "-m", "vhs.cli", *arguments]
        return subprocess.run(command, stdout=unread, stderr=subprocess.PIPE, text=True, timeout=120)


def test_training_and_evaluation_go_on_when_nobody_reads_their_output(tmp_path: Path) -> None:
    run = tmp_path / "run"
    settings = ["--config", str(CONFIGS / "debug.yaml"), "--set", "train.episodes=80"]
    done = run_unread("train", *settings, "--out", str(run))
    assert (done.returncode, done.stderr) == (0, "")
    assert [row["episodes"] for row in read_log(run)] == [40, 80]
    assert (run / "checkpoints" / "episode-000000080").is_dir()
    done = run_unread("eval", str(run), "--episodes", "4")
    assert (done.returncode, done.stderr) == (0, "")
    assert len(read_evaluations(run)) == 1


def test_eval_of_no_run_is_a_clear_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["eval", str(tmp_path)]) == 1
    assert "expected the directory of a run, found no config.yaml" in capsys.readouterr().err
