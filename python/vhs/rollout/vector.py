"""The gymnasium face: a `VectorEnv` on a pool in lock-step."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from vhs._core import ArgumentError
from vhs.rollout.batch import Batch
from vhs.rollout.leaves import Nest
from vhs.rollout.pool import RolloutPool
from vhs.rollout.processes import EnvFn
from vhs.rollout.worker import Autoreset

Arrays = NDArray[Any]


class RolloutVectorEnv(VectorEnv[Any, Any, Arrays]):
    """Steps all environments of a `RolloutPool` together, as `gymnasium.vector.SyncVectorEnv` would.

    Seeds, autoreset modes, infos and final observations are gymnasium's. An episode that was cut (its worker
    died, or it showed a NaN) appears as truncated with reward 0 and `infos["cut"]`, its observation being the
    next episode's first.
    """

    def __init__(
        self,
        env_fn: EnvFn | list[EnvFn],
        num_workers: int,
        envs_per_worker: int = 1,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        **pool: Any,
    ) -> None:
        """Start the workers.

        Args:
            env_fn: as for `RolloutPool`.
            num_workers: processes.
            envs_per_worker: environments that each of them steps.
            autoreset_mode: gymnasium's.
            pool: further arguments of `RolloutPool`; `on_error` may be "raise" or "restart".
        """
        if pool.get("on_error") == "drop":
            raise ArgumentError(
                "on_error: expected 'raise' or 'restart', got 'drop': a VectorEnv keeps its size"
            )
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.pool = RolloutPool(
            env_fn, num_workers, envs_per_worker, autoreset=Autoreset(self.autoreset_mode.value), **pool
        )
        description = self.pool.description
        self.num_envs = self.pool.num_envs
        self.single_observation_space = self.pool.single_observation_space
        self.single_action_space = self.pool.single_action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.metadata = {**description.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = description.render_mode
        self.spec = None
        self._nest = Nest(self.single_observation_space, "observation")

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every environment, or in those of `options["reset_mask"]`.

        Args:
            seed: one for all (environment i gets `seed + i`), one each, or None for what the pool's own
                `seed` gives, and without one to go on with their generators.
            options: passed to every environment, without "reset_mask".

        Returns:
            Observations, nested, each leaf [num_envs, ...]; infos as gymnasium collects them.
        """
        seeds = None if seed is None else _seeds(seed, self.num_envs)
        options = None if options is None else dict(options)
        mask = None if options is None else options.pop("reset_mask", None)
        ids = np.arange(self.num_envs) if mask is None else np.flatnonzero(_mask(mask, self.num_envs))
        self.pool.reset(ids, seeds=seeds and [seeds[env] for env in ids], options=options)
        batch = self.pool.recv()
        infos: dict[str, Any] = {}
        for row, info in batch.infos.items():
            infos = self._add_info(infos, info, int(ids[row]))
        if len(batch) == self.num_envs:
            self._observation = batch.observation
        else:
            self._observation = self._merged(batch)
        return self._observation, infos

    def step(self, actions: Any) -> tuple[Any, Arrays, Arrays, Arrays, dict[str, Any]]:
        """One step of every environment.

        Returns:
            Observations, rewards float64 [num_envs], terminated and truncated bool [num_envs], infos.
        """
        self.pool.send(actions)
        batch = self.pool.recv()
        self._observation = batch.observation
        infos = self._infos(batch)
        truncated = batch.truncated
        if "cut" in infos:
            truncated = truncated | batch.is_cut
        return self._observation, batch.rewards, batch.terminated, truncated, infos

    def render(self) -> tuple[Any, ...]:
        """What every environment renders."""
        return self.pool.call("render")

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every environment, or read an attribute."""
        return self.pool.call(name, *args, **kwargs)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Read an attribute of every environment."""
        return self.pool.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of every environment, to one value or to one each."""
        each = values if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise ArgumentError(f"values: expected {self.num_envs} of them, got {len(each)}")
        self.pool.call_each("set_wrapper_attr", [((name, value), {}) for value in each])

    def close_extras(self, **kwargs: Any) -> None:
        """End the workers."""
        self.pool.close()

    def __enter__(self) -> Self:
        """The vector itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def _infos(self, batch: Batch) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        final_rows = batch.final_rows.tolist()
        if final_rows:
            finals = self._nest.split(batch.final_observation)
            for position, row in enumerate(final_rows):
                final = self._nest.join([leaf[position] for leaf in finals])
                infos = self._add_info(infos, {"final_obs": final}, row)
        for row, info in batch.infos.items():
            infos = self._add_info(infos, info, row)
        if batch.is_cut.any():
            for row in np.flatnonzero(batch.is_cut).tolist():
                infos = self._add_info(infos, {"cut": True}, row)
        return infos

    def _merged(self, batch: Batch) -> Any:
        """The last observations with those of the batch put in."""
        merged = []
        for last, new in zip(
            self._nest.split(self._observation), self._nest.split(batch.observation), strict=True
        ):
            leaf = last.copy()
            leaf[batch.env_ids] = new
            merged.append(leaf)
        return self._nest.join(merged)


def _seeds(seed: int | list[int | None], num_envs: int) -> list[int | None]:
    if isinstance(seed, int | np.integer):
        return [int(seed) + env for env in range(num_envs)]
    if len(seed) != num_envs:
        raise ValueError(f"seed: expected {num_envs} of them, got {len(seed)}")
    return list(seed)


def _mask(mask: Any, num_envs: int) -> NDArray[np.bool_]:
    array = np.asarray(mask)
    if array.shape != (num_envs,) or array.dtype != np.bool_ or not array.any():
        raise ValueError(
            f"reset_mask: expected bool [{num_envs}] with a True, got {array.dtype} {array.shape}"
        )
    return array
