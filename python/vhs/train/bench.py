"""How fast this machine is at what a run does: ``vhs bench``."""

from __future__ import annotations

import io
import itertools
import os
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

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
from vhs.train.log import TrainingLog
from vhs.train.memory import keep_freed_memory
from vhs.train.session import Session


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


def bench(config: Config, seconds: float = 10.0) -> Speed:
    """Measure the environments and the training of a configuration; nothing is left on the disk.

    Args:
        config: the resolved configuration, whose workers, threads and device are what is measured.
        seconds: of each of the two measurements; each warms up for half as long before, and training until
            the first goal image is stored, but no more than six times as long.

    Raises:
        ConfigError: what the configuration asks for cannot be had here.
        OutputError: no episode was learned from in this time.
    """
    check_runnable(config)
    torch.set_num_threads(config.train.threads)
    keep_freed_memory()
    environments = measure_environments(config, seconds)
    steps, episodes = measure_training(config, seconds)
    return Speed(
        task=config.task_name,
        method=config.method.name,
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        threads=config.train.threads,
        precision=str(convolution_dtype(config)).removeprefix("torch."),
        environments_steps_per_s=environments,
        steps_per_s=steps,
        episodes_per_s=episodes,
        minutes=config.train.episodes / episodes / 60,
    )


def measure_environments(config: Config, seconds: float) -> float:
    """Steps a second of the environments; a reset counts as none, and takes its time."""
    streams, task = config.env.num_envs, task_of(config)
    spec = learn_spec(config, task)
    player = RandomPlayer(spec, np.random.default_rng(config.seed))
    with closing(make_stepping(config, task, spec, streams)) as stepping:
        episodes = Episodes(stepping, player, make_buffer(config, spec, streams, streams), itertools.count())
        episodes.start()
        _repeat(episodes.step, seconds / 2, time.monotonic)
        warm = episodes.steps
        taken = _repeat(episodes.step, seconds, time.monotonic)
        return (episodes.steps - warm) / taken


def measure_training(
    config: Config, seconds: float, clock: Callable[[], float] = time.monotonic
) -> tuple[float, float]:
    """Steps and episodes a second that a run learns from, once every loss is at work.

    Args:
        config: the resolved configuration.
        seconds: of the measurement; the warm-up before it takes from half to six and a half times as long.
        clock: seconds since some moment.

    Raises:
        OutputError: no episode was learned from in this time.
    """
    soon = config.model_copy(update={"method": config.method.model_copy(update={"warmup": 1})})
    with tempfile.TemporaryDirectory(prefix="vhs-bench-") as directory:
        run = Path(directory)
        with (
            closing(Session(soon, run)) as session,
            TrainingLog(run, config.train.episodes, 0, io.StringIO()) as log,
        ):

            def advance() -> None:
                session.advance(log)

            _repeat(advance, seconds / 2, clock)
            patience = clock() + 6 * seconds
            while not session.has_every_loss and clock() < patience:
                advance()
            before = session.progress.episodes, session.progress.env_steps
            taken = _repeat(advance, seconds, clock)
            episodes = session.progress.episodes - before[0]
            steps = session.progress.env_steps - before[1]
    if not episodes:
        raise OutputError(
            f"expected episodes to be learned from within {seconds:g} s, found none: take longer"
        )
    return steps / taken, episodes / taken


def _repeat(action: Callable[[], object], seconds: float, clock: Callable[[], float]) -> float:
    """Do something again and again for some time; the seconds that it really took."""
    began = clock()
    while clock() - began < seconds:
        action()
    return clock() - began
