"""Evaluation of trained agents."""

from vhs.eval.evaluate import Evaluation, evaluate
from vhs.runs.evaluations import read_evaluations, record_evaluation

__all__ = ["Evaluation", "evaluate", "read_evaluations", "record_evaluation"]
