"""`vhs play`: watch a trained agent, or drive the robot oneself."""

from vhs.play.command import play

__all__ = ["play"]
