"""A `RolloutPool` as stable-baselines3's `VecEnv`: workers that write observations into shared memory."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.env_util import is_wrapped
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from vhs._core import ArgumentError, ProtocolError
from vhs.rollout.batch import Batch
from vhs.rollout.leaves import Nest
from vhs.rollout.options import EnvFn
from vhs.rollout.pool import RolloutPool

__all__ = ["PoolVecEnv"]


class PoolVecEnv(VecEnv):
    """Steps all environments of a `RolloutPool` together, as stable-baselines3's `SubprocVecEnv` would.

    Seeds, options, infos and terminal observations are those of its vectors. An episode that was cut (its
    worker died, or it showed a NaN) ends as by a limit of time, with reward 0, `info["cut"]` and what was
    seen last as its terminal observation; `HindsightBuffer` drops it. Episodes are counted by a `Monitor`
    that `env_fn` makes, or by a `VecMonitor` around this.
    """

    def __init__(
        self, env_fn: EnvFn | Sequence[EnvFn], num_workers: int, envs_per_worker: int = 1, **pool: Any
    ) -> None:
        """Start the workers.

        Args:
            env_fn: Makes an environment, in its worker; or one such function for each environment.
            num_workers: Processes.
            envs_per_worker: Environments that each of them steps.
            pool: Further arguments of `RolloutPool`; `on_error` may be "raise" or "restart".

        Raises:
            ArgumentError: For an argument out of range.
            Exception: As `RolloutPool`.
        """
        if pool.get("on_error") == "drop":
            raise ArgumentError(
                "on_error: expected 'raise' or 'restart', got 'drop': a VecEnv keeps its size"
            )
        opened = _Open(env_fn) if callable(env_fn) else _each_open(env_fn)
        self.pool = RolloutPool(opened, num_workers, envs_per_worker, autoreset="SameStep", **pool)
        self._nest = Nest(self.pool.single_observation_space, "observation")
        self._shown: Any = None
        super().__init__(
            self.pool.num_envs, self.pool.single_observation_space, self.pool.single_action_space
        )

    def reset(self) -> VecEnvObs:
        """Begin an episode in every environment, with what `seed` and `set_options` said.

        Returns:
            Observations, each array [num_envs, ...]. What a pending `step_async` does is dropped.
        """
        if self.pool.num_under_way:
            self.pool.recv()
        seeds = None if all(seed is None for seed in self._seeds) else self._seeds
        for ids, options in self._asked():
            self.pool.reset(ids, seeds=seeds and [seeds[env] for env in ids], options=options)
        batch = self.pool.recv()
        self.reset_infos = [batch.infos.get(env, {}) for env in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        self._shown = batch.observation
        return self._shown  # type: ignore[no-any-return] # nested as the space

    def _asked(self) -> list[tuple[list[int], dict[str, Any] | None]]:
        """Environments and the options of their reset: all at once where these are none."""
        if not any(self._options):
            return [(list(range(self.num_envs)), None)]
        return [([env], options or None) for env, options in enumerate(self._options)]

    def step_async(self, actions: NDArray[Any]) -> None:
        """Send an action to every environment, [num_envs, ...]."""
        self.pool.send(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Wait for all answers.

        Returns:
            Observations, each array [num_envs, ...]; rewards float32 [num_envs]; whether episodes ended, bool
            [num_envs]; an info each.

        Raises:
            ProtocolError: When nothing was sent.
        """
        if not self.pool.num_under_way:
            raise ProtocolError("`step_wait`: expected a `step_async` before it, found none")
        batch = self.pool.recv()
        infos = self._infos(batch)
        dones = batch.terminated | batch.truncated | batch.is_cut
        self._shown = batch.observation
        return self._shown, batch.rewards.astype(np.float32), dones, infos

    def _infos(self, batch: Batch) -> list[dict[str, Any]]:
        infos = [dict(batch.infos.get(env, {})) for env in range(self.num_envs)]
        for env in np.flatnonzero(batch.is_cut).tolist():
            self.reset_infos[env] = infos[env]
            infos[env] = {"cut": True, "terminal_observation": self._row(self._shown, env)}
        for place, env in enumerate(batch.final_rows.tolist()):
            last = dict(infos[env].pop("final_info", {}))
            self.reset_infos[env] = infos[env]
            infos[env] = last | {"terminal_observation": self._row(batch.final_observation, place)}
        ended = ((batch.truncated & ~batch.terminated) | batch.is_cut).tolist()
        for info, is_truncated in zip(infos, ended, strict=True):
            info["TimeLimit.truncated"] = is_truncated
        return infos

    def _row(self, batch: Any, row: int) -> Any:
        """One observation of several, nested as the space, in arrays of its own."""
        return self._nest.join([np.copy(leaf[row]) for leaf in self._nest.split(batch)])

    def close(self) -> None:
        """End the workers."""
        self.pool.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Read an attribute of environments."""
        return self._called(_Open.NAME, indices, "get", attr_name)

    def has_attr(self, attr_name: str) -> bool:
        """Whether every environment has an attribute."""
        return all(self._called(_Open.NAME, None, "has", attr_name))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of environments."""
        self._called("set_wrapper_attr", indices, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of environments."""
        return self._called(method_name, indices, *method_args, **method_kwargs)

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Whether environments are in a wrapper of this class."""
        return self._called(_Open.NAME, indices, "wrapped", wrapper_class)

    def get_images(self) -> Sequence[NDArray[Any] | None]:
        """What every environment renders, uint8 [height, width, 3] each."""
        return self._called("render", None)

    def _called(self, name: str, indices: VecEnvIndices, *args: Any, **kwargs: Any) -> list[Any]:
        ids = list(self._get_indices(indices))
        return list(self.pool.call_each(name, [(args, kwargs)] * len(ids), ids))


class _Open:
    """Makes an environment that answers what a `VecEnv` is asked about it."""

    NAME = "vhs_answer"

    def __init__(self, env_fn: EnvFn) -> None:
        self._env_fn = env_fn

    def __call__(self) -> gymnasium.Env[Any, Any]:
        env = self._env_fn()
        setattr(env, self.NAME, functools.partial(_answer, env))
        return env


def _answer(env: gymnasium.Env[Any, Any], question: str, about: Any) -> Any:
    """Read an attribute, which may be a function; whether there is one; whether it is in a wrapper."""
    if question == "get":
        return env.get_wrapper_attr(about)
    return env.has_wrapper_attr(about) if question == "has" else is_wrapped(env, about)


def _each_open(env_fns: Any) -> Any:
    """The same for each of several functions; what is none is the pool's to refuse."""
    if isinstance(env_fns, str) or not isinstance(env_fns, Sequence):
        return env_fns
    opened: dict[int, Callable[[], Any]] = {
        id(env_fn): _Open(env_fn) for env_fn in env_fns if callable(env_fn)
    }
    return [opened.get(id(env_fn), env_fn) for env_fn in env_fns]
