"""Episodes from rooms stepped side by side in this process: the way of one step.

frames -> stacked observation (`EpisodeBuffer.observe`) -> one batched inference (`Actor.act`) -> every room
steps -> frames and rewards back into the buffer -> ended episodes to the caller. Training and evaluation
share it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from torch import Tensor

from vhs import EpisodeBuffer, Outcome
from vhs.train.actor import Actor


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
class _Running:
    seed: int
    goal: int
    interaction: int
    goal_embedding: Tensor
    steps: int = 0
    episode_return: float = 0.0


class Rollout:
    """Steps environments together; each begins its next episode with the next seed, while there is one.

    `begun` counts the episodes begun, and so the seeds taken.
    """

    def __init__(
        self,
        envs: Sequence[gymnasium.Env[Any, Any]],
        actor: Actor,
        buffer: EpisodeBuffer,
        embed_goal: Callable[[int], Tensor],
        seeds: Iterator[int],
    ) -> None:
        """Begin an episode in every environment, as far as the seeds go.

        Args:
            envs: room environments, one a stream of `buffer` and of `actor`.
            actor: chooses actions.
            buffer: takes the frames.
            embed_goal: goal class to goal embedding of shape [feature_dim], called once an episode.
            seeds: one for each episode, taken in the order in which episodes begin.
        """
        self._envs = envs
        self._actor = actor
        self._buffer = buffer
        self._embed_goal = embed_goal
        self._seeds = seeds
        self._running: dict[int, _Running] = {}
        self.begun = 0
        for stream in range(len(envs)):
            self._begin(stream)

    @property
    def is_done(self) -> bool:
        """Whether no episode is running and no seed is left."""
        return not self._running

    def step(self) -> list[EndedEpisode]:
        """Take one action in every running episode.

        Returns:
            The episodes that this step ended, in the order of their streams.
        """
        streams = np.fromiter(self._running, dtype=np.int64)
        actions, values = self._actor.act(streams, self._buffer.observe(streams))
        results = [self._envs[s].step(a) for s, a in zip(streams.tolist(), actions.tolist(), strict=True)]
        frames = np.stack([result[0]["image"] for result in results])
        rewards = np.array([result[1] for result in results], dtype=np.float32)
        self._buffer.append_batch(streams, actions, rewards, values, frames)
        ended = []
        for stream, (_, reward, terminated, truncated, info) in zip(streams.tolist(), results, strict=True):
            episode = self._running[stream]
            episode.steps += 1
            episode.episode_return += float(reward)
            if terminated or truncated:
                ended.append(self._finish(stream, info))
        return ended

    def _begin(self, stream: int) -> None:
        seed = next(self._seeds, None)
        if seed is None:
            self._running.pop(stream, None)
            return
        self.begun += 1
        observation, _ = self._envs[stream].reset(seed=seed)
        goal, interaction = int(observation["goal"]), int(observation["interaction"])
        embedding = self._embed_goal(goal)
        self._buffer.begin(stream, observation["image"], goal, interaction)
        self._actor.begin(stream, embedding, interaction)
        self._running[stream] = _Running(seed, goal, interaction, embedding)

    def _finish(self, stream: int, info: dict[str, Any]) -> EndedEpisode:
        episode = self._running[stream]
        outcome = Outcome.from_name(info["outcome"])
        ended = EndedEpisode(
            id=self._buffer.finish(stream, outcome),
            seed=episode.seed,
            goal=episode.goal,
            interaction=episode.interaction,
            outcome=outcome,
            steps=episode.steps,
            episode_return=episode.episode_return,
            goal_embedding=episode.goal_embedding,
            reached_object=int(info["reached_object"]),
        )
        self._begin(stream)
        return ended


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
