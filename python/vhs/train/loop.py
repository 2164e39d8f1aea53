"""``vhs train``: one call trains a run until it is finished or somebody stops it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, nullcontext
from pathlib import Path
from typing import TextIO

import torch

from vhs.acting.setup import check_runnable, convolution_dtype, learn_spec, settled, task_of, with_given
from vhs.config import Config, TrainSection
from vhs.interrupt import stop_on_signal
from vhs.models import ExtractorFactory
from vhs.runs.directory import as_begun, check_run, open_run
from vhs.runs.loggers import check_loggers
from vhs.task import Task
from vhs.train.exchange import check_sees, check_share, facts
from vhs.train.log import Log, TrainingLog
from vhs.train.memory import keep_freed_memory
from vhs.train.session import Session
from vhs.world import World, joined


def train(
    config: Config,
    run: Path,
    stream: TextIO | None = None,
    *,
    task: Task | None = None,
    extractor: ExtractorFactory | None = None,
    world: World | None = None,
) -> bool:
    """Train until `train.episodes` or a signal, resuming what the directory already holds.

    Args:
        config: the resolved configuration.
        run: directory of the run; made when missing.
        stream: where a person reads along; standard output by default.
        task: what to train on; None: the task that the configuration names. Whoever looks at the run later
            has to say it again.
        extractor: makes the feature extractor in place of `model.extractor`; whoever loads the agent gives it
            again.
        world: the ranks that train it; None: what the launcher of this process says, as `torchrun` does.

    Returns:
        True when the run is finished, False when a signal stopped it.

    Raises:
        CheckpointError: the directory holds another configuration's run or a damaged checkpoint, or
            `train.start_from` is none that fits.
        OutputError: a checkpoint or the log cannot be written; the checkpoints before it are untouched.
        DivergenceError: the loss became infinite or NaN; the last checkpoint is untouched.
        ArgumentError: a field of the task does not fit its environment; nothing was written.
        PeerError: another rank is gone, or was started with something else.
        ToldError: what one of these is at rank 0, elsewhere.
    """
    with joined() if world is None else nullcontext(world) as world, ExitStack() as opened:
        with world.together():
            config, task = with_given(config, task), task or task_of(config)
            check_share(config, world)
            device = world.device(config.train.device)
            here = config.model_copy(update={"train": config.train.model_copy(update={"device": device})})
            check_runnable(here, task)
            config, here = as_begun(config, run), as_begun(here, run)
            spec = learn_spec(here, task)
            config, here = settled(config, spec), settled(here, spec)
            if not world.rank:
                check_run(config, run)
                check_loggers(config)
        world.set_patience(config.train.peer_timeout_s)
        world.expect_equal(facts(config, spec, run))
        torch.set_num_threads(config.train.threads)
        keep_freed_memory()
        with world.together():
            session = opened.enter_context(closing(Session(here, run, task, spec, extractor, world)))
        with world.together():
            log = Log()
            if not world.rank:
                log = opened.enter_context(_opened(config, run, session, stream))
        check_sees(world, run)
        session.expect_equal_weights()
        session.stop = opened.enter_context(stop_on_signal())
        _say_how_it_begins(session, run, task, log, world, config.train)
        while not (session.is_finished or session.is_stopped):
            session.advance(log)
        session.finish(log)
        episodes = session.progress.episodes
        if session.is_finished:
            log.say(f"finished: {run} ({episodes} episodes)\nevaluate it:  vhs eval {run}")
        else:
            others = "the launcher is gone" if world.is_orphan else "another process was stopped"
            name = session.stop.signal_name or others
            log.say(f"{name}: saved {run} at episode {episodes}; the same command resumes")
        return session.is_finished


@contextmanager
def _opened(config: Config, run: Path, session: Session, stream: TextIO | None) -> Iterator[TrainingLog]:
    """The directory of the run, held, and its log."""
    episodes = session.progress.episodes
    start = None if session.start is None else session.start.as_dict()
    precision = str(convolution_dtype(config)).removeprefix("torch.")
    with (
        open_run(config, run, precision=precision, episodes=episodes, start=start),
        TrainingLog(
            run, config.train.episodes, episodes, stream, logged=session.rows_until, config=config
        ) as log,
    ):
        yield log


def _say_how_it_begins(
    session: Session, run: Path, task: Task, log: Log, world: World, section: TrainSection
) -> None:
    before, now = session.ranks_before, world.size
    moves = (section.learning_rate_end, section.entropy_weight_end) != (None, None)
    if moves and section.episodes > section.schedule_episodes:
        log.say(
            "learning rate and entropy stay as they are after train.schedule_episodes = "
            f"{section.schedule_episodes} of train.episodes = {section.episodes}; "
            "as long a schedule gains more"
        )
    if session.start is not None:
        log.say(str(session.start))
    if session.progress.episodes:
        log.say(f"resuming {run} at episode {session.progress.episodes}")
    if before not in (0, now):
        kept = "; kept episodes are those of the first process" if session.keeps_episodes else ""
        log.say(
            f"{now} process{'es' if now > 1 else ''} instead of {before}: dropped {session.dropped} episodes "
            f"that were under way; an update has as many episodes as before, in other shares{kept}"
        )
    elif session.dropped:
        log.say(f"dropped {session.dropped} episodes that were under way: {task.name} cannot repeat them")
