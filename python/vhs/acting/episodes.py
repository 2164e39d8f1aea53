"""Episodes from many rooms: the way of one step.

answers of the rooms -> frames and rewards into the buffer -> stacked observations (`EpisodeBuffer.observe`)
-> one batched inference (`Actor.act`) -> actions to the rooms; ended episodes to the caller. Training and
evaluation share it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBuffer, Outcome
from vhs.acting.actor import Actor
from vhs.acting.stepping import Answers, Rooms


@dataclass(frozen=True, slots=True)
class EndedEpisode:
    """What is known of an episode at its end; its frames are in the buffer under `id`."""

    id: int
    seed: int
    goal: int
    interaction: int
    outcome: Outcome
    steps: int
    episode_return: float
    """Sum of the rewards, undiscounted and unscaled."""
    goal_embedding: Tensor
    """The embedding it was acted under, shape [feature_dim]."""
    reached_object: int
    """For evaluation only: the agent does not know it."""


@dataclass(slots=True)
class Running:
    """An episode that has begun; a room that is given its seed and its actions repeats it bit for bit."""

    seed: int
    goal: int
    interaction: int
    goal_embedding: Tensor
    actions: list[int] = field(default_factory=list)
    """Taken and answered; the one under way is not among them."""
    values: list[float] = field(default_factory=list)
    """The critic's, of each of the actions."""
    episode_return: float = 0.0

    def add(self, action: int, value: float, reward: float) -> None:
        """Take the answer to an action."""
        self.actions.append(action)
        self.values.append(value)
        self.episode_return += reward

    def ended(self, id: int, outcome: Outcome, reached_object: int) -> EndedEpisode:
        """The same episode at its end, stored in the buffer under `id`."""
        return EndedEpisode(
            id=id,
            seed=self.seed,
            goal=self.goal,
            interaction=self.interaction,
            outcome=outcome,
            steps=len(self.actions),
            episode_return=self.episode_return,
            goal_embedding=self.goal_embedding,
            reached_object=reached_object,
        )

    def as_dict(self) -> dict[str, Any]:
        """The fields by name, lists copied; ``Running(**fields)`` reads them back."""
        fields = {name: getattr(self, name) for name in self.__slots__}
        return fields | {"actions": list(self.actions), "values": list(self.values)}


class Rollout:
    """Plays episodes in many rooms; a room begins its next one with the next seed, while there is one.

    `begun` counts the seeds taken, `cut` the episodes that were lost with their worker.
    """

    def __init__(
        self,
        rooms: Rooms,
        num_streams: int,
        actor: Actor,
        buffer: EpisodeBuffer,
        embed_goal: Callable[[int], Tensor],
        seeds: Iterator[int],
        *,
        begin: bool = True,
    ) -> None:
        """Begin an episode in every room, as far as the seeds go.

        Args:
            rooms: who steps the environments, one a stream of `buffer` and of `actor`.
            num_streams: how many there are.
            actor: chooses actions.
            buffer: takes the frames.
            embed_goal: goal class to goal embedding of shape [feature_dim], called once an episode.
            seeds: one for each episode, taken in the order in which episodes begin.
            begin: False leaves the rooms at rest, for `resume`.
        """
        self._rooms = rooms
        self._actor = actor
        self._buffer = buffer
        self._embed_goal = embed_goal
        self._seeds = seeds
        self._running: dict[int, Running] = {}
        # Seeds of the episodes whose first frame is under way.
        self._beginning: dict[int, int] = {}
        # The action under way in each room, and the critic's value when it was chosen.
        self._actions = np.zeros(num_streams, dtype=np.int64)
        self._values = np.zeros(num_streams, dtype=np.float32)
        self._under_way = 0
        self.begun = 0
        self.cut = 0
        if begin:
            self._reset(range(num_streams))

    @property
    def is_done(self) -> bool:
        """Whether no episode is running and no seed is left."""
        return self._under_way == 0

    def step(self) -> list[EndedEpisode]:
        """Take what the rooms have answered, and send them their next commands.

        The rooms are at work when this returns: what the caller does next overlaps with it.

        Returns:
            The episodes that ended, in the order of their streams.
        """
        answers = self._rooms.recv()
        self._under_way -= len(answers.streams)
        self._begin(answers)
        self._append(answers)
        rows = np.flatnonzero(answers.is_end).tolist()
        ended = [self._finish(int(answers.streams[row]), answers.infos[row]) for row in rows]
        self._reset([int(answers.streams[row]) for row in rows])
        self._act(answers.streams[~answers.is_end])
        return ended

    def state_dict(self) -> dict[str, Any]:
        """What `resume` needs, between two steps: all but the frames, which the rooms can repeat."""
        return {
            "cut": self.cut,
            "beginning": dict(self._beginning),
            "running": {stream: episode.as_dict() for stream, episode in self._running.items()},
            "actions": torch.from_numpy(self._actions.copy()),
            "values": torch.from_numpy(self._values.copy()),
            "actor": self._actor.state_dict(),
        }

    def resume(self, state: dict[str, Any], running: dict[int, Running]) -> None:
        """Go on from a state that `state_dict` gave; the rollout was made with ``begin=False``.

        Args:
            state: what `state_dict` gave.
            running: the running episodes, by stream; rooms and buffer are where the last answered action of
                each has brought them.
        """
        self.cut = int(state["cut"])
        self._running = dict(running)
        self._actions[:], self._values[:] = state["actions"].numpy(), state["values"].numpy()
        self._actor.load_state_dict(state["actor"])
        self._command_resets(dict(state["beginning"]))
        streams = np.array(sorted(running), dtype=np.int64)
        self._command_actions(streams)

    def _reset(self, streams: Iterable[int]) -> None:
        seeds = dict(zip(streams, self._seeds, strict=False))
        self.begun += len(seeds)
        self._command_resets(seeds)

    def _command_resets(self, seeds: dict[int, int]) -> None:
        """Begin an episode in each of some rooms, by stream."""
        if seeds:
            self._beginning |= seeds
            self._under_way += len(seeds)
            self._rooms.reset(list(seeds), list(seeds.values()))

    def _command_actions(self, streams: NDArray[np.int64]) -> None:
        """Take the chosen action in each of some rooms."""
        if len(streams):
            self._under_way += len(streams)
            self._rooms.send(streams, self._actions[streams])

    def _begin(self, answers: Answers) -> None:
        for row in np.flatnonzero(answers.is_first).tolist():
            stream = int(answers.streams[row])
            if answers.is_cut[row] and self._running.pop(stream, None) is not None:
                self._buffer.abort(stream)
                self.cut += 1
            self._beginning.pop(stream, None)
            goal, interaction = int(answers.goals[row]), int(answers.interactions[row])
            embedding = self._embed_goal(goal)
            self._buffer.begin(stream, answers.images[row], goal, interaction)
            self._actor.begin(stream, embedding, interaction)
            self._running[stream] = Running(answers.seeds[row], goal, interaction, embedding)

    def _append(self, answers: Answers) -> None:
        rows = np.flatnonzero(~answers.is_first)
        if not len(rows):
            return
        streams = answers.streams[rows]
        actions, values, rewards = self._actions[streams], self._values[streams], answers.rewards[rows]
        self._buffer.append_batch(streams, actions, rewards, values, answers.images[rows])
        steps = zip(streams.tolist(), actions.tolist(), values.tolist(), rewards.tolist(), strict=True)
        for stream, action, value, reward in steps:
            self._running[stream].add(action, value, reward)

    def _act(self, streams: NDArray[np.int64]) -> None:
        if not len(streams):
            return
        actions, values = self._actor.act(streams, self._buffer.observe(streams))
        self._actions[streams], self._values[streams] = actions, values
        self._command_actions(streams)

    def _finish(self, stream: int, info: dict[str, Any]) -> EndedEpisode:
        outcome = Outcome.from_name(info["outcome"])
        id = self._buffer.finish(stream, outcome)
        return self._running.pop(stream).ended(id, outcome, int(info["reached_object"]))


def episode_seeds(run_seed: int, *, first: int = 0, purpose: int = 0) -> Iterator[int]:
    """Independent seeds for the episodes of a run, without end.

    Args:
        run_seed: the one seed that the user gives.
        first: index of the first episode wanted, so that a resumed run goes on where it stopped.
        purpose: 0 for training, 1 for evaluation: the same run seed never gives the same rooms to both.
    """
    index = first
    while True:
        yield int(np.random.SeedSequence((run_seed, purpose, index)).generate_state(1)[0])
        index += 1
