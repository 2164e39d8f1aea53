"""Evaluation of trained agents."""

from vhs.eval.evaluate import Evaluation, evaluate

__all__ = ["Evaluation", "evaluate"]
