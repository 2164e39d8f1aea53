"""From a configuration to the parts of a run: rooms, buffer, networks, learner."""

from __future__ import annotations

import sys
from dataclasses import fields
from typing import Any

import gymnasium
import torch

from vhs import EpisodeBuffer, Rng
from vhs.acting.stepping import LocalRooms, PooledRooms, Rooms
from vhs.buffer import make_buffer as buffer_of
from vhs.config import Config
from vhs.config.load import unknown_key
from vhs.envs import OBJECT_NAMES, TASKS, RoomConfig, Task
from vhs.envs.rendering import check_renderer
from vhs.errors import ConfigError
from vhs.learning.goals import make_goals
from vhs.learning.learner import Learner
from vhs.models import make_agent, pick_device
from vhs.task import TaskSpec, read_spec


def room_config(config: Config) -> RoomConfig:
    """The room that `env.room` describes.

    Raises:
        ConfigError: an unknown or wrong entry of `env.room`.
    """
    known = [field.name for field in fields(RoomConfig)]
    for key in config.env.room:
        if key not in known:
            raise ConfigError(unknown_key(f"env.room.{key}", [f"env.room.{name}" for name in known]))
    try:
        return RoomConfig(**config.env.room)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"env.room.{error}") from error


def task_of(config: Config) -> Task:
    """The task that `task` names."""
    return TASKS[("task1", "task2", "task3").index(config.task)]


def make_envs(config: Config, count: int, **kwargs: Any) -> list[gymnasium.Env[Any, Any]]:
    """`count` rooms of the configured task."""
    env_id, room = f"vhs/{task_of(config).name}-v0", room_config(config)
    return [gymnasium.make(env_id, config=room, renderer=config.env.renderer, **kwargs) for _ in range(count)]


def make_rooms(config: Config, count: int) -> Rooms:
    """`count` rooms that answer: in this process, or in `env.num_workers` others."""
    workers = int(_has_workers()) if config.env.num_workers is None else config.env.num_workers
    if not workers:
        return LocalRooms(make_envs(config, count))
    from vhs.rollout import RolloutPool

    pool = RolloutPool(
        lambda: make_envs(config, 1)[0],
        workers,
        count // workers,
        seed=config.seed,  # of the episodes that begin where a worker died
        autoreset="Disabled",
        on_error="raise",
    )
    return PooledRooms(pool, config.env.min_ready)


def make_spec(config: Config, env: gymnasium.Env[Any, Any]) -> TaskSpec:
    """Sizes and types of the configured task, read off one of its environments."""
    room = room_config(config)
    return read_spec(
        env,
        max_episode_steps=room.horizon_steps,
        interactions=task_of(config).interactions,
        success_reward=room.reward_success + room.reward_step,
    )


def make_buffer(config: Config, spec: TaskSpec, num_streams: int, num_waiting: int) -> EpisodeBuffer:
    """An episode buffer for `num_streams` running and `num_waiting` ended episodes."""
    return buffer_of(
        spec,
        num_streams=num_streams,
        capacity_steps=(num_streams + num_waiting) * spec.max_episode_steps,
        frame_stack=config.model.frame_stack,
    )


def make_learner(config: Config, spec: TaskSpec) -> Learner:
    """The learner at its beginning, before any episode.

    Raises:
        ConfigError: the method asks for what the task does not say.
    """
    if config.method.value_target == "hindsight_return" and spec.success_reward is None:
        raise ConfigError(
            "method.value_target: expected behaviour for a task that does not say what a success pays, "
            "found hindsight_return"
        )
    agent, dtype = make_agent(config, spec), convolution_dtype(config)
    return Learner(
        agent,
        make_goals(config, agent, spec.num_goals, dtype),
        method=config.method,
        train=config.train,
        success_reward=spec.success_reward or 0.0,
        dtype=dtype,
        rng=Rng(config.seed),
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


def check_runnable(config: Config) -> None:
    """Check what the schema cannot: the room, its renderer, the goals that it has and the device.

    Raises:
        ConfigError: one of them cannot be had; nothing was made.
    """
    room_config(config)
    method, goals = config.method, len(OBJECT_NAMES)
    has_supcon = "supcon" in method.row.terms and method.supcon_weight > 0
    if has_supcon and method.supcon_batch <= goals:
        raise ConfigError(
            f"method.supcon_batch: expected more than {goals}, the number of goals, so that SupCon finds two "
            f"images of one, found {method.supcon_batch}"
        )
    if config.env.num_workers and not _has_workers():
        raise ConfigError(f"env.num_workers: expected 0 on {sys.platform}, found {config.env.num_workers}")
    try:
        check_renderer(config.env.renderer)
    except ValueError as error:
        raise ConfigError(f"env.{error}") from error
    try:
        torch.zeros((), device=pick_device(config.train.device))
    except (RuntimeError, AssertionError) as error:
        raise ConfigError(f"train.device: {config.train.device!r} cannot be used: {error}") from error


def _has_workers() -> bool:
    """Whether rooms can be stepped in worker processes here."""
    return sys.platform.startswith("linux")


def _cpu_multiplies_bfloat16() -> bool:
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
