"""Sweeps whose runs are a stand-in for `vhs`: cores, resuming, failures, signals, kills; one real sweep."""

import json
import os
import signal
import subprocess
import sys
import threading
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from stand_in import FOUR_RUNS, STAND_IN, Journal

from vhs.cli import main
from vhs.errors import CheckpointError, ConfigError, OutputError
from vhs.runs.lock import hold
from vhs.sweep.display import SweepDisplay
from vhs.sweep.local import share_cores
from vhs.sweep.runner import sweep

ROOT = Path(__file__).parents[2]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="cores are pinned on Linux alone"),
]


@pytest.fixture
def journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Journal:
    monkeypatch.setenv("PYTHONPATH", str(STAND_IN))
    monkeypatch.setenv("STAND_IN_JOURNAL", str(tmp_path / "journal"))
    monkeypatch.setenv("STAND_IN_S", "0.1")
    (tmp_path / "sweep.yaml").write_text(FOUR_RUNS)
    return Journal(tmp_path / "journal")


def run_sweep(root: Path, **more: Any) -> tuple[int, list[str]]:
    told = StringIO()
    status = sweep(root / "sweep.yaml", root / "out", stream=told, **more)
    return status, told.getvalue().splitlines()


def test_every_run_is_trained_and_evaluated_and_has_one_line(tmp_path: Path, journal: Journal) -> None:
    status, lines = run_sweep(tmp_path)
    assert status == 0
    assert sorted(journal.of("train")) == sorted(journal.of("eval"))
    assert len(set(journal.of("train"))) == len(journal.of("train")) == 4
    assert [line.split()[0] for line in lines[:4]] == ["[1/4]", "[2/4]", "[3/4]", "[4/4]"]
    assert all(line.endswith(": success 50.0%, SPL 0.250, 4 episodes") for line in lines[:4])
    assert lines[4:] == [f"compare them:  vhs compare {tmp_path / 'out' / 'task2'}-*"]


def test_no_two_runs_share_a_core(tmp_path: Path, journal: Journal) -> None:
    run_sweep(tmp_path)
    available = os.sched_getaffinity(0)
    began: dict[int, dict[str, Any]] = {}
    busy: set[int] = set()
    for entry in sorted(journal.entries, key=lambda entry: entry["time"]):
        if entry["event"] == "end":
            busy -= set(began.pop(entry["pid"])["cores"])
            continue
        assert len(entry["cores"]) == 1
        assert set(entry["cores"]) <= available - busy
        assert entry["omp"] == "1"
        busy |= set(entry["cores"])
        began[entry["pid"]] = entry


def test_one_job_takes_one_run_after_another_with_all_cores(tmp_path: Path, journal: Journal) -> None:
    run_sweep(tmp_path, jobs=1)
    events = [entry["event"] for entry in journal.entries]
    assert events == ["train", "end", "eval", "end"] * 4
    assert journal.entries[0]["cores"] == sorted(os.sched_getaffinity(0))


def test_finished_runs_are_not_repeated(tmp_path: Path, journal: Journal) -> None:
    run_sweep(tmp_path)
    before = len(journal.entries)
    status, lines = run_sweep(tmp_path)
    assert status == 0
    assert len(journal.entries) == before
    assert [line.split(": ")[1] for line in lines[:4]] == ["finished before"] * 4


def test_what_is_missing_is_done_again(tmp_path: Path, journal: Journal) -> None:
    run_sweep(tmp_path)
    (tmp_path / "out" / "task2-vhs-seed0" / "eval.json").unlink()
    (tmp_path / "out" / "task2-vhs-seed1" / "eval.json").unlink()
    checkpoint = tmp_path / "out" / "task2-vhs-seed1" / "checkpoints" / "episode-000000004"
    checkpoint.rename(checkpoint.with_name("episode-000000003"))
    journal.path.unlink()
    assert run_sweep(tmp_path)[0] == 0
    assert journal.of("train") == ["task2-vhs-seed1"]
    assert sorted(journal.of("eval")) == ["task2-vhs-seed0", "task2-vhs-seed1"]


def test_more_episodes_train_on_and_another_evaluation_is_one_more(tmp_path: Path, journal: Journal) -> None:
    run_sweep(tmp_path)
    journal.path.unlink()
    (tmp_path / "sweep.yaml").write_text(FOUR_RUNS.replace("seed: 9", "seed: 8, greedy: true"))
    assert run_sweep(tmp_path)[0] == 0
    assert (len(journal.of("train")), len(journal.of("eval"))) == (0, 4)
    (tmp_path / "sweep.yaml").write_text(FOUR_RUNS.replace("episodes: 4", "episodes: 8"))
    assert run_sweep(tmp_path)[0] == 0
    assert len(journal.of("train")) == 4


def test_a_failed_run_is_told_and_the_others_go_on(
    tmp_path: Path, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STAND_IN_FAILS", "relabel_probability=0.4-seed0")
    status, lines = run_sweep(tmp_path)
    assert status == 1
    name = "task2-vhs-relabel_probability=0.4-seed0"
    log = tmp_path / "out" / "logs" / f"{name}.txt"
    (failed,) = [line for line in lines if "failed" in line]
    assert failed.endswith(f"{name}: failed: vhs: the roof fell in (see {log})")
    assert len(journal.of("eval")) == 3
    assert not any("compare them" in line for line in lines)


def test_a_killed_run_is_told_by_its_signal(
    tmp_path: Path, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STAND_IN_DIES", "relabel_probability=0.4-seed0")
    status, lines = run_sweep(tmp_path)
    assert status == 1
    (failed,) = [line for line in lines if "failed" in line]
    assert "task2-vhs-relabel_probability=0.4-seed0: failed: killed by signal 9 (Killed) (see " in failed
    assert len(journal.of("eval")) == 3


def test_a_run_that_cannot_be_started_is_told_and_the_others_go_on(tmp_path: Path, journal: Journal) -> None:
    (tmp_path / "out" / "logs" / "task2-vhs-seed0.txt").mkdir(parents=True)
    status, lines = run_sweep(tmp_path, jobs=1)
    assert status == 1
    assert any("task2-vhs-seed0: failed: cannot start: Is a directory (see " in line for line in lines)
    assert len(journal.of("eval")) == 3


def test_a_sweep_goes_on_when_nobody_reads_its_output(tmp_path: Path, journal: Journal) -> None:
    class Unread(StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError(32, "Broken pipe")

    assert sweep(tmp_path / "sweep.yaml", tmp_path / "out", stream=Unread()) == 0
    assert len(journal.of("eval")) == 4


def test_a_sweep_that_fails_itself_lets_its_runs_save(
    tmp_path: Path, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(display: SweepDisplay, *_: Any) -> None:
        journal.wait_for("train")
        raise OSError(28, "No space left on device")

    monkeypatch.setenv("STAND_IN_S", "60")
    monkeypatch.setattr("vhs.sweep.runner._DISPLAY_S", 0.0)
    monkeypatch.setattr(SweepDisplay, "advance", fail)
    with pytest.raises(OSError, match="No space left"):
        run_sweep(tmp_path, jobs=1)
    assert [entry["event"] for entry in journal.entries] == ["train", "stopped", "end"]


def test_a_damaged_evaluation_fails_its_run_alone(tmp_path: Path, journal: Journal) -> None:
    run_sweep(tmp_path)
    (tmp_path / "out" / "task2-vhs-seed0" / "eval.json").write_text("[{")
    status, lines = run_sweep(tmp_path)
    assert status == 1
    assert sum("finished before" in line for line in lines) == 3
    assert any("task2-vhs-seed0: failed" in line and "eval.json: expected JSON" in line for line in lines)


def test_a_signal_stops_every_run_once_and_cleanly(
    tmp_path: Path, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STAND_IN_S", "60")
    jobs = min(2, len(os.sched_getaffinity(0)))

    def interrupt() -> None:
        journal.wait_for("train", jobs)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    status, lines = run_sweep(tmp_path, jobs=jobs)
    thread.join()
    assert status == 130
    assert sorted(journal.of("stopped")) == sorted(journal.of("train"))
    assert len(journal.of("end")) == jobs
    assert lines[0] == f"SIGINT: {jobs} runs save and end; the same command resumes"
    monkeypatch.setenv("STAND_IN_S", "0.1")
    assert run_sweep(tmp_path)[0] == 0


def test_a_killed_sweep_leaves_no_run_behind_and_resumes(
    tmp_path: Path, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STAND_IN_S", "60")
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT / 'python')!r}); from pathlib import Path; "
        f"from vhs.sweep.runner import sweep; root = Path({str(tmp_path)!r}); "
        "sweep(root / 'sweep.yaml', root / 'out', 1)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code])
    try:
        journal.wait_for("train")
    finally:
        parent.kill()
        parent.wait()
    monkeypatch.setenv("STAND_IN_S", "0.1")
    # It has to wait for the run that the killed sweep left behind to save.
    assert run_sweep(tmp_path)[0] == 0
    events = [(entry["event"], entry["pid"]) for entry in journal.entries]
    first = events[0][1]
    own = [event for event, pid in events if pid == first]
    # The signal of a dying parent may arrive twice: nothing else may come between.
    assert list(dict.fromkeys(own)) == ["train", "stopped", "end"]
    assert {pid for _, pid in events[: len(own)]} == {first}, "the next sweep waited for it"
    assert len(set(journal.of("eval"))) == len(journal.of("eval")) == 4


def test_a_held_directory_is_refused(
    tmp_path: Path, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vhs.sweep.runner._PATIENCE_S", 0.1)
    told = StringIO()
    (tmp_path / "out").mkdir()
    with (
        hold(tmp_path / "out" / ".lock", "held", by_children=True),
        pytest.raises(OutputError, match="another sweep is at work here"),
    ):
        sweep(tmp_path / "sweep.yaml", tmp_path / "out", stream=told)
    assert "waiting for another sweep" in told.getvalue()
    assert journal.entries == []


def test_the_run_of_another_configuration_is_refused_before_anything_starts(
    tmp_path: Path, journal: Journal
) -> None:
    run = tmp_path / "out" / "task2-vhs-seed1"
    run.mkdir(parents=True)
    (run / "config.yaml").write_text("seed: 1\ntrain: {return_lambda: 0.5}\n")
    (run / "run.json").write_text("{}")
    (run / "log.jsonl").write_text('{"episodes": 500}\n')
    with pytest.raises(
        CheckpointError, match=r"task2-vhs-seed1: holds a run with other values of train\.return_lambda"
    ):
        run_sweep(tmp_path)
    assert journal.entries == []


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("grids: [{grid: {env.renderer: [raster, mujoko]}}]", "env.renderer: expected one of"),
        ("grids: [{}]\nseed: [1]", "unknown key `seed`; did you mean `seeds`?"),
    ],
)
def test_what_cannot_run_is_refused_before_anything_is_written(
    content: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sweep.yaml").write_text(content)
    assert main(["sweep", str(tmp_path / "sweep.yaml"), "--out", str(tmp_path / "out")]) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_output_that_cannot_be_written_is_a_clear_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sweep.yaml").write_text(FOUR_RUNS)
    (tmp_path / "file").write_text("")
    assert main(["sweep", str(tmp_path / "sweep.yaml"), "--out", str(tmp_path / "file")]) == 1
    assert "cannot write" in capsys.readouterr().err


def test_cores_are_shared_evenly() -> None:
    assert share_cores([0, 1, 5], None) == [(0,), (1,), (5,)]
    assert share_cores([0, 1, 2, 3, 4], 2) == [(0, 1), (2, 3)]
    assert share_cores([3], 1) == [(3,)]
    with pytest.raises(ConfigError, match=r"--jobs: expected at most 2, the cores that there are, found 3"):
        share_cores([0, 1], 3)


def test_a_real_sweep_can_be_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "python"))
    base = f"base: [{ROOT / 'configs' / 'debug.yaml'}]\n"
    (tmp_path / "sweep.yaml").write_text(base + "set: {train.episodes: 8}\neval: {episodes: 2}\ngrids: [{}]")
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "sweep.yaml"]) == 0
    told = capsys.readouterr().out
    assert "[1/1] task2-vhs-seed0: success " in told
    assert ", 8 episodes, " in told
    command = json.loads((tmp_path / "runs/sweep/task2-vhs-seed0/run.json").read_text())["command"]
    assert command.startswith("vhs train --config ")
    assert main(["compare", "runs/sweep"]) == 0
    assert "`vhs` has one seed" in capsys.readouterr().out
