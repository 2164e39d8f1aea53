"""Further loggers: checked before a training, one run however often it goes on, no row twice, films.

Those of other libraries are tested for real where they are installed, offline.
"""

import json
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from importlib import util
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
import torch
from debug import debug_config

from vhs.config import load_config
from vhs.errors import CheckpointError, ConfigError, OutputError
from vhs.runs import loggers
from vhs.runs.checkpoint import load_checkpoint
from vhs.runs.loggers import IDENTITIES_NAME, Opening
from vhs.runs.rows import read_log
from vhs.train import train
from vhs.train.log import TrainingLog

FEW = ("train.episodes=40", "train.log_every=20", "env.num_workers=0")
ROW = {
    "rate/success": 0.5,
    "rate/failure": 0.25,
    "rate/timeout": 0.25,
    "speed/steps_per_s": 1.0,
    "time/minutes": 1.0,
}


class Listener(loggers.ForeignLogger):
    """Stands for somebody else's library."""

    opened: list["Listener"] = []  # noqa: RUF012

    def __init__(self, opening: Opening) -> None:
        self.identity = opening.identity or opening.new_identity
        self.rows: list[int] = []
        self.shown: list[tuple[str, int]] = []
        self.is_closed = False
        self.opened.append(self)

    def write(self, row: Mapping[str, Any]) -> None:
        self.rows.append(row["episodes"])

    def show(self, name: str, path: Path, episodes: int) -> None:
        assert path.stat().st_size
        self.shown.append((name, episodes))

    def close(self) -> None:
        self.is_closed = True


@pytest.fixture
def listeners(monkeypatch: pytest.MonkeyPatch) -> list[Listener]:
    """Listeners in the place of trackio, those that were opened."""
    monkeypatch.setitem(loggers._FOREIGN, "trackio", Listener)
    monkeypatch.setattr(loggers, "find_spec", lambda name: object())
    monkeypatch.setattr(Listener, "opened", [])
    return Listener.opened


def test_an_unknown_logger_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match=r"train\.loggers\.1: expected .*'wandb'.*, found 'paper'"):
        load_config([], ["train.loggers=[tensorboard, paper]"])


def test_a_logger_that_is_not_installed_names_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loggers, "find_spec", lambda name: None)
    with pytest.raises(
        ConfigError, match=r"train.loggers: wandb is not installed; pip install 'vhs-rl\[wandb\]'"
    ):
        train(debug_config(*FEW, "train.loggers=[wandb]"), tmp_path / "run", StringIO())
    with pytest.raises(ConfigError, match=r"films need pillow; pip install 'vhs-rl\[report\]'"):
        train(debug_config(*FEW, "train.media_every=20"), tmp_path / "run", StringIO())
    assert not (tmp_path / "run").exists()


def test_rows_that_are_made_again_are_logged_once(tmp_path: Path, listeners: list[Listener]) -> None:
    config = debug_config("train.loggers=[trackio]")
    with TrainingLog(tmp_path, 100, 0, StringIO(), config=config) as log:
        for episodes in (10, 20, 30):
            log.write({"episodes": episodes, **ROW})
    with TrainingLog(tmp_path, 100, 20, StringIO(), config=config) as log:  # killed behind its checkpoint
        for episodes in (30, 40):
            log.write({"episodes": episodes, **ROW})
    assert [listener.rows for listener in listeners] == [[10, 20, 30], [40]]
    assert listeners[0].identity == listeners[1].identity
    assert all(listener.is_closed for listener in listeners)
    assert not (tmp_path / "tensorboard").exists()


def test_a_run_that_begins_anew_is_another_run(tmp_path: Path, listeners: list[Listener]) -> None:
    for _ in range(2):
        with TrainingLog(tmp_path, 100, 0, StringIO(), config=debug_config("train.loggers=[trackio]")):
            pass
    assert listeners[0].identity != listeners[1].identity


def test_a_logger_that_fails_is_told_of_once_and_left_out(
    tmp_path: Path, listeners: list[Listener], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: Listener, row: Mapping[str, Any]) -> None:
        raise RuntimeError("no route to host")

    monkeypatch.setattr(Listener, "write", fail)
    told = StringIO()
    config = debug_config("train.loggers=[trackio, tensorboard]")
    with TrainingLog(tmp_path, 100, 0, told, config=config) as log:
        log.write({"episodes": 10, **ROW})
        log.write({"episodes": 20, **ROW})
    assert told.getvalue().count("no route to host; the run goes on without it") == 1
    assert [row["episodes"] for row in read_log(tmp_path)] == [10, 20]


def test_a_logger_that_cannot_be_opened_ends_the_start_in_a_sentence(
    tmp_path: Path, listeners: list[Listener], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(opening: Opening) -> Listener:
        raise RuntimeError("no API key")

    monkeypatch.setitem(loggers._FOREIGN, "wandb", refuse)
    config = debug_config("train.loggers=[trackio, wandb]")
    with pytest.raises(OutputError, match=r"train\.loggers: wandb cannot be opened: no API key"):
        TrainingLog(tmp_path, 100, 0, StringIO(), config=config)
    assert listeners[0].is_closed


def test_identities_that_are_damaged_are_named(tmp_path: Path, listeners: list[Listener]) -> None:
    (tmp_path / IDENTITIES_NAME).write_text('{"trackio": 3}')
    with pytest.raises(CheckpointError, match=r"loggers\.json: expected a JSON object of texts"):
        TrainingLog(tmp_path, 100, 20, StringIO(), config=debug_config("train.loggers=[trackio]"))


@pytest.mark.slow
def test_films_and_goals_are_shown_and_change_nothing(tmp_path: Path, listeners: list[Listener]) -> None:
    train(debug_config(*FEW), tmp_path / "plain", StringIO())
    shown = debug_config(*FEW, "train.loggers=[tensorboard, trackio]", "train.media_every=20")
    train(shown, tmp_path / "shown", StringIO())
    assert {name for name, _ in listeners[0].shown} == {"media/episode", "media/goals"}
    assert {episodes for _, episodes in listeners[0].shown} == {20, 40}
    assert (tmp_path / "shown" / "media" / "episode-40.gif").read_bytes().startswith(b"GIF89a")
    events = b"".join(path.read_bytes() for path in (tmp_path / "shown" / "tensorboard").iterdir())
    assert b"media/episode" in events
    assert b"GIF89a" in events
    plain, other = (load_checkpoint(tmp_path / name)[0]["learner"]["agent"] for name in ("plain", "shown"))
    assert all(torch.equal(plain[name], other[name]) for name in plain)


def train_twice(name: str, run: Path) -> str:
    """Train to 40 episodes and on to 60 with a logger; what it calls the run."""
    for episodes in (40, 60):
        train(
            debug_config(
                *FEW, f"train.episodes={episodes}", f"train.loggers=[{name}]", "train.media_every=20"
            ),
            run,
            StringIO(),
        )
    identities: dict[str, str] = json.loads((run / IDENTITIES_NAME).read_text())
    return identities[name]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.skipif(util.find_spec("trackio") is None, reason="needs vhs-rl[trackio]")
def test_trackio_for_real(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRACKIO_DIR", str(tmp_path / "trackio"))
    identity = train_twice("trackio", tmp_path / "run")
    with closing(sqlite3.connect(tmp_path / "trackio" / "vhs.db")) as opened:
        logged = opened.execute("SELECT run_name, step, metrics FROM metrics ORDER BY step").fetchall()
    assert {name for name, _, _ in logged} == {identity}
    assert [step for _, step, metrics in logged if b"rate/success" in metrics] == [20, 40, 60]
    assert list((tmp_path / "trackio").rglob("*.gif"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.skipif(util.find_spec("wandb") is None, reason="needs vhs-rl[wandb]")
def test_wandb_offline_for_real(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    identity = train_twice("wandb", tmp_path / "run")
    import wandb

    wandb.teardown()  # what its process still has to write
    parts = list((tmp_path / "run" / "wandb").glob(f"offline-run-*/run-{identity}.wandb"))
    assert len(parts) == 2  # `wandb sync` puts them together
    assert all(b"rate/success" in part.read_bytes() for part in parts)
    assert list((tmp_path / "run" / "wandb").rglob("media/**/*.gif"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.skipif(util.find_spec("mlflow") is None, reason="needs vhs-rl[mlflow]")
def test_mlflow_for_real(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path / 'mlflow.db'}")
    identity = train_twice("mlflow", tmp_path / "run")
    from mlflow import MlflowClient

    client = MlflowClient()
    history = client.get_metric_history(identity, "rate/success")
    assert [metric.step for metric in history] == [20, 40, 60]
    assert client.get_run(identity).info.status == "FINISHED"
    media = [item.path for item in client.list_artifacts(identity, "media")]
    assert "media/episode-60.gif" in media
