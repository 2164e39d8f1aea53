"""Averaged weights: what a trained agent acts with, where the one in training acts with the newest.

While it still learns fast, the newest weights jump around the way that training takes; their mean over some
hundreds of updates is a better policy than any of them, and training goes on as if there were none (Polyak &
Juditsky 1992, "Acceleration of stochastic approximation by averaging").
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from vhs.learning.goals import Goals
from vhs.models import GoalAgent


class Average:
    """Exponential moving average of weights, batch statistics and prototypes, after each update.

    Of itself it keeps `decay`, and at most (1 + n) / (10 + n) after n updates, so that it forgets how a run
    began: it reaches back over a tenth of the run, and no further than 1 / (1 - decay) updates.
    """

    def __init__(self, decay: float) -> None:
        """Average nothing yet.

        Args:
            decay: in [0, 1).
        """
        self._decay = decay
        self._updates = 0
        self._agent: dict[str, Any] = {}
        self._table: Tensor | None = None

    def update(self, agent: GoalAgent, goals: Goals) -> None:
        """Take in the weights and the prototypes that an update left."""
        share = 1 - min(self._decay, (1 + self._updates) / (10 + self._updates))
        for name, newest in agent.state_dict().items():
            average = self._agent.get(name)
            if isinstance(average, Tensor) and _are_alike(average, newest):
                average.lerp_(newest, share)
            else:  # counts of batches, and whatever else an extractor of one's own keeps
                self._agent[name] = copy.deepcopy(newest)
        table = goals.state_dict().get("table")
        if table is not None:
            before = table if self._table is None else self._table
            self._table = torch.where(before.any(dim=1, keepdim=True), before.lerp(table, share), table)
        self._updates += 1

    def state_dict(self) -> dict[str, Any]:
        """All that it is; `averaged` reads it."""
        table = {} if self._table is None else {"table": self._table}
        return {"updates": self._updates, "agent": self._agent, **table}

    def load_state_dict(self, state: Mapping[str, Any], device: torch.device) -> None:
        """Return to a state that `state_dict` gave; `device` is where the agent is."""
        self._updates = int(state["updates"])
        self._agent = {
            name: average.to(device) if isinstance(average, Tensor) else average
            for name, average in state["agent"].items()
        }
        self._table = state.get("table")


def _are_alike(average: Tensor, newest: Any) -> bool:
    """Whether both are real numbers, of one type and shape: what a mean can be made of."""
    if not isinstance(newest, Tensor) or not newest.is_floating_point():
        return False
    return (average.dtype, average.shape) == (newest.dtype, newest.shape)


def averaged(learned: Mapping[str, Any]) -> tuple[Mapping[str, Tensor], Mapping[str, Tensor]]:
    """Weights and prototypes for acting, of a state of `Learner`: their averages, where it has any."""
    average, named = learned.get("average"), learned["prototypes"]
    if average is None or not average["updates"]:
        return learned["agent"], named
    return average["agent"], {**named, "table": average["table"]} if "table" in average else named
