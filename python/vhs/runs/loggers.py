"""Further places for the rows, pictures and films of a run, by the names of `train.loggers`.

Each goes by its own settings (environment variables, log-in, offline where it can be), under the project
`vhs` and the name of the directory. `loggers.json` in the run says which run it is there, so that a resumed
one goes on in it. What was logged once stays: rows that a resumed run makes again are not logged again.
"""

from __future__ import annotations

import io
import json
import time
import uuid
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, redirect_stdout
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from vhs.config import Config
from vhs.config.variants import flat_config
from vhs.distribution import pip_install
from vhs.errors import CheckpointError, ConfigError, OutputError
from vhs.reading import read_bounded
from vhs.runs.files import write_files
from vhs.runs.log import BoardLog, Logger

IDENTITIES_NAME = "loggers.json"
PROJECT = "vhs"
_MOST_BYTES = 100_000


@dataclass(frozen=True, slots=True)
class Opening:
    """What a logger is opened with."""

    run: Path
    identity: str | None
    """What it called the run when it was begun; None for a new one."""
    settings: Mapping[str, Any]
    """The configuration, by dotted key."""

    @property
    def name(self) -> str:
        """What people call the run."""
        return self.run.resolve().name

    @property
    def new_identity(self) -> str:
        """One that no other run has."""
        return f"{self.name}-{uuid.uuid4().hex[:8]}"


class ForeignLogger(Logger):
    """A logger of somebody else's library."""

    identity: str
    """What it calls the run."""


class TrackioLog(ForeignLogger):
    """trackio: a database of its own, without account; ``trackio show`` shows it."""

    def __init__(self, opening: Opening) -> None:
        """Open or go on with the run."""
        import trackio

        self._trackio = trackio
        self.identity = opening.identity or opening.new_identity
        with _silence():
            self._run = trackio.init(
                PROJECT,
                name=self.identity,
                config=dict(opening.settings),
                resume="allow",
                embed=False,
                auto_log_cpu=False,
                auto_log_gpu=False,
            )

    def write(self, row: Mapping[str, Any]) -> None:
        """Log the numbers of a row, at its episode."""
        self._run.log(_numbers(row), step=row["episodes"])

    def show(self, name: str, path: Path, episodes: int) -> None:
        """Log a picture or a film."""
        kind = self._trackio.Video if path.suffix == ".gif" else self._trackio.Image
        self._run.log({name: kind(str(path))}, step=episodes)

    def close(self) -> None:
        """Write out what waits."""
        with _silence():
            self._run.finish()


class WandbLog(ForeignLogger):
    """Weights & Biases; ``WANDB_MODE=offline`` writes to `wandb/` in the run, for ``wandb sync``."""

    def __init__(self, opening: Opening) -> None:
        """Open or go on with the run."""
        import wandb

        self._wandb = wandb
        self.identity = opening.identity or opening.new_identity
        self._run = wandb.init(
            project=PROJECT,
            id=self.identity,
            name=opening.name,
            dir=str(opening.run),
            config=dict(opening.settings),
            resume="allow",
            reinit="create_new",
        )
        self._run.define_metric("*", step_metric="episodes")

    def write(self, row: Mapping[str, Any]) -> None:
        """Log the numbers of a row, over episodes."""
        self._run.log({**_numbers(row), "episodes": row["episodes"]})

    def show(self, name: str, path: Path, episodes: int) -> None:
        """Log a picture or a film."""
        kind = self._wandb.Video if path.suffix == ".gif" else self._wandb.Image
        self._run.log({name: kind(str(path)), "episodes": episodes})

    def close(self) -> None:
        """Write out what waits."""
        self._run.finish()


class MlflowLog(ForeignLogger):
    """MLflow, where ``MLFLOW_TRACKING_URI`` says; pictures and films are artifacts in `media/`."""

    def __init__(self, opening: Opening) -> None:
        """Open or go on with the run."""
        from mlflow import MlflowClient

        self._client = MlflowClient()
        if opening.identity is None:
            known = self._client.get_experiment_by_name(PROJECT)
            experiment = self._client.create_experiment(PROJECT) if known is None else known.experiment_id
            self.identity = self._client.create_run(experiment, run_name=opening.name).info.run_id
            self._client.log_dict(self.identity, dict(opening.settings), "config.json")
        else:
            self.identity = opening.identity
            self._client.update_run(self.identity, status="RUNNING")

    def write(self, row: Mapping[str, Any]) -> None:
        """Log the numbers of a row, at its episode."""
        from mlflow.entities import Metric

        now = int(1000 * time.time())
        metrics = [Metric(key, float(value), now, row["episodes"]) for key, value in _numbers(row).items()]
        self._client.log_batch(self.identity, metrics=metrics)

    def show(self, name: str, path: Path, episodes: int) -> None:
        """Log a picture or a film."""
        self._client.log_artifact(self.identity, str(path), "media")

    def close(self) -> None:
        """Say that nobody trains any more."""
        self._client.set_terminated(self.identity)


_FOREIGN: dict[str, Callable[[Opening], ForeignLogger]] = {
    "trackio": TrackioLog,
    "wandb": WandbLog,
    "mlflow": MlflowLog,
}
"""By name, which is that of the package and of the extra as well."""


def check_loggers(config: Config) -> None:
    """Check before a training that its loggers are installed, and what draws films where they are asked for.

    Raises:
        ConfigError: one is not; the extra that brings it is named.
    """
    for name in config.train.loggers:
        if name in _FOREIGN and find_spec(name) is None:
            raise ConfigError(f"train.loggers: {name} is not installed; {pip_install(name)}")
    if config.train.media_every is not None and find_spec("PIL") is None:
        raise ConfigError(f"train.media_every: films need pillow; {pip_install('report')}")


def open_loggers(config: Config, run: Path, kept: int) -> list[Logger]:
    """Open the loggers of a configuration, in their order.

    Args:
        config: names them.
        run: directory of the run.
        kept: the episode behind which rows are made again.

    Raises:
        CheckpointError: `loggers.json` is damaged.
        OutputError: one cannot be opened; those before it are closed again.
    """
    identities = _read_identities(run) if kept else {}
    opened: list[Logger] = []
    try:
        for name in config.train.loggers:
            if name in _FOREIGN:
                foreign = _open(name, Opening(run, identities.get(name), flat_config(config)))
                identities[name] = foreign.identity
                opened.append(foreign)
            elif BoardLog.takes(run):
                opened.append(BoardLog(run, kept))
        if any(name in _FOREIGN for name in config.train.loggers):
            write_files(run, {IDENTITIES_NAME: json.dumps(identities, indent=2) + "\n"})
    except BaseException:
        for logger in opened:
            logger.close()
        raise
    return opened


def _silence() -> AbstractContextManager[object]:
    """Keeps what a library prints off standard output, which is the training's."""
    return redirect_stdout(io.StringIO())


def _open(name: str, opening: Opening) -> ForeignLogger:
    try:
        return _FOREIGN[name](opening)
    except Exception as error:  # whatever their library raises
        raise OutputError(f"train.loggers: {name} cannot be opened: {error}") from error


def _read_identities(run: Path) -> dict[str, str]:
    path = run / IDENTITIES_NAME
    try:
        found = json.loads(read_bounded(path, _MOST_BYTES))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{path}: cannot be read: {error}") from error
    if isinstance(found, dict) and all(isinstance(value, str) for value in found.values()):
        return found
    raise CheckpointError(f"{path}: expected a JSON object of texts")


def _numbers(row: Mapping[str, Any]) -> dict[str, float]:
    return {key: v for key, v in row.items() if isinstance(v, int | float) and key != "episodes"}
