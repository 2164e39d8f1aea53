"""Learning algorithms: what happens to the networks when episodes end."""

from vhs.learning.gcsl import GCSL
from vhs.learning.gdan import GDAN
from vhs.learning.learner import VHS
from vhs.learning.methods import MethodName

ALGORITHMS: dict[MethodName, type[VHS]] = {"a3c": VHS, "gdan": GDAN, "gcsl": GCSL, "pg": VHS, "vhs": VHS}
"""The learner of each method; A3C and PG are VHS with terms left out (`vhs.learning.methods`)."""

__all__ = ["ALGORITHMS", "GCSL", "GDAN", "VHS"]
