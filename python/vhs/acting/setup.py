"""From a configuration to what acting needs: the task, its environments, where and how to compute."""

from __future__ import annotations

import sys

import numpy as np
import torch

from vhs import EpisodeBuffer
from vhs.acting.environment import TaskEnv
from vhs.acting.stepping import LocalStepping, PooledStepping, Stepping
from vhs.buffer import make_buffer as buffer_of
from vhs.config import Config
from vhs.envs.task import load_task
from vhs.errors import ConfigError
from vhs.models import pick_device
from vhs.task import Task, TaskSpec


def task_of(config: Config) -> Task:
    """The task of a configuration.

    Raises:
        ConfigError: it does not exist, or what `env` says of it is wrong.
    """
    return load_task(config.task, room=config.env.room, renderer=config.env.renderer)


def make_env(task: Task, spec: TaskSpec, **kwargs: object) -> TaskEnv:
    """One environment of a task; `kwargs` go to `Task.make`."""
    return TaskEnv(task.make(**kwargs), task, spec)


def make_stepping(config: Config, task: Task, spec: TaskSpec, count: int) -> Stepping:
    """`count` environments, stepped in this process or in `env.num_workers` others."""
    workers = int(_has_workers()) if config.env.num_workers is None else config.env.num_workers
    if not workers:
        return LocalStepping([make_env(task, spec) for _ in range(count)])
    from vhs.rollout import RolloutPool

    pool = RolloutPool(
        lambda: make_env(task, spec),
        workers,
        count // workers,
        seed=config.seed,  # of the episodes that begin where a worker died
        autoreset="Disabled",
        on_error="raise",
    )
    return PooledStepping(pool, config.env.min_ready)


def make_buffer(config: Config, spec: TaskSpec, num_streams: int, num_waiting: int) -> EpisodeBuffer:
    """An episode buffer for `num_streams` running and `num_waiting` ended episodes."""
    return buffer_of(
        spec,
        num_streams=num_streams,
        capacity_steps=(num_streams + num_waiting) * spec.max_episode_steps,
        frame_stack=config.model.frame_stack,
        stacking="channels",
    )


def convolution_dtype(config: Config) -> torch.dtype:
    """Type in which the convolutions multiply on the configured device."""
    precision = config.train.precision
    if precision == "auto":
        fast = pick_device(config.train.device).type == "cuda" or _cpu_multiplies_bfloat16()
        precision = "bfloat16" if fast else "float32"
    return torch.bfloat16 if precision == "bfloat16" else torch.float32


def to_act_here(config: Config) -> Config:
    """The same configuration for acting: no workers, and the CPU where the device of training is missing."""
    device = config.train.device
    try:
        torch.zeros((), device=pick_device(device))
    except (RuntimeError, AssertionError):
        device = "cpu"
    return config.model_copy(
        update={
            "env": config.env.model_copy(update={"num_workers": 0}),
            "train": config.train.model_copy(update={"device": device}),
        }
    )


def check_runnable(config: Config, task: Task | None = None) -> None:
    """Check what the schema cannot: the task, the goals that it has, workers and the device.

    Args:
        config: resolved.
        task: None: the one that the configuration names.

    Raises:
        ConfigError: one of them cannot be had; nothing was made.
    """
    task = task or task_of(config)
    if task.goals is not None:
        check_goals(config, len(task.goals))
    if config.env.num_workers and not _has_workers():
        raise ConfigError(f"env.num_workers: expected 0 on {sys.platform}, found {config.env.num_workers}")
    try:
        torch.zeros((), device=pick_device(config.train.device))
    except (RuntimeError, AssertionError) as error:
        raise ConfigError(f"train.device: {config.train.device!r} cannot be used: {error}") from error


def check_goals(config: Config, num_goals: int) -> None:
    """Check that the method can learn to tell so many goal classes apart.

    Raises:
        ConfigError: a SupCon batch that may hold no two images of one class.
    """
    method = config.method
    has_supcon = "supcon" in method.row.terms and method.supcon_weight > 0
    if has_supcon and method.supcon_batch <= num_goals:
        raise ConfigError(
            f"method.supcon_batch: expected more than {num_goals}, the number of goals, so that SupCon finds "
            f"two images of one, found {method.supcon_batch}"
        )


def check_spec(config: Config, task: Task, spec: TaskSpec) -> None:
    """Check that the networks and losses that there are fit a task.

    Raises:
        ConfigError: goals, actions or frames of a kind that they do not take, or something not said.
    """
    check_goals(config, spec.num_goals)
    if spec.goals != "labels":
        raise ConfigError(f"task {task.name}: expected goals that are classes, found {spec.goals}")
    if spec.action_dim:
        raise ConfigError(
            f"task {task.name}: expected numbered actions, found {spec.action_dim} real numbers"
        )
    if np.dtype(spec.frame_dtype) != np.uint8 or len(spec.frame_shape) != 3:
        raise ConfigError(
            f"task {task.name}: expected frames uint8 [height, width, channels], "
            f"found {spec.frame_dtype} {list(spec.frame_shape)}"
        )
    if config.method.localisation_weight and not spec.can_localise:
        raise ConfigError(
            f"method.localisation_weight: expected 0 or null, as task {task.name} has not all of `moves` "
            "(what its actions do to the pose), goals that are classes, and pictures, "
            f"found {config.method.localisation_weight}"
        )
    if config.method.value_target == "hindsight_return" and spec.success_reward is None:
        raise ConfigError(
            f"method.value_target: expected behaviour, as task {task.name} does not say what a success pays, "
            "found hindsight_return"
        )


def _has_workers() -> bool:
    """Whether environments can be stepped in worker processes here."""
    return sys.platform.startswith("linux")


def _cpu_multiplies_bfloat16() -> bool:
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
