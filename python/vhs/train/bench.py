"""How fast this machine is at what a run does, where the time goes, and what would help: ``vhs bench``.

What would help is not guessed: other settings train as long as the run's own, which is measured before and
after them, and by what these two differ is noise.
"""

from __future__ import annotations

import io
import itertools
import os
import tempfile
import time
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from vhs.acting.episodes import Episodes
from vhs.acting.players import RandomPlayer
from vhs.acting.setup import (
    check_runnable,
    convolution_dtype,
    learn_spec,
    make_buffer,
    make_stepping,
    task_of,
)
from vhs.config import Config
from vhs.errors import OutputError
from vhs.task import TaskSpec
from vhs.train.log import TrainingLog
from vhs.train.memory import keep_freed_memory
from vhs.train.session import Session
from vhs.train.trials import Measured, Trial, advice, settings_to_try, try_processes

_WARM_UP = 0.25
"""How long is warmed up, in measurements."""
_PATIENCE = 6
"""How many times as long as a measurement the first goal image is waited for."""


@dataclass(frozen=True, slots=True)
class Speed:
    """What was measured, and under what."""

    task: str
    method: str
    cores: int
    """That this process may use."""
    threads: int
    """Of torch, in one operation."""
    precision: str
    """Of the convolutions."""
    environments_steps_per_s: float
    """Steps a second of the environments alone, under random actions, their frames stored."""
    steps_per_s: float
    """Environment steps a second of training, with every loss at work if the agent succeeded in time."""
    episodes_per_s: float
    """Episodes a second that were learned from: the first of the agent, later ones are often shorter."""
    minutes: float
    """Minutes that `train.episodes` would take if they stayed as long."""
    shares: dict[str, float]
    """Of the time of training, by part: stepping the environments or waiting for them, acting, learning, the
    rest."""
    noise: float
    """By what share two measurements of the same training differ."""
    trials: list[Trial]
    """Other settings that were measured."""
    advice: list[str]
    """What follows, a sentence each."""


class Training(NamedTuple):
    """A training that was measured."""

    steps_per_s: float
    episodes_per_s: float
    shares: dict[str, float]
    has_every_loss: bool


def bench(config: Config, seconds: float = 2.0) -> Speed:
    """Measure the environments and the training of a configuration; nothing is left on the disk.

    Args:
        config: the resolved configuration, whose workers, threads and device are what is measured.
        seconds: of each measurement: environments, training, up to four other settings, training again. Each
            warms up for a quarter as long before, and training until the first goal image is stored, but no
            more than six times as long.

    Raises:
        ConfigError: what the configuration asks for cannot be had here.
        OutputError: no episode was learned from in this time.
    """
    check_runnable(config)
    torch.set_num_threads(config.train.threads)
    keep_freed_memory()
    spec = learn_spec(config, task_of(config))
    environments = measure_environments(config, spec, seconds)
    first = measure_training(config, seconds, spec=spec)
    measure = partial(measure_training, seconds=seconds, spec=spec, waits=first.has_every_loss)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    trials = [
        Trial(setting.said, measure(setting.config).steps_per_s) for setting in settings_to_try(config, spec)
    ]
    if cores > 1:
        updates = 1 + int(first.episodes_per_s * seconds / config.train.episodes_per_update)
        trials += try_processes(config, updates)
    again = measure(config)
    found = Measured((first.steps_per_s + again.steps_per_s) / 2, first.steps_per_s, again.steps_per_s)
    episodes = (first.episodes_per_s + again.episodes_per_s) / 2
    shares = {part: (share + again.shares[part]) / 2 for part, share in first.shares.items()}
    return Speed(
        task=config.task_name,
        method=config.method.name,
        cores=cores,
        threads=config.train.threads,
        precision=str(convolution_dtype(config)).removeprefix("torch."),
        environments_steps_per_s=environments,
        steps_per_s=found.steps_per_s,
        episodes_per_s=episodes,
        minutes=config.train.episodes / episodes / 60,
        shares=shares,
        noise=found.noise,
        trials=trials,
        advice=advice(shares, found, trials),
    )


def measure_environments(config: Config, spec: TaskSpec, seconds: float) -> float:
    """Steps a second of the environments; a reset counts as none, and takes its time."""
    streams, task = config.env.num_envs, task_of(config)
    player = RandomPlayer(spec, np.random.default_rng(config.seed))
    with closing(make_stepping(config, task, spec, streams)) as stepping:
        episodes = Episodes(stepping, player, make_buffer(config, spec, streams, streams), itertools.count())
        episodes.start()
        _repeat(episodes.step, _WARM_UP * seconds, time.monotonic)
        warm = episodes.steps
        taken = _repeat(episodes.step, seconds, time.monotonic)
        return (episodes.steps - warm) / taken


def measure_training(
    config: Config,
    seconds: float,
    clock: Callable[[], float] = time.monotonic,
    *,
    spec: TaskSpec | None = None,
    waits: bool = True,
) -> Training:
    """Steps and episodes a second that a run learns from once every loss is at work, and where the time goes.

    Args:
        config: the resolved configuration.
        seconds: of the measurement; the warm-up before it takes from a quarter to six and a quarter of them.
        clock: seconds since some moment.
        spec: what the task was found to be; None: found here.
        waits: whether to wait for the first goal image.

    Raises:
        OutputError: no episode was learned from in this time.
    """
    soon = config.model_copy(update={"method": config.method.model_copy(update={"warmup": 1})})
    with tempfile.TemporaryDirectory(prefix="vhs-bench-") as directory:
        run = Path(directory)
        with (
            closing(Session(soon, run, spec=spec)) as session,
            TrainingLog(run, config.train.episodes, 0, io.StringIO()) as log,
        ):

            def advance() -> None:
                session.advance(log)

            spent = _watch(session.parts.items(), clock)
            _repeat(advance, _WARM_UP * seconds, clock)
            patience = clock() + _PATIENCE * seconds * waits
            while not session.has_every_loss and clock() < patience:
                advance()
            before = session.progress.episodes, session.progress.env_steps
            spent.update(dict.fromkeys(spent, 0.0))
            taken = _repeat(advance, seconds, clock)
            episodes = session.progress.episodes - before[0]
            steps = session.progress.env_steps - before[1]
            has_every_loss = session.has_every_loss
    if not episodes:
        raise OutputError(
            f"expected episodes to be learned from within {seconds:g} s, found none: take longer"
        )
    shares = {part: part_s / taken for part, part_s in spent.items()}
    shares["the rest"] = 1 - sum(shares.values())
    return Training(steps / taken, episodes / taken, shares, has_every_loss)


def _watch(parts: Iterable[tuple[str, tuple[Any, str]]], clock: Callable[[], float]) -> dict[str, float]:
    """Seconds that have passed in some methods of some objects, by part; it goes on counting."""
    spent: dict[str, float] = {}

    def timed(part: str, method: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        began = clock()
        try:
            return method(*args, **kwargs)
        finally:
            spent[part] += clock() - began

    for part, (owner, name) in parts:
        spent[part] = 0.0
        setattr(owner, name, partial(timed, part, getattr(owner, name)))
    return spent


def _repeat(action: Callable[[], object], seconds: float, clock: Callable[[], float]) -> float:
    """Do something again and again for some time; the seconds that it really took."""
    began = clock()
    while clock() - began < seconds:
        action()
    return clock() - began
