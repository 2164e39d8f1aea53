"""Environments in worker processes: a pool that gathers whatever is ready, and its gymnasium face.

Needs gymnasium, as the extra `env` brings it; neither torch nor mujoco. `docs/rollout.md` tells how it works.
"""

from vhs.rollout.batch import Batch
from vhs.rollout.errors import PoolClosedError, RemoteTraceback, WorkerError
from vhs.rollout.pool import PoolStats, RolloutPool
from vhs.rollout.vector import RolloutVectorEnv

__all__ = [
    "Batch",
    "PoolClosedError",
    "PoolStats",
    "RemoteTraceback",
    "RolloutPool",
    "RolloutVectorEnv",
    "WorkerError",
]
