"""Training: the loop, what it is built of, measurements, exports."""

from vhs.train.loop import train

__all__ = ["train"]
