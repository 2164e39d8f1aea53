"""The log of a run: every episode once, no torn line, numbers that JSON can hold."""

import json
from io import StringIO
from pathlib import Path

import pytest

from vhs import Outcome
from vhs.errors import CheckpointError, OutputError
from vhs.runs.rows import read_log
from vhs.runs.window import EpisodeResult, Window
from vhs.train.log import TrainingLog


def row(episodes: int, **more: float) -> dict[str, float]:
    return {
        "episodes": episodes,
        "rate/success": 0.5,
        "rate/failure": 0.25,
        "rate/timeout": 0.25,
        "speed/steps_per_s": 100.0,
        "time/minutes": 1.0,
        **more,
    }


def write(run: Path, first: int, *rows: dict[str, float]) -> str:
    told = StringIO()
    with TrainingLog(run, 100, first, told) as log:
        for one in rows:
            log.write(one)
    return told.getvalue()


def test_rows_behind_the_checkpoint_are_dropped_on_resume(tmp_path: Path) -> None:
    write(tmp_path, 0, row(10), row(20), row(30))
    write(tmp_path, 20, row(30, again=1.0))
    assert [one["episodes"] for one in read_log(tmp_path)] == [10, 20, 30]
    assert "again" in read_log(tmp_path)[-1]


def test_a_torn_last_line_is_left_out_and_then_cleaned(tmp_path: Path) -> None:
    write(tmp_path, 0, row(10))
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write('{"episodes": 20, "rate/succ')
    assert [one["episodes"] for one in read_log(tmp_path)] == [10]
    write(tmp_path, 10, row(20))
    assert [one["episodes"] for one in read_log(tmp_path)] == [10, 20]


@pytest.mark.parametrize("left", [0, 1])
def test_a_log_that_was_emptied_or_shortened_is_noticed(left: int, tmp_path: Path) -> None:
    write(tmp_path, 0, row(10), row(20))
    path = tmp_path / "log.jsonl"
    shortened = b"".join(path.read_bytes().splitlines(keepends=True)[:left])
    path.write_bytes(shortened)
    with pytest.raises(
        CheckpointError, match=f"expected rows up to episode 20, .* found them up to {10 * left}"
    ):
        write(tmp_path, 20, row(30))
    assert path.read_bytes() == shortened


def test_a_log_that_was_moved_away_is_said_and_begun_anew(tmp_path: Path) -> None:
    write(tmp_path, 0, row(10))
    (tmp_path / "log.jsonl").unlink()
    assert "is gone; the log goes on behind episode 10" in write(tmp_path, 10, row(20))
    assert [one["episodes"] for one in read_log(tmp_path)] == [20]


@pytest.mark.parametrize("line", [b'{"episodes": 2', b"[1]", b"{}", b"", b"\xff\xfe"])
def test_a_damaged_line_is_named(line: bytes, tmp_path: Path) -> None:
    write(tmp_path, 0, row(10), row(20))
    path = tmp_path / "log.jsonl"
    lines = path.read_bytes().splitlines()
    path.write_bytes(b"\n".join([lines[0], line, lines[1]]) + b"\n")
    with pytest.raises(CheckpointError, match=r"log\.jsonl:2: damaged line: expected a JSON object"):
        read_log(tmp_path)


def test_a_log_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "log.jsonl").mkdir()
    with pytest.raises(CheckpointError, match=r"log\.jsonl: cannot be read: Is a directory"):
        write(tmp_path, 0, row(10))
    (tmp_path / "log.jsonl").rmdir()
    (tmp_path / "tensorboard").write_text("")
    with pytest.raises(OutputError, match="tensorboard: cannot write: File exists"):
        write(tmp_path, 0, row(10))


def test_numbers_that_json_cannot_hold_become_null(tmp_path: Path) -> None:
    write(tmp_path, 0, row(10, bad=float("nan")))
    assert json.loads((tmp_path / "log.jsonl").read_text())["bad"] is None


def test_a_pipe_gets_one_whole_line_a_row(tmp_path: Path) -> None:
    lines = write(tmp_path, 0, row(10), row(20)).splitlines()
    assert len(lines) == 2
    assert "20 episodes  success 50.0%  failure 25.0%  timeout 25.0%  100 steps/s" in lines[1]


def test_a_window_averages_a_loss_over_the_updates_that_had_it() -> None:
    window = Window(max_steps=20)
    window.add_update({"policy": 1.0})
    window.add_update({"policy": 3.0, "supcon": 5.0})
    assert window.losses() == {"policy": 2.0, "supcon": 5.0}
    window.episodes += [EpisodeResult(Outcome.SUCCESS, 4, 10.0), EpisodeResult(Outcome.TIMEOUT, 20, -0.3)]
    assert window.rates() == {"success": 0.5, "failure": 0.0, "timeout": 0.5, "steps": 12.0, "return": 4.85}


def test_what_ends_after_the_tasks_steps_is_a_timeout_in_the_rates() -> None:
    window = Window(max_steps=20)
    late = [EpisodeResult(Outcome.SUCCESS, 21, 10.0), EpisodeResult(Outcome.FAILURE, 40, -1.0)]
    window.episodes += [
        *late,
        EpisodeResult(Outcome.SUCCESS, 20, 10.0),
        EpisodeResult(Outcome.FAILURE, 2, -1.0),
    ]
    assert window.rates() == {"success": 0.25, "failure": 0.25, "timeout": 0.5, "steps": 15.5, "return": 4.5}


def test_rates_are_of_seeds_that_were_not_missed_before() -> None:
    window = Window(max_steps=20)
    window.episodes += [EpisodeResult(Outcome.SUCCESS, 4, 10.0), EpisodeResult(Outcome.TIMEOUT, 20, -0.3)]
    fresh = window.rates()
    again = [(Outcome.SUCCESS, 30), (Outcome.SUCCESS, 9), (Outcome.FAILURE, 2), (Outcome.TIMEOUT, 40)]
    window.episodes += [EpisodeResult(outcome, steps, 0.0, is_retry=True) for outcome, steps in again]
    assert window.rates() == fresh | {"retry_success": 0.25}
    kept = Window(max_steps=20)
    kept.load_state_dict(window.state_dict())
    assert kept.rates() == window.rates()
