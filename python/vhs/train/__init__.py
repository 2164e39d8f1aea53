"""Training: rollouts, the loop, checkpoints, logs."""

from vhs.train.loop import train

__all__ = ["train"]
