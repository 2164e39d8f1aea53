"""Learning algorithms: what happens to the networks when episodes end."""

from vhs.algorithms.gcsl import GCSL
from vhs.algorithms.gdan import GDAN
from vhs.algorithms.vhs import VHS
from vhs.methods import MethodName

ALGORITHMS: dict[MethodName, type[VHS]] = {"a3c": VHS, "gdan": GDAN, "gcsl": GCSL, "pg": VHS, "vhs": VHS}
"""The learner of each method; A3C and PG are VHS with terms left out (`vhs.methods`)."""

__all__ = ["ALGORITHMS", "GCSL", "GDAN", "VHS"]
