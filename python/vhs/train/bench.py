"""How fast this machine is at what a run does: ``vhs bench``."""

from __future__ import annotations

import io
import os
import tempfile
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from vhs.config import Config
from vhs.errors import OutputError
from vhs.train.build import check_runnable, convolution_dtype, make_envs, make_rooms
from vhs.train.log import TrainingLog
from vhs.train.loop import Session
from vhs.train.memory import keep_freed_memory


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
    rooms_steps_per_s: float
    """Environment steps a second of the rooms alone, under random actions."""
    steps_per_s: float
    """Environment steps a second of training, with every loss at work if the agent succeeded in time."""
    episodes_per_s: float
    """Episodes a second that were learned from: the first of the agent, later ones are often shorter."""
    minutes: float
    """Minutes that `train.episodes` would take if they stayed as long."""


def bench(config: Config, seconds: float = 10.0) -> Speed:
    """Measure the rooms and the training of a configuration; nothing is left on the disk.

    Args:
        config: the resolved configuration, whose workers, learners, threads and device are what is measured.
        seconds: of each of the two measurements; each warms up for half as long before, and training until
            the first goal image is stored, but no more than six times as long.

    Raises:
        ConfigError: what the configuration asks for cannot be had here.
        OutputError: no episode was learned from in this time.
    """
    check_runnable(config)
    torch.set_num_threads(config.train.threads)
    keep_freed_memory()
    rooms = _rooms_alone(config, seconds)
    steps, episodes = _training(config, seconds)
    return Speed(
        task=config.task,
        method=config.method.name,
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        threads=config.train.threads,
        precision=str(convolution_dtype(config)).removeprefix("torch."),
        rooms_steps_per_s=rooms,
        steps_per_s=steps,
        episodes_per_s=episodes,
        minutes=config.train.episodes / episodes / 60,
    )


def _rooms_alone(config: Config, seconds: float) -> float:
    """Steps a second of the rooms; a reset counts as none, and takes its time."""
    streams = config.env.num_envs
    actions = np.random.default_rng(config.seed)
    with closing(make_envs(config, 1)[0]) as env:
        num_actions = int(env.action_space.n)  # type: ignore[attr-defined]
    with closing(make_rooms(config, streams)) as rooms:
        rooms.reset(range(streams), range(streams))
        steps, seed, began = 0, streams, time.monotonic()
        warm_until = began + seconds / 2
        is_warm = False
        while (now := time.monotonic()) < warm_until + seconds:
            if not is_warm and now >= warm_until:
                steps, began, is_warm = 0, now, True
            answers = rooms.recv()
            ended, running = answers.streams[answers.is_end], answers.streams[~answers.is_end]
            steps += int((~answers.is_first).sum())
            if len(ended):
                rooms.reset(ended.tolist(), range(seed, seed + len(ended)))
                seed += len(ended)
            if len(running):
                rooms.send(running, actions.integers(num_actions, size=len(running)))
        return steps / (now - began)


def _training(config: Config, seconds: float) -> tuple[float, float]:
    """Steps and episodes a second that a run learns from, once every loss is at work."""
    soon = config.model_copy(update={"method": config.method.model_copy(update={"warmup": 1})})
    with tempfile.TemporaryDirectory(prefix="vhs-bench-") as directory:
        run = Path(directory)
        with (
            closing(Session(soon, run)) as session,
            TrainingLog(run, config.train.episodes, 0, io.StringIO()) as log,
        ):
            _advance(session, log, seconds / 2)
            patience = time.monotonic() + 6 * seconds
            while not session.has_every_loss and time.monotonic() < patience:
                session.advance(log)
            before = session.progress.episodes, session.progress.env_steps
            taken = _advance(session, log, seconds)
            episodes = session.progress.episodes - before[0]
            steps = session.progress.env_steps - before[1]
    if not episodes:
        raise OutputError(
            f"expected episodes to be learned from within {seconds:g} s, found none: take longer"
        )
    return steps / taken, episodes / taken


def _advance(session: Session, log: TrainingLog, seconds: float) -> float:
    began = time.monotonic()
    while time.monotonic() - began < seconds:
        session.advance(log)
    return time.monotonic() - began
