"""What a task is found to be by trying it: sizes, and one episode at random, before anything is trained.

Where workers step the environments it is tried in a process of its own: an environment in the learner's would
leave its OpenGL context, threads and locks to every worker.
"""

from __future__ import annotations

import mmap
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from multiprocessing import active_children, get_context

from vhs.acting.environment import TaskEnv
from vhs.errors import ConfigError
from vhs.task import Task, TaskSpec, lengthened

START_LIMIT_S = 120.0
"""How long an environment may take to be made, sized up and made again."""


def try_task(task: Task, moved: Callable[[], object] = lambda: None, horizon_factor: float = 1.0) -> TaskSpec:
    """Sizes and types of a task, of which one episode has been played at random in this process.

    Args:
        task: What is tried.
        moved: Called after the reset and after each step.
        horizon_factor: How many times its steps that episode may last.

    Raises:
        ArgumentError: a field of the task does not fit its environment; it is named.
    """
    spec = task.spec()
    longer, sizes = lengthened(task, spec, horizon_factor)
    with closing(TaskEnv(longer.new_env(), longer, sizes)) as env:
        env.action_space.seed(0)
        env.reset(seed=0)
        is_over = False
        while not is_over:
            moved()
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            is_over = terminated or truncated
    return spec


def try_task_apart(task: Task, deadline_s: float = 60.0, horizon_factor: float = 1.0) -> TaskSpec:
    """As `try_task`, in a process of its own, which is forked: a task may hold what cannot be pickled.

    Args:
        task: What is tried.
        deadline_s: Seconds that a reset or a step may take.
        horizon_factor: As for `try_task`.

    Raises:
        ConfigError: the process died, or its environment took too long.
    """
    # Steps taken, in memory that both processes see.
    taken = mmap.mmap(-1, 8)

    def moved() -> None:
        taken[:] = (int.from_bytes(taken[:]) + 1).to_bytes(8)

    # The arguments of an initialiser are inherited, those of a call are pickled.
    arguments = (lambda: try_task(task, moved, horizon_factor)), os.getpid()
    with ProcessPoolExecutor(1, get_context("fork"), _remember, arguments) as process, _ending():
        future = process.submit(_call)
        before, limit_s = 0, START_LIMIT_S
        while not wait([future], limit_s).done:
            now = int.from_bytes(taken[:])
            if now == before:
                raise ConfigError(
                    f"task {task.name}: expected an environment within {START_LIMIT_S:g} s and each step in "
                    f"{deadline_s:g} s (env.deadline_s), found it hanging after {now} steps; one that draws "
                    "with OpenGL may hang where this process did before, and not in a fresh one"
                )
            before, limit_s = now, deadline_s
        try:
            return future.result()
        except BrokenProcessPool as error:
            raise ConfigError(
                f"task {task.name}: expected an episode, found its process dead (a fault in native code?)"
            ) from error


@contextmanager
def _ending() -> Iterator[None]:
    """Kill what was started where anything is raised, Ctrl-C too: it would be waited for, and may never end.

    The pool is not asked: it knows a process only a moment after that has begun.
    """
    before = set(active_children())
    try:
        yield
    except BaseException:
        for child in set(active_children()) - before:
            child.kill()
        raise


_remembered: list[Callable[[], TaskSpec]] = []


def _remember(function: Callable[[], TaskSpec], parent: int) -> None:
    if sys.platform.startswith("linux"):
        from vhs._core import RolloutWorker

        # It holds its own end of the pipe, on which it would wait for ever once its parent is killed.
        RolloutWorker.end_with(parent, by_signal=False)
    _remembered.append(function)


def _call() -> TaskSpec:
    return _remembered[-1]()
