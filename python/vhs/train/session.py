"""One run of a training: collect, learn, store goals, log, save; any learner with the face of `Learner` fits.

Several ranks train one run together. Each has environments, a buffer and generators of its own, and seeds
that no other has; weights, optimiser, goal images, counters and the rows of the log are alike on all. An
update is when every rank has its share of `train.episodes_per_update`; a rank whose share is full waits.
What only all can decide is decided with an update: to save when rank 0 says so, to stop when any was asked.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from vhs import Outcome
from vhs.acting.actor import Actor
from vhs.acting.episodes import EndedEpisode, Episodes
from vhs.acting.players import AgentPlayer
from vhs.acting.resume import count_episodes, episodes_state, resume_episodes
from vhs.acting.seeds import Seeds, episode_seeds, own_seed
from vhs.acting.setup import check_spec, learn_spec, make_buffer, make_stepping, settled, task_of
from vhs.config import Config
from vhs.interrupt import StopRequest
from vhs.learning.learner import reached_after
from vhs.models import ExtractorFactory
from vhs.runs.checkpoint import fitting, has_checkpoint, load_checkpoint, save_checkpoint
from vhs.runs.directory import fixed_settings
from vhs.runs.window import Window
from vhs.task import Task, TaskSpec, lengthened
from vhs.train.build import make_learner
from vhs.train.exchange import News, collect, packed, unpacked
from vhs.train.log import Log
from vhs.train.start import Start, start
from vhs.world import ALONE, World

_MANY = 100
"""Episodes without a success that are worth a word."""
_CHECK_EVERY = 500
"""Updates between two comparisons of the ranks' weights, beside those before each checkpoint."""


@dataclass(slots=True)
class Progress:
    """Counters of a run; an episode counts once it has been learned from."""

    episodes: int = 0
    env_steps: int = 0
    begun: int = 0
    """Index of this rank's next fresh seed: of one process alone, the seeds begun."""
    logged: int = 0
    """Episodes in whole rows of the log; the row of a stopped run, if shorter, is made again."""
    seconds: float = 0.0
    """Wall-clock of training over all resumptions."""


class Session:
    """One run's parts, from its first episode or from its last checkpoint."""

    def __init__(
        self,
        config: Config,
        run: Path,
        task: Task | None = None,
        spec: TaskSpec | None = None,
        extractor: ExtractorFactory | None = None,
        world: World = ALONE,
    ) -> None:
        """Take up the run in a directory where it stands.

        Args:
            config: as for `train`.
            run: as for `train`.
            task: as for `train`.
            spec: what the task was found to be; None: found here.
            extractor: as for `train`.
            world: the ranks that train it.
        """
        task, streams = task or task_of(config), config.env.num_envs
        spec = spec or learn_spec(config, task)
        config = settled(config, spec)
        self._config, self._run, self._task, self._world = config, run, task, world
        self._extractor = extractor
        self._share = config.train.episodes_per_update // world.size
        self.progress = Progress()
        self.dropped = 0
        """Episodes of the checkpoint, of all ranks, that could not be brought back."""
        self.start: Start | None = None
        """What the run begins with here, if another one learned that."""
        self.stop = StopRequest()
        """Whether this process was asked to stop."""
        self._is_stop_agreed = False
        check_spec(config, task, spec, is_own=extractor is not None)
        self._max_steps = spec.max_episode_steps
        task, spec = lengthened(task, spec, config.env.horizon_factor or 1.0)
        self._learner = make_learner(config, spec, extractor, world)
        self._generator = torch.Generator().manual_seed(config.seed)
        self._window = Window(self._max_steps)
        with fitting(run):
            saved = self._restore() if has_checkpoint(run) else []
        if not saved and config.train.start_from is not None:
            self.start = start(config.train.start_from, self._learner)
        self.ranks_before = len(saved)
        """Ranks that made the checkpoint; 0 for a new run."""
        if len(saved) != world.size:
            self._draw_anew(saved)
        # A step while ranks exchange an update may end as many again, beside those that it learns from.
        ending = streams if world.size == 1 else 2 * streams
        self._buffer = make_buffer(config, spec, streams, ending + self._share)
        self._actor = Actor(
            self._learner.agent, streams, dtype=self._learner.dtype, generator=self._generator
        )
        self._first_seed = self.progress.begun
        fresh = episode_seeds(config.seed, first=self._first_seed, stride=world.size)
        self._seeds = Seeds(fresh, config.env.retry_share or 0.0, self._max_steps)
        self._stepping = make_stepping(config, task, spec, streams)
        player = AgentPlayer(self._actor, self._buffer, self._learner.goals.begin)
        self._episodes = Episodes(self._stepping, player, self._buffer, self._seeds)
        self._waiting: deque[EndedEpisode] = deque()
        self._begin(saved)
        # A finished run has nothing to make again.
        self.rows_until = self.progress.episodes if self.is_finished else self.progress.logged
        self._clock = self._row_clock = self._save_clock = time.monotonic()
        self._row_steps = self.progress.env_steps
        self._cut = self._episodes.cut

    @property
    def is_finished(self) -> bool:
        """Whether as many episodes as `train.episodes` have been learned from."""
        return self.progress.episodes >= self._config.train.episodes

    @property
    def is_stopped(self) -> bool:
        """Whether a signal ends the run here: at once of one process alone, else as all agreed."""
        return self._is_stop_agreed or (self._world.size == 1 and self.stop.is_set)

    @property
    def updates(self) -> int:
        """Steps of the optimiser."""
        return self._learner.updates

    @property
    def parameters(self) -> list[torch.nn.Parameter]:
        """What is learned."""
        return list(self._learner.agent.parameters())

    @property
    def keeps_episodes(self) -> bool:
        """Whether the method imitates episodes again."""
        return self._learner.replay is not None

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

    @property
    def parts(self) -> dict[str, tuple[object, str]]:
        """Where the time of a run goes: an object and a method of it, by part; for those who measure."""
        return {
            "environments": (self._stepping, "recv"),
            "acting": (self._actor, "act"),
            "learning": (self._learner, "update"),
        }

    def advance(self, log: Log) -> None:
        """One update where a whole group of episodes is waiting, one step of every environment otherwise.

        Between two calls the run can be saved: see `vhs.acting.resume`.
        """
        if len(self._waiting) < self._share:
            self._step()
            return
        before = self.progress.episodes
        news = self._learn()
        log.advance(self.progress.episodes)
        if len(self._window.episodes) >= self._config.train.log_every:
            self._write_row(log)
            self._doubt(log)
            self._window, self.progress.logged = Window(self._max_steps), self.progress.episodes
        if self._learner.updates % _CHECK_EVERY == 0:
            self.expect_equal_weights()
        every = self._config.train.media_every
        if every is not None and self.progress.episodes // every > before // every:
            self.save(log)
            self._show(log)
        self._is_stop_agreed = news.stop and self._world.size > 1
        if news.save and not self._is_stop_agreed:
            self.save(log)

    def _step(self) -> None:
        self._waiting.extend(self._episodes.step())

    def _learn(self) -> News:
        episodes = [self._waiting.popleft() for _ in range(self._share)]
        ids = np.array([episode.id for episode in episodes], dtype=np.int64)
        goals = torch.stack([e.goal_embedding for e in episodes if e.goal_embedding is not None])
        replay, world = self._learner.replay, self._world
        batch = self._buffer.gather(ids, also=None if replay is None else replay.draw())
        is_late = time.monotonic() - self._save_clock >= self._config.train.checkpoint_every_s
        retries = [self._seeds.ended(episode.seed, episode.outcome, episode.steps) for episode in episodes]
        news = News(
            world,
            episodes,
            retries,
            cut=self._episodes.cut,
            stop=self.stop.is_set or world.is_orphan,
            save=is_late and not world.rank,
        )
        reached = [episode.touched for episode in episodes if episode.touched is not None]
        touched = np.array(reached, dtype=np.int64) if reached else None
        self._window.add_update(
            self._learner.update(batch, goals, touched, along=[news.table], meanwhile=self._step)
        )
        if replay is not None:
            ends = None if touched is None else reached_after(batch, touched)
            replay.collect(self._buffer, batch, ends, np.array(retries))
        collect(world, self._learner.goals, self._buffer, ids, batch, news.successes)
        results = news.results
        self._window.add_episodes(results)
        self.progress.episodes += len(results)
        self.progress.env_steps += sum(result.steps for result in results)
        self._cut = news.cut
        return news

    def _write_row(self, log: Log) -> None:
        log.write(self._row())
        self.rows_until = self.progress.episodes

    def _doubt(self, log: Log) -> None:
        """Say after the first row what should not be: nobody learns from a judge that sees no success."""
        episodes = self._window.episodes
        count = len(episodes)
        if not count == self.progress.episodes >= _MANY:
            return
        if all(episode.outcome != Outcome.SUCCESS for episode in episodes):
            log.say(
                f"none of the first {count} episodes was a success; if one was, `judge` of task "
                f"{self._task.name} does not say so"
            )
        longest = max(episode.steps for episode in episodes)
        may_last = self._buffer.max_episode_steps
        is_timeout = any(episode.outcome == Outcome.TIMEOUT for episode in episodes)
        if is_timeout and longest <= self._max_steps < may_last:
            log.say(
                f"none of the first {count} episodes lasted longer than {longest} steps, where training may "
                f"take {may_last} (env.horizon_factor): task {self._task.name} ends them by itself"
            )

    def _row(self) -> dict[str, Any]:
        now = time.monotonic()
        self._tick(now)
        speed = (self.progress.env_steps - self._row_steps) / max(now - self._row_clock, 1e-9)
        row: dict[str, Any] = {
            "episodes": self.progress.episodes,
            "env_steps": self.progress.env_steps,
            "updates": self._learner.updates,
            "episodes_cut": self._cut,
            "time/minutes": round(self.progress.seconds / 60, 4),
            "speed/steps_per_s": round(speed, 2),
        }
        row |= {f"rate/{name}": rate for name, rate in self._window.rates().items()}
        row |= {f"loss/{name}": value for name, value in self._window.losses().items()}
        row |= {f"goals/{label}": int(count) for label, count in enumerate(self._learner.goals.counts)}
        self._row_clock, self._row_steps = now, self.progress.env_steps
        return row

    def _show(self, log: Log) -> None:
        """Make a film and a picture of goals by the checkpoint just saved: what learns is not touched."""
        from vhs.train.media import make_media

        if not self._world.rank:
            for name, path in make_media(self._run, self._task, self._extractor).items():
                log.show(name, path, self.progress.episodes)

    def finish(self, log: Log) -> None:
        """Save; episodes since the last row get a shorter row of their own, so that the log misses none.

        A run that goes on makes that row again, whole.
        """
        if self.progress.episodes > self.rows_until:
            self._write_row(log)
        self.save(log)

    def save(self, log: Log) -> None:
        """Write a checkpoint, from which the run goes on as if nothing had happened; rank 0 writes it."""
        log.sync()
        self._tick(time.monotonic())
        self.progress.begun = self._first_seed + self._world.size * self._seeds.num_fresh
        self.expect_equal_weights()
        if self._world.rank:
            self._world.gather(packed(self._own_state()))
        else:
            others = [unpacked(state) for state in self._world.gather(b"")[1:]]
            save_checkpoint(
                self._run,
                self.progress.episodes,
                self._state() | ({"ranks": others} if others else {}),
                self._learner.goals.store,
                keep=self._config.train.keep_checkpoints,
            )
        self._save_clock = time.monotonic()

    def _state(self) -> dict[str, Any]:
        """What a checkpoint holds of a process alone, and of rank 0."""
        return {
            "progress": {name: getattr(self.progress, name) for name in Progress.__slots__},
            "learner": self._learner.state_dict(),
            "actions": self._generator.get_state(),
            "window": self._window.state_dict(),
            "settings": fixed_settings(self._config),
            "episodes": episodes_state(self._episodes, self._actor, self._waiting),
            "seeds": self._seeds.state_dict(),
        }

    def _own_state(self) -> dict[str, Any]:
        """What another rank than 0 has for itself."""
        return {
            "begun": self.progress.begun,
            "learner": self._learner.own_state(),
            "actions": self._generator.get_state(),
            "episodes": episodes_state(self._episodes, self._actor, self._waiting),
            "seeds": self._seeds.state_dict(),
        }

    def close(self) -> None:
        """End the environments."""
        self._stepping.close()

    def _restore(self) -> list[dict[str, Any]]:
        """Load everything but the episodes, which need environments.

        Returns:
            What the checkpoint has of the ranks that made it: where their seeds stand, and their episodes.
        """
        state, goal_store = load_checkpoint(self._run)
        rank, size = self._world.rank, self._world.size
        states = [
            {
                "begun": state["progress"]["begun"],
                "episodes": state["episodes"],
                "seeds": state.get("seeds"),
            },
            *state.get("ranks", []),
        ]
        self._learner.load_state_dict(state["learner"])
        self._learner.goals.store = goal_store
        self._generator.set_state(state["actions"])
        self.progress = Progress(**state["progress"])
        self._window.load_state_dict(state["window"])
        if rank and len(states) == size:
            self.progress.begun = states[rank]["begun"]
            self._learner.load_own_state(states[rank]["learner"])
            self._generator.set_state(states[rank]["actions"])
        return states

    def _draw_anew(self, saved: list[dict[str, Any]]) -> None:
        """Take seeds that no rank has had, and at another rank than 0 generators of its own."""
        rank, unused = self._world.rank, max((own["begun"] for own in saved), default=0)
        self.progress.begun = unused + rank
        if rank:
            seed = own_seed(self._config.seed, rank, unused)
            self._generator.manual_seed(seed)
            self._learner.draw_from(seed)

    def _begin(self, saved: list[dict[str, Any]]) -> None:
        """Begin the first episodes, or go on with those of the checkpoint as far as that can be done."""
        rank, is_same = self._world.rank, len(saved) == self._world.size
        states = [own["episodes"] for own in saved]
        if is_same and saved[rank].get("seeds") is not None:  # which no checkpoint of earlier versions has
            self._seeds.load_state_dict(saved[rank]["seeds"])
        if is_same and self._task.replayable:
            self._resume(states[rank])
            return
        self.dropped = sum(map(count_episodes, states))
        ours = [states[rank]] if is_same else states[: len(states) if rank == 0 else 0]
        self._episodes.cut = sum(int(state["rollout"]["cut"]) for state in ours)
        self._episodes.start()

    def _resume(self, state: Mapping[str, Any]) -> None:
        """Bring the waiting and running episodes back."""
        try:
            with fitting(self._run):
                self._waiting = resume_episodes(
                    state, self._episodes, self._actor, next(self._learner.agent.parameters()).device
                )
        except BaseException:
            self._stepping.close()
            raise

    def expect_equal_weights(self) -> None:
        """Compare what all ranks have learned.

        Raises:
            PeerError: it differs; hosts whose processors round otherwise cannot train together.
        """
        if self._world.size > 1:
            self._world.expect_equal(
                {f"weights after update {self._learner.updates}": self._learner.digest()}
            )

    def _tick(self, now: float) -> None:
        self.progress.seconds += now - self._clock
        self._clock = now
