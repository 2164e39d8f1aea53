"""What `vhs bench` says of a machine, and that it leaves nothing behind."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from debug import DEBUG, debug_config
from torch.distributed.elastic.multiprocessing.errors import ChildFailedError, ProcessFailure

from vhs.acting.setup import learn_spec, task_of
from vhs.cli import main
from vhs.errors import OutputError
from vhs.train import bench, trials
from vhs.train.bench import measure_training
from vhs.train.session import Session
from vhs.train.trials import Measured, Trial, advice, settings_to_try, try_processes

QUICK = ["--config", str(DEBUG), "--set", "env.num_workers=0", "--seconds", "1"]
ONE = ["--set", "train.episodes_per_update=1"]
"""An update an episode, so that a slow machine has one in a second."""


@pytest.mark.slow
def test_environments_and_training_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(bench, "_PATIENCE", 0)
    monkeypatch.setattr(bench, "settings_to_try", lambda *_: [])
    monkeypatch.setattr(bench, "try_processes", lambda config, updates: [Trial("--processes 2", 1.0)])
    assert main(["bench", *QUICK, *ONE, "--json"]) == 0
    speed = json.loads(capsys.readouterr().out)
    assert speed["environments_steps_per_s"] > 0
    assert speed["minutes"] == pytest.approx(240 / speed["episodes_per_s"] / 60)
    # An episode of the rooms takes one to twenty steps, and in training twice as many.
    assert 1 <= speed["steps_per_s"] / speed["episodes_per_s"] <= 40
    assert set(speed["shares"]) == {"environments", "acting", "learning", "the rest"}
    assert sum(speed["shares"].values()) == pytest.approx(1)
    assert min(speed["shares"].values()) >= 0
    assert speed["trials"] in ([["--processes 2", 1.0]], []), "nothing of one core alone"
    assert speed["advice"][0].startswith("most of the time goes to ")
    assert list(tmp_path.glob("vhs-bench-*")) == []


@pytest.mark.parametrize(
    ("warm_after", "moves"),
    [
        (0, 1 + 2),
        (7, 7 + 2),
        (10**6, 1 + 6 * 2 + 2),
    ],
)
def test_training_is_measured_from_the_first_goal_image_on_or_when_patience_ends(
    warm_after: int, moves: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[bool] = []
    monkeypatch.setattr(Session, "has_every_loss", property(lambda session: len(made) >= warm_after))
    monkeypatch.setattr(Session, "advance", lambda session, log: made.append(True))
    with pytest.raises(OutputError, match="expected episodes to be learned from within 2 s"):
        # A second a move.
        measure_training(debug_config("env.num_workers=0"), 2.0, lambda: float(len(made)))
    assert len(made) == moves


def test_a_configuration_is_that_of_a_training(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *QUICK, "--set", "train.epsiodes=3"]) == 1
    assert "train.episodes" in capsys.readouterr().err


@pytest.mark.slow
def test_no_episode_learned_from_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    too_many = ["--set", "env.num_envs=1", "--set", "train.episodes_per_update=100000"]
    assert main(["bench", *QUICK, *too_many]) == 1
    assert "expected episodes to be learned from within 1 s, found none" in capsys.readouterr().err


SHARES = {"environments": 0.2, "learning": 0.7, "the rest": 0.1}


def test_advice_is_what_was_measured_to_be_faster_beyond_noise() -> None:
    tried = [Trial("--set env.num_envs=32", 112.0), Trial("--processes 2", 160.0), Trial("slower", 50.0)]
    first, *others = advice(SHARES, Measured(100.0, 99.0, 101.0), tried)
    assert first == "most of the time goes to learning: 70%"
    assert others[:2] == [
        "--processes 2 is 1.60 times as fast",
        "--set env.num_envs=32 is 1.12 times as fast",
    ]
    assert "somewhat older episodes" in others[2]
    _, *found = advice(SHARES, Measured(100.0, 91.0, 109.0), tried)
    assert found == ["--processes 2 is 1.60 times as fast"], "the same differed by a fifth"


def test_without_anything_faster_so_is_said_and_a_busy_machine_is_named() -> None:
    _, nothing = advice(SHARES, Measured(100.0, 100.0, 100.0), [Trial("slower", 104.0)])
    assert nothing == "nothing that was tried is faster by more than 5%"
    *_, busy = advice(SHARES, Measured(100.0, 50.0, 150.0), [])
    assert "two measurements of the same differ by 200%" in busy


def test_what_is_tried_differs_in_one_thing_each() -> None:
    config = debug_config("env.num_workers=1", "env.num_envs=4", "train.precision=float32")
    spec = learn_spec(config, task_of(config))
    envs, workers, *precision = settings_to_try(config, spec)
    assert envs.said == "--set env.num_envs=8"
    assert envs.config.env == config.env.model_copy(update={"num_envs": 8})
    assert (workers.said, workers.config.env.num_workers) == ("--set env.num_workers=0", 0)
    assert all(one.config.env == config.env for one in precision), "bfloat16 where the processor has it"
    (*_, other) = settings_to_try(debug_config("train.precision=bfloat16"), spec)
    assert other.said == "--set train.precision=float32"


@pytest.mark.slow
def test_a_process_of_two_trains_for_some_updates_and_tells_their_speed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        trials, "elastic_launch", lambda how, train: lambda *told: {rank: train(*told) for rank in range(1)}
    )
    (found,) = try_processes(debug_config("env.num_workers=1", "train.episodes_per_update=2"), 2)
    assert found.said == "--processes 2 --set env.num_workers=0"
    assert found.steps_per_s > 0


def test_processes_that_fail_end_nothing_and_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def launch(*_: object) -> Callable[..., object]:
        def fails(*_: object) -> object:
            raise ChildFailedError("rank", {0: ProcessFailure(0, 1, 1, "no file")})

        return fails

    monkeypatch.setattr(trials, "elastic_launch", launch)
    tried = try_processes(debug_config("train.episodes_per_update=2"), 2)
    assert tried == [Trial("--processes 2 --set env.num_workers=0", 0.0)]
    said = advice({"learning": 1.0}, Measured(100.0, 100.0, 100.0), tried)
    assert said[-1] == "--processes 2 --set env.num_workers=0 could not train here"


def test_what_two_processes_cannot_share_is_not_tried() -> None:
    assert try_processes(debug_config("train.episodes_per_update=3"), 2) == []
