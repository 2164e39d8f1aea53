"""Who plays in a window: the agent on a clock, or a person by the keys."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from vhs import Outcome
from vhs.envs import RoomEnv
from vhs.envs.config import FIRST_INTERACTION, MOVE_FORWARD, TURN_LEFT, TURN_RIGHT
from vhs.play.film import LAST_FRAME_S
from vhs.play.window import Window
from vhs.show.moments import Moment, ending, snapshot
from vhs.show.pictures import draw


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
    """Drives the robot: arrow keys move, 1 to 3 interact (space is 1), Return begins the next episode."""

    def __init__(self, window: Window, room: RoomEnv, seeds: Iterator[int]) -> None:
        """Take the keys and begin the first episode.

        Args:
            window: shows the room.
            room: any task.
            seeds: one an episode; the window closes when there are no more.
        """
        self._window, self._room, self._seeds = window, room, seeds
        self.outcomes: list[Outcome] = []
        """Of the episodes that ended."""
        self._is_running = False
        keys = {"Up": MOVE_FORWARD, "Left": TURN_LEFT, "Right": TURN_RIGHT}
        keys |= {str(number + 1): FIRST_INTERACTION + number for number in range(room.task.interactions)}
        if room.task.interactions:
            keys["space"] = FIRST_INTERACTION
        for key, action in keys.items():
            window.on_key(key, partial(self._act, action))
        window.on_key("Return", self._go_on)
        window.on_key("q", window.close)
        self._begin()

    def _begin(self) -> None:
        seed = next(self._seeds, None)
        if seed is None:
            self._window.close()
            return
        observation, _ = self._room.reset(seed=seed)
        self._is_running = True
        self._window.show(draw(snapshot(self._room, observation["image"])))

    def _go_on(self) -> None:
        if not self._is_running:
            self._begin()

    def _act(self, action: int) -> None:
        if not self._is_running:
            return
        observation, _, terminated, truncated, info = self._room.step(action)
        if terminated or truncated:
            self._is_running = False
            moment = ending(self._room, observation["image"], info)
            self.outcomes.append(Outcome.from_name(info["outcome"]))
        else:
            moment = snapshot(self._room, observation["image"])
        self._window.show(draw(moment))
