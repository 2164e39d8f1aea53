"""Several learners on one set of weights: each takes a share of an update's episodes, gradients are averaged.

Threads suffice: torch lets go of the interpreter in its kernels. Each learner normalises by the statistics of
its own share, as data-parallel training does, so the number of learners is part of the method's definition:
the same number gives the same weights, however many cores there are.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch
from torch import Tensor

from vhs.models import GoalAgent

Share = TypeVar("Share")
Result = TypeVar("Result")


class Replicas:
    """Twins of an agent: the same memory for weights, gradients and batch statistics of their own."""

    def __init__(self, agent: GoalAgent, count: int, threads: int = 1) -> None:
        """Make `count - 1` twins of `agent`, each with a thread that lets torch use `threads` cores."""
        self.agents = [agent, *(_twin(agent) for _ in range(count - 1))]
        self._threads = threads
        self._pool = ThreadPoolExecutor(count - 1, "learner", self._begin_thread) if count > 1 else None

    def map(self, work: Callable[[GoalAgent, Share], Result], shares: Sequence[Share]) -> list[Result]:
        """`work(agent, share)` for every share, side by side; the results in the order of the shares."""
        if self._pool is None:
            return [work(self.agents[0], share) for share in shares]
        others = [
            self._pool.submit(work, agent, share)
            for agent, share in zip(self.agents[1:], shares[1:], strict=True)
        ]
        try:
            first = work(self.agents[0], shares[0])
        finally:
            # A twin still at work would write gradients into the next update.
            for other in others:
                other.exception()
        return [first, *(other.result() for other in others)]

    @torch.no_grad()
    def merge(self) -> None:
        """Average gradients and batch statistics: the gradients into the first agent, statistics into all."""
        if len(self.agents) == 1:
            return
        for parameters in zip(*(agent.parameters() for agent in self.agents), strict=True):
            gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
            if gradients:
                parameters[0].grad = torch.stack(gradients).sum(0).div_(len(parameters))
        for buffers in zip(*(agent.buffers() for agent in self.agents), strict=True):
            if buffers[0].is_floating_point():
                _set_all(buffers, torch.stack(buffers).mean(0))

    def spread_statistics(self) -> None:
        """Give every twin the batch statistics of the first agent, as after loading it."""
        for buffers in zip(*(agent.buffers() for agent in self.agents), strict=True):
            _set_all(buffers[1:], buffers[0])

    def _begin_thread(self) -> None:
        torch.set_num_threads(self._threads)


def _twin(agent: GoalAgent) -> GoalAgent:
    twin = copy.deepcopy(agent)
    for own, shared in zip(twin.parameters(), agent.parameters(), strict=True):
        own.data = shared.data
    return twin


def _set_all(buffers: Sequence[Tensor], value: Tensor) -> None:
    for buffer in buffers:
        buffer.copy_(value)
