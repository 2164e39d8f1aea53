"""Environments in worker processes: a pool that gathers whatever is ready, and its gymnasium face.

Needs Linux, and gymnasium, as the extra `env` brings it; neither torch nor mujoco. How it works:
`docs/reference/rollout.md`.
"""

import sys

if not sys.platform.startswith("linux"):
    raise ImportError(f"vhs.rollout: expected Linux, in whose memory its workers meet, found {sys.platform}")

from vhs.rollout.batch import Batch
from vhs.rollout.errors import AnswerTimeoutError, PoolClosedError, RemoteTraceback, WorkerError
from vhs.rollout.pool import PoolStats, RolloutPool
from vhs.rollout.vector import RolloutVectorEnv

__all__ = [
    "AnswerTimeoutError",
    "Batch",
    "PoolClosedError",
    "PoolStats",
    "RemoteTraceback",
    "RolloutPool",
    "RolloutVectorEnv",
    "WorkerError",
]
