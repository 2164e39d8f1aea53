"""Who plays in a window: the agent on a clock, or a person by the keys."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from vhs import Outcome
from vhs.acting.episodes import Episodes
from vhs.acting.players import Choice
from vhs.acting.setup import make_buffer, make_env
from vhs.acting.stepping import LocalStepping
from vhs.config import Config
from vhs.learning.goals import Told
from vhs.play.film import LAST_FRAME_S
from vhs.play.window import Window
from vhs.show.moments import Moment, Onlooker
from vhs.show.pictures import draw
from vhs.task import Task

_STREAM = np.zeros(1, dtype=np.int64)
"""The only stream of an episode that is played alone."""


def show(window: Window, moments: Iterator[Moment], fps: int) -> None:
    """Show moments at `fps` a second until there are no more; the space bar pauses."""
    is_paused = False

    def pause() -> None:
        nonlocal is_paused
        is_paused = not is_paused

    def advance() -> None:
        if is_paused:
            window.after(0.1, advance)
            return
        moment = next(moments, None)
        if moment is None:
            window.close()
            return
        window.show(draw(moment))
        window.after(1 / fps if moment.outcome is None else LAST_FRAME_S, advance)

    window.on_key("space", pause)
    window.on_key("q", window.close)
    window.after(0, advance)
    window.run()


class Person:
    """Plays by the keys of a task; Return begins the next episode."""

    def __init__(self, window: Window, config: Config, task: Task, seeds: Iterable[int]) -> None:
        """Take the keys and begin the first episode.

        Args:
            window: shows the episodes.
            config: of a run of the task.
            task: says which key is which action.
            seeds: one an episode; the window closes when there are no more.
        """
        self._window = window
        self.outcomes: list[Outcome] = []
        """Of the episodes that ended."""
        self._keyed: int | None = None
        spec = task.spec()
        env = make_env(task, spec, rendering=True)
        stepping = LocalStepping([env])
        self._episodes = Episodes(stepping, self, make_buffer(config, spec, 1, 1), seeds)
        self._onlooker = Onlooker(task, spec, env, stepping)
        for key, action in task.keys.items():
            window.on_key(key, partial(self._key, action))
        window.on_key("Return", self._go_on)
        window.on_key("q", window.close)
        self._episodes.start()
        self._go_on()

    def begin(self, stream: int, goal: Told, interaction: int) -> None:
        """The window tells the instruction."""

    def act(self, streams: NDArray[np.int64]) -> Choice:
        """The key that was pressed; until there is one, the episode rests."""
        keyed = [] if self._keyed is None else [self._keyed]
        self._keyed = None
        actions = np.array(keyed, np.int64)
        return streams[: len(keyed)], actions, np.zeros(len(keyed), np.float32)

    def _go_on(self) -> None:
        """Begin the next episode, unless one runs."""
        if self._episodes.running:
            return
        if self._episodes.is_done:
            self._window.close()
            return
        self._step()

    def _key(self, action: int) -> None:
        if self._episodes.running:
            self._keyed = action
            self._episodes.act(_STREAM)
            self._step()

    def _step(self) -> None:
        moments = [self._onlooker.end(ended) for ended in self._episodes.step()]
        self.outcomes += [moment.outcome for moment in moments if moment.outcome is not None]
        moments += [self._onlooker.running(episode) for episode in self._episodes.running.values()]
        self._window.show(draw(moments[0]))
