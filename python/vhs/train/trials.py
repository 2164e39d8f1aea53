"""What `vhs bench` tries beside a configuration's own settings, and what it says of what it found."""

from __future__ import annotations

import logging
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch.distributed.elastic.multiprocessing.errors import ChildFailedError
from torch.distributed.launcher.api import elastic_launch

from vhs.acting.setup import convolution_dtype, has_workers, workers_of
from vhs.config import Config
from vhs.models import pick_device
from vhs.task import TaskSpec
from vhs.train.log import Log
from vhs.train.session import Session
from vhs.world import joined
from vhs.world.launch import one_machine

_LEAST_GAIN = 0.05
"""Of less nobody is told, however quiet the machine is."""
_MOST_NOISE = 0.2
"""Of more it is said that nothing can be told."""
_PROCESSES = 2


class Setting(NamedTuple):
    """Another way to train the same."""

    said: str
    """On the command line."""
    config: Config


class Trial(NamedTuple):
    """A setting that was measured."""

    said: str
    steps_per_s: float
    """0 where it could not train."""


class Measured(NamedTuple):
    """The configuration's own settings, measured before and after the others."""

    steps_per_s: float
    before: float
    after: float

    @property
    def noise(self) -> float:
        """By what share of the slower one the two differ."""
        return max(self.before, self.after) / min(self.before, self.after) - 1


def settings_to_try(config: Config, spec: TaskSpec) -> Iterator[Setting]:
    """Twice the environments, with workers or without, and the other precision, where each makes sense."""
    yield _setting(config, "env", num_envs=2 * config.env.num_envs)
    if has_workers():
        yield _setting(config, "env", num_workers=int(not workers_of(config)))
    bfloat16 = torch.bfloat16
    if len(spec.frame_shape) == 3:
        if convolution_dtype(config) is bfloat16:
            yield _setting(config, "train", precision="float32")
        elif convolution_dtype(_setting(config, "train", precision="auto").config) is bfloat16:
            yield _setting(config, "train", precision="bfloat16")


def _setting(config: Config, section: str, **values: Any) -> Setting:
    changed = getattr(config, section).model_copy(update=values)
    said = " ".join(f"--set {section}.{key}={value}" for key, value in values.items())
    return Setting(said, config.model_copy(update={section: changed}))


def try_processes(config: Config, updates: int) -> list[Trial]:
    """Train as two processes that step their environments themselves; nothing where that makes no sense.

    Args:
        config: of one process.
        updates: to be measured, after half as many that warm up.
    """
    if config.train.episodes_per_update % _PROCESSES or pick_device(config.train.device).type != "cpu":
        return []
    setting = _setting(config, "env", num_workers=0)
    logging.getLogger("torch.distributed.elastic").setLevel(logging.CRITICAL)
    try:
        found: dict[int, float] = elastic_launch(one_machine(_PROCESSES), _train_as_rank)(
            setting.config, updates
        )
    except ChildFailedError:  # nobody asked for two, so that it ends nothing
        found = {0: 0.0}
    return [Trial(f"--processes {_PROCESSES} {setting.said}", found[0])]


def _train_as_rank(config: Config, updates: int) -> float:
    """Steps a second of all ranks together."""
    soon = config.model_copy(update={"method": config.method.model_copy(update={"warmup": 1})})
    torch.set_num_threads(config.train.threads)
    with joined() as world, tempfile.TemporaryDirectory(prefix="vhs-bench-") as directory:
        session, log = Session(soon, Path(directory), world=world), Log()
        # A number of updates that all ranks agree on: none may be left waiting.
        warm = 1 + updates // 2
        while session.updates < warm:
            session.advance(log)
        steps, began = session.progress.env_steps, time.monotonic()
        while session.updates < warm + updates:
            session.advance(log)
        found = (session.progress.env_steps - steps) / (time.monotonic() - began)
        session.close()
    return found


def advice(shares: Mapping[str, float], own: Measured, trials: Sequence[Trial]) -> list[str]:
    """What a user would want to know of the numbers, a sentence each.

    Args:
        shares: of the time of training, by part.
        own: of the configuration as it is.
        trials: of other settings.
    """
    most = max(shares, key=lambda part: shares[part])
    said = [f"most of the time goes to {most}: {shares[most]:.0%}"]
    least = 1 + max(own.noise, _LEAST_GAIN)
    gains = sorted(((trial.steps_per_s / own.steps_per_s, trial.said) for trial in trials), reverse=True)
    better = [(gain, name) for gain, name in gains if gain > least]
    said += [f"{name} is {gain:.2f} times as fast" for gain, name in better]
    if not better:
        said.append(f"nothing that was tried is faster by more than {least - 1:.0%}")
    said += [f"{trial.said} could not train here" for trial in trials if not trial.steps_per_s]
    if own.noise > _MOST_NOISE:
        said.append(
            f"two measurements of the same differ by {own.noise:.0%}: measure again when this machine has "
            "nothing else to do"
        )
    if any("num_envs" in name for _, name in better):
        said.append(
            "more environments at a time learn from somewhat older episodes: compare what is learned, too"
        )
    return said
