"""An episode moment by moment: what was seen, and what was done about it.

A moment is what the player sees, with the action that it then chooses; the last moment of an episode has the
outcome instead. An episode of n steps therefore has n + 1 moments. While a moment is looked at, its
environment stands where it shows: the next step waits until the next moment is asked for.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhs import Outcome
from vhs.acting.environment import TaskEnv
from vhs.acting.episodes import EndedEpisode, Episodes, Running
from vhs.acting.policy import Policy
from vhs.acting.setup import make_buffer
from vhs.acting.stepping import LocalStepping
from vhs.png import as_picture
from vhs.task import Task, TaskSpec


@dataclass(frozen=True, slots=True)
class Moment:
    """One picture of an episode."""

    step: int
    """Steps taken before it."""
    goal: int
    """Instructed goal class."""
    instruction: str
    view: NDArray[np.uint8]
    """The newest frame as a picture, uint8 [height, width, 3]."""
    onlooker: NDArray[np.uint8] | None
    """What the environment renders, uint8 [H, W, 3], where it does."""
    told: NDArray[np.uint8] | None = None
    """The goal as a picture, uint8 [H, W, 3], where it is a picture or a vector."""
    action: str | None = None
    """What is done now; None at the end of the episode, and before a person has chosen."""
    value: float | None = None
    """The critic's estimate of what is still to come, in units of the scaled reward."""
    outcome: Outcome | None = None
    """At the end of the episode alone."""
    reached: int | None = None
    """Goal class that ended the episode, -1 for none; None before its end, or where the task does not say."""
    ending: str | None = None
    """Outcome and reached goal in words."""


class Onlooker:
    """Makes moments of the only environment of some episodes, between two of their steps."""

    def __init__(self, task: Task, spec: TaskSpec, env: TaskEnv, stepping: LocalStepping) -> None:
        """Look at `env`, which `stepping` steps."""
        self._task, self._spec, self._env, self._stepping = task, spec, env, stepping

    def running(self, episode: Running, **known: Any) -> Moment:
        """The present moment of an episode; `known` are further fields of `Moment`."""
        return self._moment(len(episode.actions), episode.goal, episode.interaction, **known)

    def end(self, episode: EndedEpisode) -> Moment:
        """The last moment of an episode."""
        reached, words = episode.reached, episode.outcome.name.lower()
        if reached is not None and reached >= 0:
            words += f": {self._task.goal_name(reached)} reached"
        end = {"outcome": episode.outcome, "reached": reached, "ending": words}
        return self._moment(episode.steps, episode.goal, episode.interaction, **end)

    def _moment(self, step: int, goal: int, interaction: int, **known: Any) -> Moment:
        assert self._stepping.newest is not None
        goals = self._stepping.newest.desired_goals
        instruction = self._task.goal_name(goal) if goals is None else "as shown"
        if self._spec.num_interactions > 1:
            instruction += f", interaction {interaction + 1}"
        view = as_picture(self._stepping.newest.frames[0])
        rendered: Any = self._env.render() if self._env.render_mode == "rgb_array" else None
        onlooker = None if rendered is None else as_picture(np.asarray(rendered))
        told = None if goals is None else as_picture(goals[0])
        return Moment(step, goal, instruction, view, onlooker, told, **known)


def play_moments(
    agent: Policy, env: TaskEnv, seeds: Iterable[int], seed: int, greedy: bool
) -> Iterator[Moment]:
    """Let an agent play episodes.

    Args:
        agent: chooses the actions.
        env: an environment of its task.
        seeds: of the episodes.
        seed: of the sampled actions.
        greedy: take the likeliest action instead of a sample.

    Yields:
        The moments of every episode, from the reset to the outcome.
    """
    buffer, stepping = make_buffer(agent.config, agent.spec, 1, 1), LocalStepping([env])
    onlooker = Onlooker(agent.task, agent.spec, env, stepping)
    episodes = Episodes(stepping, agent.player(buffer, seed, greedy), buffer, seeds)
    episodes.start()
    while not episodes.is_done:
        for ended in episodes.step():
            yield onlooker.end(ended)
        for running in episodes.running.values():
            action, value = episodes.chosen(0)
            yield onlooker.running(running, action=agent.task.action_name(action), value=value)
