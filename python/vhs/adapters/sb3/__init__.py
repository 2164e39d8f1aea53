"""stable-baselines3: `HindsightBuffer` for its replay buffers, `PoolVecEnv` for its vectors."""

from vhs.adapters.sb3.buffer import HindsightBuffer
from vhs.adapters.sb3.vec_env import PoolVecEnv

__all__ = ["HindsightBuffer", "PoolVecEnv"]
