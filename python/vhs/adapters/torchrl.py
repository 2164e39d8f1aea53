"""A `RolloutPool` as a batched environment of TorchRL."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, MultiCategorical, Unbounded
from torchrl.envs import EnvBase

from vhs._core import ArgumentError
from vhs.rollout.options import EnvFn
from vhs.rollout.pool import RolloutPool

__all__ = ["PoolEnv"]


class PoolEnv(EnvBase):  # type: ignore[misc] # torchrl ships no types
    """Environments in worker processes, of batch size [num_envs], as TorchRL's `ParallelEnv`.

    Observations that are dictionaries have an entry each, others are "observation"; numbered actions are
    `Categorical`, counted from 0. Some of the environments are reset and stepped alone where "_reset" and
    "_step" say so. An episode that was cut (its worker died, or it showed a NaN) is truncated, with reward 0
    and what was seen last.
    """

    batch_locked = True

    def __init__(
        self,
        env_fn: EnvFn | Sequence[EnvFn],
        num_workers: int,
        envs_per_worker: int = 1,
        *,
        device: torch.device | str = "cpu",
        **pool: Any,
    ) -> None:
        """Start the workers.

        Args:
            env_fn: Makes an environment of gymnasium, in its worker; or one such function for each
                environment.
            num_workers: Processes.
            envs_per_worker: Environments that each of them steps.
            device: Where what was observed goes.
            pool: Further arguments of `RolloutPool`; `on_error` may be "raise" or "restart". TorchRL tells
                `multiprocessing` to spawn; here workers are forked unless `start_method="spawn"`.

        Raises:
            ArgumentError: For spaces that TorchRL's specs of fixed shape do not describe, or an argument out
                of range.
            Exception: As `RolloutPool`.
        """
        if pool.get("on_error") == "drop":
            raise ArgumentError("on_error: expected 'raise' or 'restart', got 'drop': a batch keeps its size")
        how = {"start_method": "fork", "autoreset": "Disabled", **pool}
        self.__dict__["pool"] = RolloutPool(env_fn, num_workers, envs_per_worker, **how)
        try:
            self._set_up(torch.device(device))
        except BaseException:
            self.pool.close()
            raise

    def _set_up(self, device: torch.device) -> None:
        n = self.pool.num_envs
        super().__init__(device=device, batch_size=torch.Size([n]))
        seen, done = self.pool.single_observation_space, self.pool.single_action_space
        self._is_flat = not isinstance(seen, spaces.Dict)
        parts = {"observation": seen} if self._is_flat else dict(seen.spaces)
        entries = {key: _spec("observation_space", part, n, device) for key, part in parts.items()}
        self.observation_spec = Composite(entries, shape=(n,), device=device)
        self.action_spec = _spec("action_space", done, n, device)
        self.reward_spec = Unbounded((n, 1), device=device, dtype=torch.float32)
        ends = {
            key: Categorical(2, (n, 1), device, torch.bool) for key in ("done", "terminated", "truncated")
        }
        self.done_spec = Composite(ends, shape=(n,), device=device)
        self._first_action = int(done.start) if isinstance(done, spaces.Discrete) else 0
        self._shown: dict[str, NDArray[Any]] = {}
        self._ends = np.zeros((2, n), np.bool_)
        """Terminated and truncated, as last shown."""

    def _reset(self, tensordict: TensorDictBase | None = None, **options: Any) -> TensorDictBase:
        ids = self._asked(tensordict, "_reset")
        self.pool.reset(ids, options=options or None)
        self._receive(ids)
        return self._as_shown()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        ids = self._asked(tensordict, "_step")
        actions = tensordict["action"].cpu().numpy()[ids]
        self.pool.send(actions + self._first_action if self._first_action else actions, ids)
        rewards = np.zeros((self.pool.num_envs, 1), np.float32)
        rewards[ids, 0] = self._receive(ids)
        shown = self._as_shown()
        return shown.set("reward", torch.from_numpy(rewards).to(self.device))

    def _asked(self, tensordict: TensorDictBase | None, key: str) -> NDArray[np.int64]:
        """The environments that a mask names; all where there is none."""
        mask = None if tensordict is None else tensordict.get(key, None)
        if mask is None:
            return np.arange(self.pool.num_envs)
        return np.flatnonzero(mask.cpu().numpy())

    def _receive(self, ids: NDArray[np.int64]) -> NDArray[np.float64]:
        """Take the answers of these environments; rewards [len(ids)]."""
        batch = self.pool.recv()
        seen = {"observation": batch.observation} if self._is_flat else batch.observation
        kept = np.flatnonzero(~batch.is_cut) if self._shown else np.arange(len(ids))
        if len(kept) == self.pool.num_envs:
            self._shown = {key: np.asarray(entry) for key, entry in seen.items()}
        else:
            self._shown = {key: _merged(self._shown[key], ids[kept], seen[key][kept]) for key in seen}
        self._ends = self._ends.copy()
        self._ends[0, ids], self._ends[1, ids] = batch.terminated, batch.truncated | batch.is_cut
        rewards: NDArray[np.float64] = batch.rewards
        return rewards

    def _as_shown(self) -> TensorDict:
        shown = {key: torch.from_numpy(entry) for key, entry in self._shown.items()}
        terminated, truncated = torch.from_numpy(self._ends)[..., None]
        shown |= {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}
        made = TensorDict(shown, batch_size=self.batch_size)
        return made.to(self.device)

    def _set_seed(self, seed: int | None) -> None:
        self.pool.reseed(seed)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """End the workers."""
        super().close(raise_if_closed=raise_if_closed)
        self.pool.close()


def _merged(shown: NDArray[Any], ids: NDArray[np.int64], new: NDArray[Any]) -> NDArray[Any]:
    """What was shown, with the new rows put in; in memory of its own, as what was shown may be somebody's."""
    merged = shown.copy()
    merged[ids] = new
    return merged


def _spec(name: str, space: spaces.Space[Any], n: int, device: torch.device) -> Any:
    """TorchRL's word for a space, n times."""
    shape = (n, *(space.shape or ()))
    if isinstance(space, spaces.Discrete):
        return Categorical(int(space.n), shape, device, torch.int64)
    if isinstance(space, spaces.MultiDiscrete) and not space.start.any():
        return MultiCategorical(space.nvec, shape, device, torch.int64)
    if space.dtype is None or not isinstance(space, spaces.Box | spaces.MultiBinary):
        raise ArgumentError(f"`{name}`: expected Box, Discrete, MultiBinary or MultiDiscrete, got {space}")
    dtype = torch.from_numpy(np.empty(0, space.dtype)).dtype
    if isinstance(space, spaces.MultiBinary):
        return Binary(shape=shape, device=device, dtype=dtype)
    if space.dtype.kind == "f" and not space.is_bounded("both"):
        return Unbounded(shape, device=device, dtype=dtype)
    low, high = (torch.from_numpy(np.broadcast_to(end, shape).copy()) for end in (space.low, space.high))
    return Bounded(low, high, shape, device, dtype)
