"""From a configuration to the parts of a run: rooms, buffer, networks, learner."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import torch

from vhs import EpisodeBuffer, GoalStore, Prototypes, Rng
from vhs.algorithms import ALGORITHMS, VHS
from vhs.config import Config, unknown_key
from vhs.envs import OBJECT_NAMES, TASKS, RoomConfig, Task
from vhs.envs.config import FIRST_INTERACTION
from vhs.envs.rendering import check_renderer
from vhs.errors import ConfigError
from vhs.models import DiscriminativeAgent, FeatureExtractor, GoalAgent, pick_device
from vhs.train.rooms import LocalRooms, PooledRooms, Rooms


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


def make_agent(config: Config, env: gymnasium.Env[Any, Any]) -> GoalAgent:
    """Networks that fit the spaces of `env`, initialised from the run's seed alone."""
    image, interactions, actions = _spaces(env)
    model, classes = config.model, num_goals(env)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        extractor = FeatureExtractor(image, model.frame_stack, model.channels, model.feature_dim)
        kind: Callable[..., GoalAgent] = GoalAgent
        if config.method.name == "gdan":
            kind = partial(DiscriminativeAgent, num_goals=classes)
        agent = kind(
            extractor,
            num_actions=actions,
            num_interactions=interactions,
            hidden_dim=model.hidden_dim,
            head_dim=model.head_dim,
            interaction_dim=model.interaction_dim,
            num_words=classes if config.method.embedding == "word" else 0,
        )
    return agent.to(pick_device(config.train.device))


def make_buffer(
    config: Config, env: gymnasium.Env[Any, Any], num_streams: int, num_waiting: int
) -> EpisodeBuffer:
    """An episode buffer for `num_streams` running and `num_waiting` ended episodes."""
    image, interactions, actions = _spaces(env)
    horizon = room_config(config).horizon_steps
    return EpisodeBuffer(
        image,
        num_streams=num_streams,
        max_episode_steps=horizon,
        capacity_steps=(num_streams + num_waiting) * horizon,
        frame_stack=config.model.frame_stack,
        stacking="channels",
        num_goals=num_goals(env),
        num_actions=actions,
        interactions={action: action - FIRST_INTERACTION for action in range(FIRST_INTERACTION, actions)},
        num_interactions=interactions,
    )


def make_learner(config: Config, env: gymnasium.Env[Any, Any]) -> VHS:
    """The learner at its beginning, before any episode."""
    agent = make_agent(config, env)
    room, method, classes = room_config(config), config.method, num_goals(env)
    return ALGORITHMS[method.name](
        agent,
        GoalStore(classes, agent.extractor.observation_shape, method.goal_capacity, seed=config.seed),
        Prototypes(classes, config.model.feature_dim, momentum=prototype_momentum(config), seed=config.seed),
        method=method,
        train=config.train,
        success_reward=room.reward_success + room.reward_step,
        dtype=convolution_dtype(config),
        rng=Rng(config.seed),
    )


def prototype_momentum(config: Config) -> float:
    """Share of the old prototype kept by an update: none when prototypes are exact."""
    return config.method.prototype_momentum if config.method.prototype == "running" else 0.0


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
    has_supcon = method.parts.goal_loss == "supcon" and method.supcon_weight > 0
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


def num_goals(env: gymnasium.Env[Any, Any]) -> int:
    """Number of goal classes of `env`."""
    return int(_space(env)["goal"].n)


def _has_workers() -> bool:
    """Whether rooms can be stepped in worker processes here."""
    return sys.platform.startswith("linux")


def _cpu_multiplies_bfloat16() -> bool:
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())


def _space(env: gymnasium.Env[Any, Any]) -> Any:
    """The observation space as the untyped mapping that it is."""
    return env.observation_space


def _spaces(env: gymnasium.Env[Any, Any]) -> tuple[tuple[int, ...], int, int]:
    """Frame shape, number of interactions, number of actions."""
    space, actions = _space(env), env.action_space
    assert isinstance(actions, gymnasium.spaces.Discrete)
    return tuple(space["image"].shape), int(space["interaction"].n), int(np.int64(actions.n))
