"""What `vhs bench` says of a machine, and that it leaves nothing behind."""

import json
from pathlib import Path

import pytest
from debug import DEBUG, debug_config

from vhs.cli import main
from vhs.errors import OutputError
from vhs.train.bench import measure_training
from vhs.train.session import Session

QUICK = ["--config", str(DEBUG), "--set", "env.num_workers=0", "--seconds", "1"]
ONE = ["--set", "train.episodes_per_update=1"]
"""An update an episode, so that a slow machine has one in a second."""


@pytest.mark.slow
def test_environments_and_training_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert main(["bench", *QUICK, *ONE, "--json"]) == 0
    speed = json.loads(capsys.readouterr().out)
    assert speed["environments_steps_per_s"] > 0
    assert speed["minutes"] == pytest.approx(240 / speed["episodes_per_s"] / 60)
    # An episode of the rooms takes one to twenty steps.
    assert 1 <= speed["steps_per_s"] / speed["episodes_per_s"] <= 20
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
