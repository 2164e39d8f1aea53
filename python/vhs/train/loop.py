"""The training loop: collect, learn, store goals, log, save; any learner with the face of `Learner` fits."""

from __future__ import annotations

import time
from collections import deque
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import torch

from vhs.acting.actor import Actor
from vhs.acting.episodes import EndedEpisode, Episodes
from vhs.acting.players import AgentPlayer
from vhs.acting.replay import drop_episodes, episodes_state, resume_episodes
from vhs.acting.seeds import episode_seeds
from vhs.acting.setup import (
    check_runnable,
    check_spec,
    convolution_dtype,
    learn_spec,
    make_buffer,
    make_stepping,
    settled,
    task_of,
    with_given,
)
from vhs.config import Config
from vhs.interrupt import stop_on_signal
from vhs.models import ExtractorFactory
from vhs.runs.checkpoint import fitting, has_checkpoint, load_checkpoint, save_checkpoint
from vhs.runs.directory import check_run, fixed_settings, open_run
from vhs.runs.loggers import check_loggers
from vhs.runs.window import Window
from vhs.task import Task, TaskSpec
from vhs.train.build import make_learner
from vhs.train.log import TrainingLog
from vhs.train.memory import keep_freed_memory

_MANY = 100
"""Episodes without a success that are worth a word."""


@dataclass(slots=True)
class Progress:
    """Counters of a run; an episode counts once it has been learned from."""

    episodes: int = 0
    env_steps: int = 0
    begun: int = 0
    """Episodes begun, and so seeds used."""
    logged: int = 0
    """Episodes in whole rows of the log; the row of a stopped run, if shorter, is made again."""
    seconds: float = 0.0
    """Wall-clock of training over all resumptions."""


def train(
    config: Config,
    run: Path,
    stream: TextIO | None = None,
    *,
    task: Task | None = None,
    extractor: ExtractorFactory | None = None,
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

    Returns:
        True when the run is finished, False when a signal stopped it.

    Raises:
        CheckpointError: the directory holds another configuration's run or a damaged checkpoint.
        OutputError: a checkpoint or the log cannot be written; the checkpoints before it are untouched.
        DivergenceError: the loss became infinite or NaN; the last checkpoint is untouched.
        ArgumentError: a field of the task does not fit its environment; nothing was written.
    """
    config, task = with_given(config, task), task or task_of(config)
    check_runnable(config, task)
    spec = learn_spec(config, task)
    config = settled(config, spec)
    check_run(config, run)
    check_loggers(config)
    torch.set_num_threads(config.train.threads)
    keep_freed_memory()
    session = Session(config, run, task, spec, extractor)
    with (
        closing(session),
        open_run(
            config,
            run,
            precision=str(convolution_dtype(config)).removeprefix("torch."),
            episodes=session.progress.episodes,
        ),
        TrainingLog(
            run,
            config.train.episodes,
            session.progress.episodes,
            stream,
            logged=session.rows_until,
            config=config,
        ) as log,
        stop_on_signal() as stop,
    ):
        if session.progress.episodes:
            log.say(f"resuming {run} at episode {session.progress.episodes}")
        if session.dropped:
            log.say(f"dropped {session.dropped} episodes that were under way: {task.name} cannot repeat them")
        while not (session.is_finished or stop.is_set):
            session.advance(log)
        session.finish(log)
        if session.is_finished:
            log.say(f"finished: {run} ({session.progress.episodes} episodes)\nevaluate it:  vhs eval {run}")
        else:
            log.say(
                f"{stop.signal_name}: saved {run} at episode {session.progress.episodes}; "
                "the same command resumes"
            )
        return session.is_finished


class Session:
    """One run's parts, from its first episode or from its last checkpoint."""

    def __init__(
        self,
        config: Config,
        run: Path,
        task: Task | None = None,
        spec: TaskSpec | None = None,
        extractor: ExtractorFactory | None = None,
    ) -> None:
        """Take up the run in a directory where it stands.

        Args:
            config: as for `train`.
            run: as for `train`.
            task: as for `train`.
            spec: what the task was found to be; None: found here.
            extractor: as for `train`.
        """
        task, streams = task or task_of(config), config.env.num_envs
        spec = spec or learn_spec(config, task)
        config = settled(config, spec)
        self._config = config
        self._run = run
        self._task = task
        self._extractor = extractor
        self.progress = Progress()
        self.dropped = 0
        """Episodes of the checkpoint that could not be brought back."""
        check_spec(config, task, spec, is_own=extractor is not None)
        self._learner = make_learner(config, spec, extractor)
        self._generator = torch.Generator().manual_seed(config.seed)
        self._window = Window()
        with fitting(run):
            state = self._restore() if has_checkpoint(run) else None
        self._buffer = make_buffer(config, spec, streams, streams + config.train.episodes_per_update)
        self._actor = Actor(
            self._learner.agent, streams, dtype=self._learner.dtype, generator=self._generator
        )
        self._begun_before = self.progress.begun
        seeds = episode_seeds(config.seed, first=self._begun_before)
        self._stepping = make_stepping(config, task, spec, streams)
        player = AgentPlayer(self._actor, self._buffer, self._learner.goals.begin)
        self._episodes = Episodes(self._stepping, player, self._buffer, seeds)
        self._waiting: deque[EndedEpisode] = deque()
        if state is None:
            self._episodes.start()
        elif task.replayable:
            self._replay(state)
        else:
            self.dropped = drop_episodes(state["episodes"], self._episodes)
        # A finished run has nothing to make again.
        self.rows_until = self.progress.episodes if self.is_finished else self.progress.logged
        self._clock = self._row_clock = self._save_clock = time.monotonic()
        self._row_steps = self.progress.env_steps

    @property
    def is_finished(self) -> bool:
        """Whether as many episodes as `train.episodes` have been learned from."""
        return self.progress.episodes >= self._config.train.episodes

    @property
    def num_waiting(self) -> int:
        """Episodes that have ended and wait to be learned from."""
        return len(self._waiting)

    @property
    def num_running(self) -> int:
        """Episodes that run."""
        return len(self._episodes.running)

    @property
    def has_every_loss(self) -> bool:
        """Whether every term of the method is at work."""
        return self._learner.has_every_term

    def advance(self, log: TrainingLog) -> None:
        """One update where a whole group of episodes is waiting, one step of every environment otherwise.

        Between two calls the run can be saved: see `vhs.acting.replay`.
        """
        if len(self._waiting) < self._config.train.episodes_per_update:
            self._waiting.extend(self._episodes.step())
            return
        before = self.progress.episodes
        self._learn()
        log.advance(self.progress.episodes)
        if len(self._window.episodes) >= self._config.train.log_every:
            self._write_row(log)
            self._doubt(log)
            self._window, self.progress.logged = Window(), self.progress.episodes
        every = self._config.train.media_every
        if every is not None and self.progress.episodes // every > before // every:
            self.save(log)
            self._show(log)
        if time.monotonic() - self._save_clock >= self._config.train.checkpoint_every_s:
            self.save(log)

    def _learn(self) -> None:
        episodes = [self._waiting.popleft() for _ in range(self._config.train.episodes_per_update)]
        ids = np.array([episode.id for episode in episodes], dtype=np.int64)
        goals = torch.stack([e.goal_embedding for e in episodes if e.goal_embedding is not None])
        learners = self._config.train.learners
        shares = zip(np.split(ids, learners), goals.chunk(learners), strict=True)
        told = [(self._buffer.gather(own), embedded) for own, embedded in shares]
        touched = [episode.touched for episode in episodes if episode.touched is not None]
        metrics = self._learner.update(told, np.array(touched, dtype=np.int64) if touched else None)
        self._window.add_update(metrics)
        self._learner.goals.collect(self._buffer, ids)
        self._window.add_episodes(episodes)
        self.progress.episodes += len(episodes)
        self.progress.env_steps += sum(episode.steps for episode in episodes)

    def _write_row(self, log: TrainingLog) -> None:
        log.write(self._row())
        self.rows_until = self.progress.episodes

    def _doubt(self, log: TrainingLog) -> None:
        """Say after the first row that there was no success: nobody learns from a judge that sees none."""
        count = len(self._window.episodes)
        if count == self.progress.episodes >= _MANY and not self._window.rates()["success"]:
            log.say(
                f"none of the first {count} episodes was a success; if one was, `judge` of task "
                f"{self._task.name} does not say so"
            )

    def _row(self) -> dict[str, Any]:
        now = time.monotonic()
        self._tick(now)
        speed = (self.progress.env_steps - self._row_steps) / max(now - self._row_clock, 1e-9)
        row: dict[str, Any] = {
            "episodes": self.progress.episodes,
            "env_steps": self.progress.env_steps,
            "updates": self._learner.updates,
            "episodes_cut": self._episodes.cut,
            "time/minutes": round(self.progress.seconds / 60, 4),
            "speed/steps_per_s": round(speed, 2),
        }
        row |= {f"rate/{name}": rate for name, rate in self._window.rates().items()}
        row |= {f"loss/{name}": value for name, value in self._window.losses().items()}
        row |= {f"goals/{label}": int(count) for label, count in enumerate(self._learner.goals.counts)}
        self._row_clock, self._row_steps = now, self.progress.env_steps
        return row

    def _show(self, log: TrainingLog) -> None:
        """Make a film and a picture of goals by the checkpoint just saved: what learns is not touched."""
        from vhs.train.media import make_media

        for name, path in make_media(self._run, self._task, self._extractor).items():
            log.show(name, path, self.progress.episodes)

    def finish(self, log: TrainingLog) -> None:
        """Save; episodes since the last row get a shorter row of their own, so that the log misses none.

        A run that goes on makes that row again, whole.
        """
        if self.progress.episodes > self.rows_until:
            self._write_row(log)
        self.save(log)

    def save(self, log: TrainingLog) -> None:
        """Write a checkpoint, from which the run goes on as if nothing had happened."""
        log.sync()
        self._tick(time.monotonic())
        self.progress.begun = self._begun_before + self._episodes.begun
        state = {
            "progress": {name: getattr(self.progress, name) for name in Progress.__slots__},
            "learner": self._learner.state_dict(),
            "actions": self._generator.get_state(),
            "window": self._window.state_dict(),
            "settings": fixed_settings(self._config),
            "episodes": episodes_state(self._episodes, self._actor, self._waiting),
        }
        save_checkpoint(
            self._run,
            self.progress.episodes,
            state,
            self._learner.goals.store,
            keep=self._config.train.keep_checkpoints,
        )
        self._save_clock = time.monotonic()

    def close(self) -> None:
        """End the environments."""
        self._stepping.close()

    def _restore(self) -> dict[str, Any]:
        """Load everything but the episodes, which need environments; the whole state."""
        state, goal_store = load_checkpoint(self._run)
        self._learner.load_state_dict(state["learner"])
        self._learner.goals.store = goal_store
        self._generator.set_state(state["actions"])
        self.progress = Progress(**state["progress"])
        self._window.load_state_dict(state["window"])
        return state

    def _replay(self, state: dict[str, Any]) -> None:
        """Bring the waiting and running episodes back."""
        try:
            with fitting(self._run):
                self._waiting = resume_episodes(
                    state["episodes"],
                    self._episodes,
                    self._actor,
                    next(self._learner.agent.parameters()).device,
                )
        except BaseException:
            self._stepping.close()
            raise

    def _tick(self, now: float) -> None:
        self.progress.seconds += now - self._clock
        self._clock = now
