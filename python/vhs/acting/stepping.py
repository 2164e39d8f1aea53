"""Rooms that answer: the seam between the rollout and whoever steps the environments.

Commands go out (`reset`, `send`), answers come back (`recv`), at most one command of a room is under way. In
lock-step a `recv` brings the answers to everything that is under way, in the order of the rooms, so what
follows does not depend on who stepped them: this process, or any number of workers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from vhs.rollout import RolloutPool


@dataclass(frozen=True, slots=True)
class Answers:
    """What some rooms showed, a row a room, in ascending order of the rooms."""

    streams: NDArray[np.int64]
    """Which rooms, shape [n]."""
    images: NDArray[np.uint8]
    """Their newest frames, shape [n, height, width, colours]."""
    goals: NDArray[np.int64]
    interactions: NDArray[np.int64]
    rewards: NDArray[np.float32]
    """Of the step; 0 where the frame is the first of an episode."""
    seeds: list[int]
    """Of the episode that runs."""
    is_first: NDArray[np.bool_]
    """Whether the frame is the first of an episode."""
    is_cut: NDArray[np.bool_]
    """Whether the room's last episode was lost with its worker; always with `is_first`."""
    is_end: NDArray[np.bool_]
    """Whether the frame is the last of its episode."""
    infos: dict[int, dict[str, Any]]
    """`info` by row, where the room gave one."""


class Rooms(Protocol):
    """A fixed number of rooms, numbered from 0."""

    def reset(self, streams: Sequence[int], seeds: Sequence[int]) -> None:
        """Begin an episode in each of `streams`."""
        ...

    def send(self, streams: NDArray[np.int64], actions: NDArray[np.int64]) -> None:
        """Take one step in each of `streams`, both of shape [n]."""
        ...

    def recv(self) -> Answers:
        """Wait for answers; there must be a command under way."""
        ...

    def close(self) -> None:
        """End the rooms."""
        ...


class LocalRooms:
    """Rooms stepped one after another in this process."""

    def __init__(self, envs: Sequence[gymnasium.Env[Any, Any]]) -> None:
        """Take the environments over."""
        self._envs = envs
        self._seeds = [0] * len(envs)
        self._answers: dict[int, tuple[dict[str, Any], float, bool, bool, dict[str, Any]]] = {}

    def reset(self, streams: Sequence[int], seeds: Sequence[int]) -> None:
        """Begin an episode in each of `streams`."""
        for stream, seed in zip(streams, seeds, strict=True):
            observation, info = self._envs[stream].reset(seed=seed)
            self._seeds[stream] = seed
            self._answers[stream] = (observation, 0.0, True, False, info)

    def send(self, streams: NDArray[np.int64], actions: NDArray[np.int64]) -> None:
        """Take one step in each of `streams`."""
        for stream, action in zip(streams.tolist(), actions.tolist(), strict=True):
            observation, reward, terminated, truncated, info = self._envs[stream].step(action)
            self._answers[stream] = (observation, float(reward), False, terminated or truncated, info)

    def recv(self) -> Answers:
        """Everything since the last call."""
        streams = sorted(self._answers)
        rows = [self._answers.pop(stream) for stream in streams]
        return Answers(
            streams=np.array(streams, dtype=np.int64),
            images=np.stack([row[0]["image"] for row in rows]),
            goals=np.array([row[0]["goal"] for row in rows], dtype=np.int64),
            interactions=np.array([row[0]["interaction"] for row in rows], dtype=np.int64),
            rewards=np.array([row[1] for row in rows], dtype=np.float32),
            seeds=[self._seeds[stream] for stream in streams],
            is_first=np.array([row[2] for row in rows], dtype=np.bool_),
            is_cut=np.zeros(len(rows), dtype=np.bool_),
            is_end=np.array([row[3] for row in rows], dtype=np.bool_),
            infos={index: row[4] for index, row in enumerate(rows) if row[4]},
        )

    def close(self) -> None:
        """End the environments."""
        for env in self._envs:
            env.close()


class PooledRooms:
    """Rooms stepped by the workers of a `RolloutPool` that resets nothing by itself."""

    def __init__(self, pool: RolloutPool, min_ready: int | None) -> None:
        """Take the pool over.

        Args:
            pool: made with ``autoreset="Disabled"``: the seed of every episode is the rollout's to choose.
            min_ready: answers to wait for; None waits for all (lock-step).
        """
        self._pool = pool
        self._min_ready = min_ready

    def reset(self, streams: Sequence[int], seeds: Sequence[int]) -> None:
        """Begin an episode in each of `streams`."""
        self._pool.reset(np.array(streams, dtype=np.int64), seeds=seeds)

    def send(self, streams: NDArray[np.int64], actions: NDArray[np.int64]) -> None:
        """Take one step in each of `streams`."""
        self._pool.send(actions, streams)

    def recv(self) -> Answers:
        """Wait for as many answers as were asked for, and take all there are."""
        wanted = None if self._min_ready is None else min(self._min_ready, self._pool.num_under_way)
        batch = self._pool.recv(wanted)
        observation = batch.observation
        return Answers(
            streams=batch.env_ids,
            images=observation["image"],
            goals=observation["goal"],
            interactions=observation["interaction"],
            rewards=batch.rewards.astype(np.float32),
            seeds=batch.seeds.tolist(),
            is_first=batch.is_first,
            is_cut=batch.is_cut,
            is_end=batch.terminated | batch.truncated,
            infos=batch.infos,
        )

    def close(self) -> None:
        """End the workers."""
        self._pool.close()
