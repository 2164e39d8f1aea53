"""From a configuration to what acting needs: the task, its environments, where and how to compute."""

from __future__ import annotations

import re
import sys
from dataclasses import replace

import numpy as np
import torch

from vhs import EpisodeBuffer
from vhs.acting.environment import TaskEnv
from vhs.acting.stepping import LocalStepping, PooledStepping, Stepping
from vhs.acting.trial import try_task, try_task_apart
from vhs.buffer import make_buffer as buffer_of
from vhs.config import Config, EnvSection
from vhs.config.task import GIVEN, TaskSection, file_of
from vhs.envs.find import task_in_file, task_in_module
from vhs.envs.opengl import load_triton_first
from vhs.envs.task import ROOMS, load_room
from vhs.envs.words import task_of_words
from vhs.errors import ConfigError, without_frames
from vhs.models import pick_device
from vhs.task import Task, TaskSpec


def task_of(config: Config) -> Task:
    """The task of a configuration: the one place that turns what the key `task` holds into a `Task`.

    Raises:
        ConfigError: it does not exist, or what `env` says of it is wrong.
    """
    found, env = config.task, config.env
    if is_room(config):
        task = load_room(config.task_name, room=env.room, renderer=env.renderer)
    elif env.room or env.renderer != EnvSection().renderer:
        key = "env.room" if env.room else "env.renderer"
        raise ConfigError(f"{key}: expected none for {config.task_name}, which is no room; see env.kwargs")
    else:
        task = _own_task(found)
    kwargs, max_steps = {**task.kwargs, **env.kwargs}, task.max_steps
    if task.max_steps_keyword in env.kwargs:  # then that is the limit
        max_steps = kwargs.pop(task.max_steps_keyword)
        if type(max_steps) is not int or max_steps < 1:
            raise ConfigError(
                f"env.kwargs.{task.max_steps_keyword}: expected a number of steps, found {max_steps!r}"
            )
    return replace(task, name=task.name or config.task_name, kwargs=kwargs, max_steps=max_steps)


def is_room(config: Config) -> bool:
    """Whether the task is one of the rooms, which this package brings along."""
    return isinstance(config.task, str) and config.task in ROOMS


def with_given(config: Config, task: Task | None) -> Config:
    """The configuration of a training that was given its task from Python, which nobody else can find."""
    if task is None:
        return config
    return config.model_copy(update={"task": GIVEN + (re.sub(r"[^\w.-]+", "-", task.name) or "task")})


def _own_task(found: str | TaskSection) -> Task:
    if isinstance(found, TaskSection):
        return task_of_words(found.model_dump())
    if (place := file_of(found)) is not None:
        return task_in_file(*place)
    module, _, name = found.partition(":")
    if found.startswith(GIVEN):
        raise ConfigError(
            f"task: {name} was given to the training from Python; say where it is: --task FILE.py, or `task=`"
        )
    return task_in_module(module, name)


def learn_spec(config: Config, task: Task) -> TaskSpec:
    """Sizes and types of a task that is about to be stepped, found by trying it where it will be stepped.

    Raises:
        ArgumentError: a field of the task does not fit its environment; it is named.
    """
    factor = horizon_factor(config, can_last=task.max_steps_keyword is not None)
    if workers_of(config):
        return try_task_apart(task, config.env.deadline_s, factor)
    load_triton_first()  # the environment may open OpenGL, in the process that will make an optimiser
    return try_task(task, horizon_factor=factor)


def make_env(task: Task, spec: TaskSpec, *, rendering: bool = False) -> TaskEnv:
    """One environment of a task; `rendering` as for `Task.new_env`."""
    return TaskEnv(task.new_env(rendering=rendering), task, spec)


def make_stepping(config: Config, task: Task, spec: TaskSpec, count: int) -> Stepping:
    """`count` environments, stepped in this process or in `env.num_workers` others."""
    workers = workers_of(config)
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
        deadline_s=config.env.deadline_s,
    )
    return PooledStepping(pool, config.env.min_ready, can_repeat=task.replayable)


def make_buffer(config: Config, spec: TaskSpec, num_streams: int, num_waiting: int) -> EpisodeBuffer:
    """An episode buffer for `num_streams` running and `num_waiting` ended episodes."""
    return buffer_of(
        spec,
        num_streams=num_streams,
        capacity_steps=(num_streams + num_waiting) * spec.max_episode_steps,
        frame_stack=config.model.frame_stack,
        stacking="channels" if len(spec.frame_shape) == 3 else "frames",
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
    if config.env.num_workers and not has_workers():
        raise ConfigError(f"env.num_workers: expected 0 on {sys.platform}, found {config.env.num_workers}")
    try:
        torch.zeros((), device=pick_device(config.train.device))
    except (RuntimeError, AssertionError) as error:
        found = without_frames(error)
        raise ConfigError(f"train.device: {config.train.device!r} cannot be used: {found}") from error


def settled(config: Config, spec: TaskSpec) -> Config:
    """The same configuration with what a task decides filled in: keys that are null until it is known."""
    can_localise, terms = spec.can_localise, config.method.row.terms
    # Where every picture is a goal, or the task says where one was reached, a timeout reached something too.
    reaches_on_the_way = spec.goals != "labels" or spec.is_touched_told
    own = {
        "localisation_weight": 1.0 if can_localise and "localise" in terms else 0.0,
        "memory_weight": 0.5 if can_localise and "remember" in terms else 0.0,
        "imitate_still": not can_localise,
        "supcon_batch": max(16, 2 * spec.num_goals),
        "relabel_on": ("failure", "timeout") if reaches_on_the_way else ("failure",),
    }
    imitates = config.method.imitates
    of_env = {
        "horizon_factor": horizon_factor(config, can_last=spec.can_last),
        "retry_share": 0.25 if spec.is_replayable and imitates else 0.0,
    }
    # A lap of turns before a goal in view should cost much of what an episode can, however long it may be.
    of_train = {"gamma": max(0.9, 1 - 2 / spec.max_episode_steps)}
    update = {
        name: section.model_copy(
            update={key: value for key, value in wanted.items() if getattr(section, key) is None}
        )
        for name, section, wanted in (
            ("method", config.method, own),
            ("env", config.env, of_env),
            ("train", config.train, of_train),
        )
    }
    return config.model_copy(update=update)


def horizon_factor(config: Config, *, can_last: bool) -> float:
    """How many times its steps an episode of training may last, of a task that says or does not say how."""
    if config.env.horizon_factor is not None:
        return config.env.horizon_factor
    return 2.0 if can_last and config.method.imitates else 1.0


def check_goals(config: Config, num_goals: int) -> None:
    """Check that the method can learn to tell so many goal classes apart.

    Raises:
        ConfigError: a SupCon batch that may hold no two images of one class.
    """
    method = config.method
    has_supcon = "supcon" in method.row.terms and method.supcon_weight > 0
    if has_supcon and method.supcon_batch is not None and method.supcon_batch <= num_goals:
        raise ConfigError(
            f"method.supcon_batch: expected more than {num_goals}, the number of goals, so that SupCon finds "
            f"two images of one, found {method.supcon_batch}"
        )


def check_spec(config: Config, task: Task, spec: TaskSpec, *, is_own: bool = False) -> None:
    """Check that the networks and losses that there are fit a task.

    Args:
        config: settled.
        task: in its own words.
        spec: what follows from it.
        is_own: whether the feature extractor is the user's, whatever `model.extractor` says.

    Raises:
        ConfigError: goals, actions or frames of a kind that they do not take, or something not said.
    """
    method, own = config.method, is_own or config.model.extractor is not None
    is_picture = len(spec.frame_shape) == 3 and np.dtype(spec.frame_dtype) == np.uint8
    if spec.has_classes:
        check_goals(config, spec.num_goals)
    if not (is_picture or own or len(spec.frame_shape) == 1):
        raise ConfigError(
            f"task {task.name}: expected frames uint8 [height, width, channels] or vectors [numbers], "
            f"found {np.dtype(spec.frame_dtype)} {list(spec.frame_shape)}; model.extractor may take others"
        )
    shows = [*({"supcon", "discriminator"} & {*method.row.terms}), method.embedding]
    needs = [name for name in shows if name != "word"]
    if spec.goals == "labels" and needs and np.dtype(spec.frame_dtype) != np.uint8:
        raise ConfigError(
            f"task {task.name}: expected frames uint8, of which images of reached goals are kept for "
            f"{', '.join(needs)}, found {np.dtype(spec.frame_dtype)}; method.name = a3c keeps none"
        )
    for key in ("localisation_weight", "memory_weight"):
        if getattr(method, key) and not spec.can_localise:
            raise ConfigError(
                f"method.{key}: expected 0 or null, as task {task.name} has not all of `moves` (what its "
                f"actions do to the pose), goals that are classes, and pictures, found {getattr(method, key)}"
            )
    if not spec.has_classes and "discriminator" in method.row.terms:
        raise ConfigError(
            f"method.name: expected one without a goal-discriminator, as task {task.name} names no goal "
            f"classes, found {method.name}"
        )
    if spec.action_dim and spec.interactions:
        raise ConfigError(
            f"task {task.name}: expected no `interactions` of continuous actions, "
            f"found {dict(spec.interactions)}"
        )
    if method.value_target == "hindsight_return" and spec.success_reward is None:
        raise ConfigError(
            f"method.value_target: expected behaviour, as task {task.name} does not say what a success pays, "
            "found hindsight_return"
        )


def workers_of(config: Config) -> int:
    """Processes that step the environments."""
    return int(has_workers()) if config.env.num_workers is None else config.env.num_workers


def has_workers() -> bool:
    """Whether environments can be stepped in worker processes here."""
    return sys.platform.startswith("linux")


def _cpu_multiplies_bfloat16() -> bool:
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
