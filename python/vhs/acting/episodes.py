"""Episodes in many environments: the one loop that steps, whoever plays.

steps of the environments -> frames and rewards into the buffer -> actions by a `Player` -> back to the
environments; ended episodes to the caller. Training, evaluation, resuming, films and measurements share it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBuffer, Outcome
from vhs.acting.players import Player
from vhs.acting.stepping import StepBatch, Stepping
from vhs.buffer import as_goal

Action = int | list[float]
"""A number, or the numbers of a continuous action."""


@dataclass(frozen=True, slots=True)
class EndedEpisode:
    """What is known of an episode at its end; its frames are in the buffer under `id`."""

    id: int
    stream: int
    """Where it was played."""
    seed: int
    goal: int
    interaction: int
    outcome: Outcome
    steps: int
    episode_return: float
    """Sum of the rewards, undiscounted and unscaled."""
    goal_embedding: Tensor | None = None
    """The embedding it was acted under, shape [feature_dim]; None where no agent acted."""
    touched: int | None = None
    """Steps until something was last reached, 0 where nothing was; None where the task does not say."""
    reached: int | None = None
    """Goal class that was reached, -1 for none; for evaluation only, None where the task does not say."""
    metrics: Mapping[str, float] = field(default_factory=dict)
    """Further numbers that the task says of its end, for evaluation only."""


@dataclass(slots=True)
class Running:
    """An episode that has begun; an environment given its seed and actions repeats it bit for bit."""

    seed: int
    goal: int
    interaction: int
    goal_embedding: Tensor | None
    actions: list[Action] = field(default_factory=list)
    """Taken and answered; the one under way is not among them."""
    values: list[float] = field(default_factory=list)
    """The critic's, of each of the actions."""
    episode_return: float = 0.0

    def add(self, action: Action, value: float, reward: float) -> None:
        """Take the answer to an action."""
        self.actions.append(action)
        self.values.append(value)
        self.episode_return += reward

    def ended(self, id: int, stream: int, info: Mapping[str, Any]) -> EndedEpisode:
        """The same episode at its end, of which `TaskEnv` says `info`, stored in the buffer under `id`."""
        return EndedEpisode(
            id=id,
            stream=stream,
            seed=self.seed,
            goal=self.goal,
            interaction=self.interaction,
            outcome=Outcome(info["outcome"]),
            steps=len(self.actions),
            episode_return=self.episode_return,
            goal_embedding=self.goal_embedding,
            touched=info.get("touched"),
            reached=info.get("reached"),
            metrics=info.get("metrics", {}),
        )

    def as_dict(self) -> dict[str, Any]:
        """The fields by name, lists copied; ``Running(**fields)`` reads them back."""
        fields = {name: getattr(self, name) for name in self.__slots__}
        return fields | {"actions": list(self.actions), "values": list(self.values)}


class Episodes:
    """Plays episodes in many environments; each begins its next one with the next seed, if there is one."""

    def __init__(
        self, stepping: Stepping, player: Player, buffer: EpisodeBuffer, seeds: Iterable[int] = ()
    ) -> None:
        """Join the parts; nothing begins before `start`, `begin` or `resume`.

        Args:
            stepping: steps the environments, one a stream of `buffer`.
            player: chooses actions.
            buffer: takes the frames.
            seeds: one for each episode, taken in the order in which episodes begin.
        """
        self.stepping = stepping
        self.buffer = buffer
        self._player = player
        self._seeds: Iterator[int] = iter(seeds)
        self._running: dict[int, Running] = {}
        # Seeds of the episodes whose first frame is under way.
        self._beginning: dict[int, int] = {}
        # The action under way in each environment, and the critic's value when it was chosen.
        count, dim = buffer.num_streams, buffer.action_dim
        self._actions: NDArray[Any] = np.zeros((count, dim), np.float32) if dim else np.zeros(count, np.int64)
        self._values = np.zeros(buffer.num_streams, dtype=np.float32)
        self.under_way = 0
        """Commands that are not answered yet."""
        self.cut = 0
        """Episodes that were lost with their worker."""
        self.steps = 0
        """Steps taken; a reset is none."""

    @property
    def is_done(self) -> bool:
        """Whether no episode is running or beginning, and so no seed is left."""
        return not self.under_way and not self._running

    @property
    def running(self) -> Mapping[int, Running]:
        """The episodes under way, by stream; those whose first frame is under way are not among them."""
        return self._running

    def chosen(self, stream: int) -> tuple[Action, float]:
        """The action under way in a stream, and the critic's value when it was chosen."""
        return self._actions[stream].tolist(), float(self._values[stream])

    def start(self) -> None:
        """Begin an episode in every environment, as far as the seeds go."""
        self._next(range(self.buffer.num_streams))

    def begin(self, seeds: Mapping[int, int]) -> None:
        """Begin an episode of a given seed in each of some streams, which are at rest."""
        if seeds:
            self._beginning |= seeds
            self.under_way += len(seeds)
            self.stepping.reset(list(seeds), list(seeds.values()))

    def step(self) -> list[EndedEpisode]:
        """Take what the environments have answered, and send them their next commands.

        Workers are busy when this returns: what the caller does next overlaps with them.

        Returns:
            The episodes that ended, in the order of their streams; none where no answer came for a moment.
        """
        batch = self.stepping.recv()
        if batch is None:
            return []
        self.under_way -= len(batch.streams)
        self._open(batch)
        self._append(batch)
        rows = np.flatnonzero(batch.is_end).tolist()
        ended = [self._finish(batch, row) for row in rows]
        self._next([int(batch.streams[row]) for row in rows])
        self.act(batch.streams[~batch.is_end])
        return ended

    def act(self, streams: NDArray[np.int64]) -> None:
        """Let the player choose in some streams that have no command under way; `step` does so by itself."""
        if not len(streams):
            return
        streams, actions, values = self._player.act(streams)
        self._actions[streams], self._values[streams] = actions, values
        self._send(streams)

    def state_dict(self) -> dict[str, Any]:
        """What `resume` needs, between two steps: all but the frames, which environments can repeat."""
        return {
            "cut": self.cut,
            "beginning": dict(self._beginning),
            "running": {stream: episode.as_dict() for stream, episode in self._running.items()},
            "actions": torch.from_numpy(self._actions.copy()),
            "values": torch.from_numpy(self._values.copy()),
        }

    def resume(self, state: Mapping[str, Any], running: Mapping[int, Running]) -> None:
        """Go on from a state that `state_dict` gave, instead of `start`.

        Args:
            state: what `state_dict` gave.
            running: the running episodes, by stream; environments and buffer are where the last answered
                action of each has brought them.
        """
        self.cut = int(state["cut"])
        self._running = dict(running)
        self._actions[:], self._values[:] = state["actions"].numpy(), state["values"].numpy()
        self.begin(dict(state["beginning"]))
        self._send(np.array(sorted(running), dtype=np.int64))

    def _next(self, streams: Iterable[int]) -> None:
        seeds = dict(zip(streams, self._seeds, strict=False))
        self.begin(seeds)

    def _send(self, streams: NDArray[np.int64]) -> None:
        """Take the chosen action in each of some streams."""
        if len(streams):
            self.under_way += len(streams)
            self.stepping.send(streams, self._actions[streams])

    def _open(self, batch: StepBatch) -> None:
        for row in np.flatnonzero(batch.is_first).tolist():
            stream = int(batch.streams[row])
            if batch.is_cut[row] and self._running.pop(stream, None) is not None:
                self.buffer.abort(stream)
                self.cut += 1
            self._beginning.pop(stream, None)
            goal, interaction = int(batch.goals[row]), int(batch.interactions[row])
            desired, achieved = _row(batch.desired_goals, row), _row(batch.achieved_goals, row)
            if desired is not None:
                desired = as_goal(self.buffer, desired)
            embedding = self._player.begin(stream, goal if desired is None else desired, interaction)
            self.buffer.begin(
                stream,
                batch.frames[row],
                goal,
                interaction,
                desired_goal=desired,
                achieved_goal=achieved,
                fields=_fields(batch, row),
            )
            self._running[stream] = Running(batch.seeds[row], goal, interaction, embedding)

    def _append(self, batch: StepBatch) -> None:
        rows = np.flatnonzero(~batch.is_first)
        if not len(rows):
            return
        self.steps += len(rows)
        streams = batch.streams[rows]
        actions, values, rewards = self._actions[streams], self._values[streams], batch.rewards[rows]
        achieved = _row(batch.achieved_goals, rows)
        self.buffer.append_batch(
            streams,
            actions,
            rewards,
            values,
            batch.frames[rows],
            achieved_goals=achieved,
            fields=_fields(batch, rows),
        )
        steps = zip(streams.tolist(), actions.tolist(), values.tolist(), rewards.tolist(), strict=True)
        for stream, action, value, reward in steps:
            self._running[stream].add(action, value, reward)

    def _finish(self, batch: StepBatch, row: int) -> EndedEpisode:
        stream, info = int(batch.streams[row]), batch.infos[row]
        outcome = Outcome(info["outcome"])
        id = self.buffer.finish(stream, outcome, terminated=bool(batch.terminated[row]))
        return self._running.pop(stream).ended(id, stream, info)


def _fields(batch: StepBatch, rows: Any) -> dict[str, NDArray[Any]] | None:
    return None if batch.fields is None else {name: part[rows] for name, part in batch.fields.items()}


def _row(goals: NDArray[Any] | None, rows: Any) -> NDArray[Any] | None:
    return None if goals is None else goals[rows]
