"""Stepping: the seam between those who play episodes and whoever steps the environments.

Commands go out (`reset`, `send`), a batch of steps comes back (`recv`), at most one command of an environment
is under way. In lock-step a `recv` brings the answers to everything that is under way, in the order of the
environments, so what follows does not depend on who stepped them: this process, or any number of workers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vhs.acting.environment import TaskEnv
from vhs.errors import ReplayError

if TYPE_CHECKING:
    from vhs.rollout import Batch, RolloutPool


_GOALS = ("desired_goal", "achieved_goal")


@dataclass(frozen=True, slots=True)
class StepBatch:
    """What some environments showed, a row an environment, in ascending order of their streams."""

    streams: NDArray[np.int64]
    """Which environments, shape [n]."""
    frames: NDArray[Any]
    """Their newest frames, shape [n, *frame_shape]."""
    goals: NDArray[np.int64]
    """Instructed goal classes, shape [n]."""
    interactions: NDArray[np.int64]
    """Instructed interactions, shape [n]."""
    rewards: NDArray[np.float32]
    """Of the step; 0 where the frame is the first of an episode."""
    seeds: list[int]
    """Of the episode that runs."""
    is_first: NDArray[np.bool_]
    """Whether the frame is the first of an episode."""
    is_cut: NDArray[np.bool_]
    """Whether the environment's last episode was lost with its worker; always with `is_first`."""
    terminated: NDArray[np.bool_]
    """Whether the task ended with this step."""
    truncated: NDArray[np.bool_]
    """Whether a limit ended the episode with this step."""
    infos: dict[int, dict[str, Any]]
    """What `TaskEnv` says of ends, by row."""
    desired_goals: NDArray[Any] | None = None
    """The goals told, [n, *frame_shape] or [n, *goal_shape]; None where goals are classes."""
    achieved_goals: NDArray[Any] | None = None
    """The goals reached, [n, *goal_shape], where goals are vectors."""
    fields: Mapping[str, NDArray[Any]] | None = None
    """What observations have beside their frames, by name [n, *shape]; None where they have nothing."""

    @property
    def is_end(self) -> NDArray[np.bool_]:
        """Whether the frame is the last of its episode."""
        return self.terminated | self.truncated


class Stepping(Protocol):
    """A fixed number of environments, numbered from 0."""

    def reset(self, streams: Sequence[int], seeds: Sequence[int]) -> None:
        """Begin an episode in each of `streams`."""
        ...

    def send(self, streams: NDArray[np.int64], actions: NDArray[Any]) -> None:
        """Take one step in each of `streams`, int64 [n]; actions are as `TaskEnv` takes them."""
        ...

    def recv(self) -> StepBatch | None:
        """Wait for steps; there must be a command under way. None where none came for a moment: ask again."""
        ...

    def close(self) -> None:
        """End the environments."""
        ...


class LocalStepping:
    """Environments stepped one after another in this process, when their answers are asked for."""

    def __init__(self, envs: Sequence[TaskEnv]) -> None:
        """Take the environments over."""
        self._envs = envs
        self._seeds = [0] * len(envs)
        # Commands under way, by stream: the action, or None for a reset.
        self._commands: dict[int, Any] = {}
        self.newest: StepBatch | None = None
        """What `recv` gave last, for those who look on; the environments stand where it shows them."""

    def reset(self, streams: Sequence[int], seeds: Sequence[int]) -> None:
        """Begin an episode in each of `streams`."""
        for stream, seed in zip(streams, seeds, strict=True):
            self._seeds[stream] = seed
            self._commands[stream] = None

    def send(self, streams: NDArray[np.int64], actions: NDArray[Any]) -> None:
        """Take one step in each of `streams`."""
        self._commands |= dict(zip(streams.tolist(), actions, strict=True))

    def recv(self) -> StepBatch:
        """Do everything that was commanded since the last call."""
        commands, self._commands = sorted(self._commands.items()), {}
        rows = [self._do(stream, action) for stream, action in commands]
        self.newest = StepBatch(
            streams=np.array([stream for stream, _ in commands], dtype=np.int64),
            frames=np.stack([row[0]["frame"] for row in rows]),
            goals=np.array([row[0]["goal"] for row in rows], dtype=np.int64),
            interactions=np.array([row[0]["interaction"] for row in rows], dtype=np.int64),
            rewards=np.array([row[1] for row in rows], dtype=np.float32),
            seeds=[self._seeds[stream] for stream, _ in commands],
            is_first=np.array([action is None for _, action in commands], dtype=np.bool_),
            is_cut=np.zeros(len(rows), dtype=np.bool_),
            terminated=np.array([row[2] for row in rows], dtype=np.bool_),
            truncated=np.array([row[3] for row in rows], dtype=np.bool_),
            infos={index: row[4] for index, row in enumerate(rows) if row[4]},
            fields=_stacked([row[0].get("fields") for row in rows]),
            **{
                f"{entry}s": np.stack([row[0][entry] for row in rows])
                for entry in _GOALS
                if entry in rows[0][0]
            },
        )
        return self.newest

    def _do(self, stream: int, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        env = self._envs[stream]
        if action is None:
            observation, info = env.reset(seed=self._seeds[stream])
            return observation, 0.0, False, False, info
        observation, reward, terminated, truncated, info = env.step(action)
        return observation, float(reward), terminated, truncated, info

    def close(self) -> None:
        """End the environments."""
        for env in self._envs:
            env.close()


WAIT_S = 0.5
"""How long a `recv` waits before whoever asked may look around, for a signal to stop above all."""


@dataclass(slots=True)
class _Script:
    """What was done in an environment since its reset, so that another worker can do it again."""

    seed: int
    actions: list[int] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    """Of the answered actions."""


class PooledStepping:
    """Environments stepped by the workers of a `RolloutPool` that resets nothing by itself.

    The episode of a worker that died is played again from its seed and actions, so that what follows does not
    depend on who died: `recv` gives the step that was under way, as if nothing had happened.
    """

    def __init__(self, pool: RolloutPool, min_ready: int | None = None, *, can_repeat: bool = True) -> None:
        """Take the pool over.

        Args:
            pool: of `TaskEnv`, made with ``autoreset="Disabled"``: the seed of every episode is chosen here.
            min_ready: answers to wait for; None waits for all (lock-step).
            can_repeat: whether an episode can be played again; if not, one that lost its worker is cut.
        """
        self._pool = pool
        self._min_ready = min_ready
        self._can_repeat = can_repeat
        self._scripts: dict[int, _Script] = {}

    @property
    def pids(self) -> tuple[int | None, ...]:
        """Process of each worker, None where it has ended."""
        return tuple(self._pool.pids)

    def reset(self, streams: Sequence[int], seeds: Sequence[int]) -> None:
        """Begin an episode in each of `streams`."""
        self._scripts |= {stream: _Script(seed) for stream, seed in zip(streams, seeds, strict=True)}
        self._pool.reset(np.array(streams, dtype=np.int64), seeds=seeds)

    def send(self, streams: NDArray[np.int64], actions: NDArray[Any]) -> None:
        """Take one step in each of `streams`."""
        for stream, action in zip(streams.tolist(), actions.tolist(), strict=True):
            self._scripts[stream].actions.append(action)
        self._pool.send(actions, streams)

    def recv(self) -> StepBatch | None:
        """Wait for as many answers as were asked for, and take all there are; None after `WAIT_S` without.

        Raises:
            ReplayError: a worker died, and its episode did not go as before when it was played again.
        """
        wanted = None if self._min_ready is None else min(self._min_ready, self._pool.num_under_way)
        try:
            batch = _step_batch(self._pool.recv(wanted, timeout=WAIT_S))
        except TimeoutError:
            return None
        if self._can_repeat and batch.is_cut.any():
            batch = self._repaired(batch)
        for row in np.flatnonzero(~batch.is_first).tolist():
            self._scripts[int(batch.streams[row])].rewards.append(float(batch.rewards[row]))
        return batch

    def _repaired(self, batch: StepBatch) -> StepBatch:
        """The same batch with the answers that the dead workers owed, from others."""
        answers = {
            int(stream): (batch, row) for row, stream in enumerate(batch.streams) if not batch.is_cut[row]
        }
        # Actions that were played again, by stream.
        played = dict.fromkeys(batch.streams[batch.is_cut].tolist(), 0)
        self._begin_again(list(played))
        while played:
            batch = _step_batch(self._pool.recv(1))
            for row, stream in enumerate(batch.streams.tolist()):
                if stream not in played:
                    answers[stream] = (batch, row)
                elif batch.is_cut[row]:
                    played[stream] = 0
                    self._begin_again([stream])
                elif played[stream] == len(self._scripts[stream].actions):
                    answers[stream] = (batch, row)
                    del played[stream]
                else:
                    self._check(stream, played[stream], batch, row)
                    action = self._scripts[stream].actions[played[stream]]
                    self._pool.send(np.array([action]), np.array([stream]))
                    played[stream] += 1
        return _joined([answers[stream] for stream in sorted(answers)])

    def _begin_again(self, streams: list[int]) -> None:
        seeds = [self._scripts[stream].seed for stream in streams]
        self._pool.reset(np.array(streams, dtype=np.int64), seeds=seeds)

    def _check(self, stream: int, step: int, batch: StepBatch, row: int) -> None:
        """Check that the newest of `step` actions that were played again went as before."""
        script, is_end = self._scripts[stream], bool(batch.is_end[row])
        if is_end or (step and float(batch.rewards[row]) != script.rewards[step - 1]):
            expected = "that it goes on" if is_end else f"reward {script.rewards[step - 1]}"
            found = "its end" if is_end else f"{float(batch.rewards[row])}"
            raise ReplayError(
                f"a worker died; playing its episode of seed {script.seed} again: expected {expected} after "
                f"{step} steps, found {found}; the environment does not repeat an episode from its seed and "
                "actions"
            )

    def close(self) -> None:
        """End the workers."""
        self._pool.close()


def _step_batch(batch: Batch) -> StepBatch:
    """What a pool received, in our words."""
    observation = batch.observation
    return StepBatch(
        streams=batch.env_ids,
        frames=observation["frame"],
        goals=observation["goal"],
        interactions=observation["interaction"],
        rewards=batch.rewards.astype(np.float32),
        seeds=batch.seeds.tolist(),
        is_first=batch.is_first,
        is_cut=batch.is_cut,
        terminated=batch.terminated,
        truncated=batch.truncated,
        infos=batch.infos,
        fields=observation.get("fields"),
        **{f"{entry}s": observation[entry] for entry in _GOALS if entry in observation},
    )


def _joined(rows: Sequence[tuple[StepBatch, int]]) -> StepBatch:
    """A batch of rows of others, in the given order."""
    arrays = {
        name: np.array([getattr(batch, name)[row] for batch, row in rows])
        for name in (each.name for each in fields(StepBatch))
        if name not in ("seeds", "infos", "fields") and getattr(rows[0][0], name) is not None
    }
    return StepBatch(
        **arrays,
        seeds=[batch.seeds[row] for batch, row in rows],
        infos={at: batch.infos[row] for at, (batch, row) in enumerate(rows) if row in batch.infos},
        fields=_stacked(
            [
                None if batch.fields is None else {name: part[row] for name, part in batch.fields.items()}
                for batch, row in rows
            ]
        ),
    )


def _stacked(rows: Sequence[Mapping[str, NDArray[Any]] | None]) -> dict[str, NDArray[Any]] | None:
    """The fields of some observations, a row each."""
    told = [row for row in rows if row is not None]
    return {name: np.stack([row[name] for row in told]) for name in told[0]} if told else None
