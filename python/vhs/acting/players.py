"""Who chooses the actions of episodes: the agent or chance; `vhs.acting.resume` plays them once more."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBuffer
from vhs.acting.actor import Actor
from vhs.buffer import beside
from vhs.learning.goals import Told
from vhs.task import TaskSpec

Choice = tuple[NDArray[np.int64], NDArray[Any], NDArray[np.float32]]
"""Streams, the action of each, int64 [n] or float32 [n, dim], and the critic's value when it was chosen, 0
without a critic."""


class Player(Protocol):
    """Chooses what is done in every stream."""

    def begin(self, stream: int, goal: Told, interaction: int) -> Tensor | None:
        """Take the instruction of an episode that begins: a goal class, a picture or a vector.

        Returns:
            The goal embedding that it is acted under, shape [feature_dim], where there is one.
        """
        ...

    def act(self, streams: NDArray[np.int64]) -> Choice:
        """Choose actions in some of `streams`; the others rest until they are asked again."""
        ...


class AgentPlayer:
    """The agent, told each goal as an embedding."""

    def __init__(self, actor: Actor, buffer: EpisodeBuffer, embed_goal: Callable[[Told], Tensor]) -> None:
        """Join the parts.

        Args:
            actor: as many streams as `buffer`.
            buffer: has the observations.
            embed_goal: what is told to goal embedding of shape [feature_dim], called once an episode.
        """
        self._actor, self._buffer, self._embed_goal = actor, buffer, embed_goal

    def begin(self, stream: int, goal: Told, interaction: int) -> Tensor:
        """Embed the goal and forget the stream's last episode."""
        embedding = self._embed_goal(goal)
        self._actor.begin(stream, embedding, interaction)
        return embedding

    def act(self, streams: NDArray[np.int64]) -> Choice:
        """One inference for all."""
        known = beside(self._buffer.observe_fields(streams)) if self._buffer.fields else None
        actions, values = self._actor.act(streams, self._buffer.observe(streams), known)
        return streams, actions, values


class RandomPlayer:
    """Uniformly random actions."""

    def __init__(self, spec: TaskSpec, rng: np.random.Generator) -> None:
        """Draw from `rng` what a task can be told to do."""
        self._spec, self._rng = spec, rng

    def begin(self, stream: int, goal: Told, interaction: int) -> None:
        """Instructions do not matter."""

    def act(self, streams: NDArray[np.int64]) -> Choice:
        """An action for every stream."""
        count, dim = len(streams), self._spec.action_dim
        if dim:
            actions: NDArray[Any] = self._rng.uniform(-1, 1, (count, dim)).astype(np.float32)
        else:
            actions = self._rng.integers(self._spec.num_actions, size=count)
        return streams, actions, np.zeros(count, np.float32)
