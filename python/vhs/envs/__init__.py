"""The three visual navigation tasks, registered with gymnasium in the namespace `vhs`.

Importing this package registers them and loads nothing heavy: MuJoCo comes with the first `gymnasium.make`,
and the names below with their first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register, registry

import vhs.envs.opengl  # noqa: F401  its effect is needed before anything imports mujoco
from vhs.envs.config import OBJECT_NAMES, TASKS, RoomConfig, RoomTask
from vhs.envs.rewards import compute_reward, reward_terms

if TYPE_CHECKING:
    from vhs.envs.oracle import optimal_steps, plan
    from vhs.envs.rendering import NoOpenGLError
    from vhs.envs.room import RoomEnv

__all__ = [
    "OBJECT_NAMES",
    "TASKS",
    "NoOpenGLError",
    "RoomConfig",
    "RoomEnv",
    "RoomTask",
    "compute_reward",
    "optimal_steps",
    "plan",
    "register_envs",
    "reward_terms",
]

_LAZY = {
    "RoomEnv": "vhs.envs.room",
    "NoOpenGLError": "vhs.envs.rendering",
    "optimal_steps": "vhs.envs.oracle",
    "plan": "vhs.envs.oracle",
}
"""Names that need MuJoCo, and where they live."""


def register_envs() -> None:
    """Register the three tasks; doing it again changes nothing.

    Called on import.
    """
    for task in TASKS:
        if task.env_id not in registry:
            # No max_episode_steps: the room counts its own horizon, since a timeout has a reward of its own.
            register(task.env_id, entry_point="vhs.envs.room:RoomEnv", kwargs={"task": task.name})


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


register_envs()
