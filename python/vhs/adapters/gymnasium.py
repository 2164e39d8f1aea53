"""`gymnasium.make_vec` with a `RolloutPool` behind it, as the vector entry point of a specification."""

from __future__ import annotations

import copy
import functools
import os
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec

from vhs._core import ArgumentError
from vhs.rollout.vector import RolloutVectorEnv

__all__ = ["pooled"]


def pooled(env: str | EnvSpec) -> EnvSpec:
    """A specification that `gymnasium.make_vec` makes in worker processes.

        envs = gymnasium.make_vec(pooled("CartPole-v1"), num_envs=8, num_workers=2)

    What `make_vec` is given beyond its own arguments are the environment's, but for three: `num_workers`
    (processes, a divisor of `num_envs`; None: as many as there are cores for), `autoreset_mode` and
    `pool_kwargs`, the further arguments of `RolloutVectorEnv`. Registered under a name, with
    `gymnasium.registry[name] = pooled(env)`, `make_vec(name)` makes it too.

    Args:
        env: Name of a registered environment, or its specification.

    Raises:
        gymnasium.error.Error: For a name that is not registered.
    """
    spec = copy.deepcopy(env if isinstance(env, EnvSpec) else gymnasium.spec(env))
    single = copy.deepcopy(spec)
    single.kwargs, single.vector_entry_point = {}, None
    spec.vector_entry_point = functools.partial(_made, single)
    return spec


def _made(
    spec: EnvSpec,
    num_envs: int,
    *,
    num_workers: int | None = None,
    autoreset_mode: Any = "NextStep",
    pool_kwargs: dict[str, Any] | None = None,
    **env: Any,
) -> RolloutVectorEnv:
    workers = _fitting(num_envs) if num_workers is None else num_workers
    if workers < 1 or num_envs % workers:
        raise ArgumentError(f"`num_workers`: expected a divisor of {num_envs} environments, got {workers}")
    return RolloutVectorEnv(
        functools.partial(gymnasium.make, spec, **env),
        workers,
        num_envs // workers,
        autoreset_mode=autoreset_mode,
        **(pool_kwargs or {}),
    )


def _fitting(num_envs: int) -> int:
    """The most workers for which there are cores, of those that can share the environments equally."""
    cores = len(os.sched_getaffinity(0))
    return max(workers for workers in range(1, min(cores, num_envs) + 1) if num_envs % workers == 0)
