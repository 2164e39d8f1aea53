"""Learning algorithms: what happens to the networks when episodes end."""

from vhs.algorithms.vhs import VHS

__all__ = ["VHS"]
