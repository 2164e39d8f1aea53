"""What `vhs play` does: a film, a window, or a person at the keys."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from vhs.acting.policy import Policy, load_agent
from vhs.acting.seeds import episode_seeds
from vhs.acting.setup import check_runnable, make_env, task_of, to_act_here
from vhs.errors import OutputError
from vhs.play.film import check_film_path, write_film
from vhs.runs.directory import read_config
from vhs.show.moments import Moment, play_moments
from vhs.show.pictures import draw
from vhs.task import Task

if TYPE_CHECKING:
    from PIL.Image import Image

    from vhs.play.window import Window

FPS = 3
"""Steps a second: slow enough to read the action."""


def play(
    run: Path,
    *,
    episodes: int = 3,
    seed: int = 0,
    greedy: bool = False,
    out: Path | None = None,
    is_human: bool = False,
    task: Task | None = None,
) -> str:
    """Show episodes of a run's task, those that `vhs eval` plays for the same seed.

    Args:
        run: directory of the run; with `is_human` it needs no checkpoint.
        episodes: how many.
        seed: which episodes, and which samples of the policy.
        greedy: take the likeliest action instead of sampling.
        out: GIF or MP4 to write; None opens a window.
        is_human: a person acts.
        task: what the run is about; None: the task that its configuration names.

    Returns:
        What happened, in a sentence.

    Raises:
        CheckpointError: the run or its checkpoint is missing or damaged.
        OutputError: no display, a film that cannot be written, or a film of a person.
    """
    if is_human and out is not None:
        raise OutputError("--human: expected a window, found --out; leave one of them out")
    if out is not None:
        check_film_path(out)
    seeds = islice(episode_seeds(seed, purpose=1), episodes)
    if is_human:
        return _drive(run, seeds, task)
    moments = _moments(load_agent(run, task), seeds, seed, greedy)
    return _show(run, moments) if out is None else _film(out, moments)


def _moments(agent: Policy, seeds: Iterator[int], seed: int, greedy: bool) -> Iterator[Moment]:
    env = make_env(agent.task, agent.spec, rendering=True)
    return play_moments(agent, env, seeds, seed, greedy)


def _film(out: Path, moments: Iterator[Moment]) -> str:
    ended: list[str] = []

    def pictures() -> Iterator[tuple[Image, bool]]:
        for moment in moments:
            if moment.outcome is not None:
                ended.append(moment.outcome.name.lower())
            yield draw(moment), moment.outcome is not None

    count = write_film(out, pictures(), FPS)
    return f"{out}: {count} frames; {', '.join(ended)}"


def _show(run: Path, moments: Iterator[Moment]) -> str:
    from vhs.play.driver import show

    show(_open_window(f"{run} - space pauses, q quits"), moments, FPS)
    return f"{run}: window closed"


def _drive(run: Path, seeds: Iterator[int], task: Task | None) -> str:
    config = to_act_here(read_config(run))
    task = task or task_of(config)
    check_runnable(config, task)
    if not task.keys:
        raise OutputError(f"--human: expected a task that says its keys, found none for {task.name}")
    window = _open_window(f"{_help(task)}, Return: next episode, q: quit")
    from vhs.play.driver import Person

    person = Person(window, config, task, seeds)
    window.run()
    ended = ", ".join(outcome.name.lower() for outcome in person.outcomes) or "none"
    return f"episodes that ended: {ended}"


def _help(task: Task) -> str:
    """What each key does."""
    return ", ".join(f"{key}: {task.action_name(action)}" for key, action in task.keys.items())


def _open_window(title: str) -> Window:
    """A window, or a sentence that says what is missing for one."""
    try:
        from vhs.play.window import Window
    except ImportError as error:  # Linux distributions split tkinter off their Python
        raise OutputError(
            f"a window needs tkinter, which this Python ({sys.executable}) lacks: on Debian or Ubuntu "
            "apt-get install python3-tk; a film needs none: --out FILE.gif"
        ) from error
    return Window(title)
