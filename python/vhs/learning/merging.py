"""One update of several ranks: each learns from a share of its episodes, and all take the same step.

Gradients and batch statistics are averaged, terms and what the prototypes are made of summed, in one message.
Each rank normalises by the statistics of its own share, as data-parallel training does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor, nn

from vhs.world import World


def average_gradients(
    world: World, agent: nn.Module, along: Sequence[Tensor], meanwhile: Callable[[], None]
) -> None:
    """Give every rank the mean of the gradients and of the batch statistics.

    A rank without a gradient of a parameter has a share of 0; where no rank has one there is none.

    Args:
        world: the ranks.
        agent: the networks, whose gradients are those of this rank.
        along: what is summed over the ranks in the same message.
        meanwhile: done while it is under way, by the weights and statistics of this rank.
    """
    parameters = [parameter for parameter in agent.parameters() if parameter.requires_grad]
    learned = torch.tensor([float(parameter.grad is not None) for parameter in parameters])
    for parameter in parameters:
        if parameter.grad is None:
            parameter.grad = torch.zeros_like(parameter)
    gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
    statistics = [buffer for buffer in agent.buffers() if buffer.is_floating_point()]
    world.average([*gradients, *statistics], [learned, *along], meanwhile)
    for parameter, ranks in zip(parameters, learned.tolist(), strict=True):
        if not ranks:
            parameter.grad = None


class Terms:
    """Unweighted terms of an update, over the ranks that had them."""

    def __init__(self, names: Sequence[str], found: Mapping[str, Tensor], device: torch.device) -> None:
        """Take those of this rank.

        Args:
            names: every term that there may be, alike on every rank.
            found: those that there were, each of shape [].
            device: of the sums.
        """
        self._names = names
        none = torch.zeros((), device=device)
        here = torch.stack([found.get(name, none).to(device, torch.float32) for name in names])
        had = torch.tensor([float(name in found) for name in names])
        self.sums = torch.stack([here, had.to(device)])
        """Of each term, and ranks that had it, shape [2, names]; to be summed over the ranks."""

    def means(self, norm: Tensor) -> tuple[dict[str, float], float]:
        """The mean of each term over the ranks that had it, and a number beside, read at once."""
        *numbers, found = torch.cat([self.sums.flatten(), norm.float().reshape(1)]).tolist()
        sums, counts = numbers[: len(self._names)], numbers[len(self._names) :]
        return {name: sums[i] / counts[i] for i, name in enumerate(self._names) if counts[i]}, found
