"""A room whose true state can be read: what films and reports draw from."""

from __future__ import annotations

import gymnasium

from vhs.config import Config
from vhs.envs import RoomEnv
from vhs.train.build import make_envs


def make_room(config: Config, *, is_drawn: bool) -> RoomEnv:
    """A room of the configured task, without wrappers: its true state is for pictures and reports.

    Args:
        config: of the run.
        is_drawn: whether `render` gives the third-person view.
    """
    env: gymnasium.Env = make_envs(config, 1, render_mode="rgb_array" if is_drawn else None)[0]
    room = env.unwrapped
    assert isinstance(room, RoomEnv)
    return room
