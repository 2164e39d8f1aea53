"""`eval.json`: one entry for each way of evaluating, replaced by the same again, never half-written."""

import json
import multiprocessing
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

import pytest
from hand_made_runs import evaluation

from vhs.cli import main
from vhs.errors import CheckpointError
from vhs.eval import Evaluation, read_evaluations, record_evaluation


def test_a_run_without_evaluations_has_none(tmp_path: Path) -> None:
    assert read_evaluations(tmp_path) == []


def test_the_same_evaluation_again_replaces_the_old_one(tmp_path: Path) -> None:
    record_evaluation(tmp_path, evaluation(success=0.9))
    record_evaluation(tmp_path, evaluation(success=0.8))
    assert read_evaluations(tmp_path) == [evaluation(success=0.8)]


@pytest.mark.parametrize(
    "change", [{"trained_episodes": 2000}, {"seed": 1}, {"greedy": True}, {"episodes": 100}]
)
def test_another_way_of_evaluating_is_another_entry(change: dict[str, Any], tmp_path: Path) -> None:
    record_evaluation(tmp_path, evaluation())
    record_evaluation(tmp_path, evaluation(**change))
    recorded = read_evaluations(tmp_path)
    assert len(recorded) == 2
    assert evaluation() in recorded
    assert evaluation(**change) in recorded
    assert [path.name for path in tmp_path.iterdir()] == ["eval.json"]


def record(run: Path, seed: int, gate: Barrier) -> None:
    gate.wait()
    record_evaluation(run, evaluation(seed=seed))


@pytest.mark.slow
def test_evaluations_that_end_together_are_all_kept(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    for turn in range(10):
        run, gate = tmp_path / str(turn), context.Barrier(4)
        run.mkdir()
        writers = [context.Process(target=record, args=(run, seed, gate)) for seed in range(4)]
        for writer in writers:
            writer.start()
        for writer in writers:
            writer.join()
        assert [entry["seed"] for entry in read_evaluations(run)] == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[{", "expected JSON"),
        ("{}", "expected a list of evaluations with trained_episodes"),
        ('[{"success": 0.5}]', "expected a list of evaluations"),
        (json.dumps([evaluation() | {"success": "much"}]), "expected a list of evaluations"),
        (json.dumps([evaluation() | {"greedy": 0}]), "expected a list of evaluations"),
        ("[" * 100_000, "expected JSON"),
    ],
)
def test_a_damaged_file_is_named_and_kept(content: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "eval.json"
    path.write_text(content)
    with pytest.raises(CheckpointError, match=rf"eval\.json: {message}"):
        record_evaluation(tmp_path, evaluation())
    assert path.read_text() == content


def test_a_directory_that_cannot_be_written_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "eval.json").mkdir()
    with pytest.raises(CheckpointError, match=r"eval\.json: cannot read the evaluations: Is a directory"):
        record_evaluation(tmp_path, evaluation())
    (tmp_path / "file").write_text("")
    with pytest.raises(CheckpointError, match=r"file.*Not a directory"):
        record_evaluation(tmp_path / "file", evaluation())


def test_the_command_records_what_it_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("vhs.eval.evaluate", lambda run, task, **asked: Evaluation(**evaluation(**asked)))
    assert main(["eval", str(tmp_path), "--episodes", "7", "--seed", "3", "--greedy", "--json"]) == 0
    assert read_evaluations(tmp_path) == [evaluation(episodes=7, seed=3, greedy=True)]
    assert json.loads(capsys.readouterr().out) == evaluation(episodes=7, seed=3, greedy=True)


def test_the_command_still_prints_where_it_cannot_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(path: Path, *_: Any, **__: Any) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("vhs.eval.evaluate", lambda run, task, **asked: Evaluation(**evaluation(**asked)))
    monkeypatch.setattr(Path, "write_bytes", refuse)
    assert main(["eval", str(tmp_path)]) == 0
    told = capsys.readouterr()
    assert "success 0.900" in told.out
    assert "cannot write: Permission denied; the evaluation is not recorded" in told.err
    assert list(tmp_path.iterdir()) == []
