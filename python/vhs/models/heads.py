"""Action heads: what the policy's outputs say of actions, one kind an action space.

A head turns outputs into the parameters of a distribution, a tensor that can be cut and joined along
episodes and steps; log-probability, entropy, sample and mode are functions of it. Nothing else knows what an
action is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch
from torch import Tensor, finfo
from torch.distributions.utils import logits_to_probs
from torch.nn.functional import logsigmoid, softplus

if TYPE_CHECKING:
    from vhs.task import TaskSpec


class ActionHead(Protocol):
    """A family of distributions over actions."""

    @property
    def size(self) -> int:
        """Outputs of the policy."""
        ...

    def parameters(self, outputs: Tensor) -> Tensor:
        """Outputs [..., size] as parameters, float32 [..., size]."""
        ...

    def log_prob(self, parameters: Tensor, actions: Tensor) -> Tensor:
        """Of actions, in nats, [...]: int64 [...], or float32 [..., dim] where they are continuous."""
        ...

    def entropy(self, parameters: Tensor) -> Tensor:
        """In nats, [...]."""
        ...

    def sample(self, parameters: Tensor, generator: torch.Generator) -> Tensor:
        """An action for each of n rows of parameters, on the CPU, as `log_prob` takes them."""
        ...

    def mode(self, parameters: Tensor) -> Tensor:
        """The likeliest action of each of n rows."""
        ...


@dataclass(frozen=True)
class Categorical(ActionHead):
    """Numbered actions; the parameters are log-probabilities, -inf of what cannot be done."""

    num_actions: int

    @property
    def size(self) -> int:
        """A logit an action."""
        return self.num_actions

    def parameters(self, outputs: Tensor) -> Tensor:
        """The log-probability of every action."""
        return outputs.log_softmax(-1)

    def log_prob(self, parameters: Tensor, actions: Tensor) -> Tensor:
        """The entry of each action."""
        return parameters.gather(-1, actions.unsqueeze(-1)).squeeze(-1)

    def entropy(self, parameters: Tensor) -> Tensor:
        """-sum p log p."""
        # p log p of an impossible action is 0, its limit, and not 0 times minus infinity.
        least = finfo(parameters.dtype).min
        return -(logits_to_probs(parameters) * parameters.clamp(min=least)).sum(-1)

    def sample(self, parameters: Tensor, generator: torch.Generator) -> Tensor:
        """int64 [n]."""
        return torch.multinomial(parameters.exp(), 1, generator=generator).squeeze(-1)

    def mode(self, parameters: Tensor) -> Tensor:
        """int64 [n]."""
        return parameters.argmax(-1)


@dataclass(frozen=True)
class MultiCategorical(ActionHead):
    """Several choices at once, independent given the state, numbered as one.

    The number is that of `numpy.ravel_multi_index`: the last choice counts fastest. Buffer, checkpoints and
    `interactions` therefore hold and name such an action like any other, and only the head takes it apart.
    """

    choices: tuple[int, ...]
    """Options of each choice."""

    @property
    def size(self) -> int:
        """A logit an option."""
        return sum(self.choices)

    @cached_property
    def _heads(self) -> list[Categorical]:
        return [Categorical(options) for options in self.choices]

    def parameters(self, outputs: Tensor) -> Tensor:
        """The log-probability of every option, choice by choice."""
        return torch.cat([one.log_softmax(-1) for one in self._cut(outputs)], -1)

    def log_prob(self, parameters: Tensor, actions: Tensor) -> Tensor:
        """The sum over the choices."""
        parts = zip(self._heads, self._cut(parameters), self._taken(actions), strict=True)
        return torch.stack([head.log_prob(part, taken) for head, part, taken in parts]).sum(0)

    def entropy(self, parameters: Tensor) -> Tensor:
        """The sum over the choices."""
        parts = zip(self._heads, self._cut(parameters), strict=True)
        return torch.stack([head.entropy(part) for head, part in parts]).sum(0)

    def sample(self, parameters: Tensor, generator: torch.Generator) -> Tensor:
        """int64 [n]."""
        parts = zip(self._heads, self._cut(parameters), strict=True)
        return self._number([head.sample(part, generator) for head, part in parts])

    def mode(self, parameters: Tensor) -> Tensor:
        """int64 [n]."""
        return self._number([part.argmax(-1) for part in self._cut(parameters)])

    def _cut(self, options: Tensor) -> tuple[Tensor, ...]:
        """What belongs to each choice."""
        return torch.split(options, list(self.choices), -1)

    def _number(self, taken: list[Tensor]) -> Tensor:
        number = torch.zeros_like(taken[0])
        for options, one in zip(self.choices, taken, strict=True):
            number = number * options + one
        return number

    def _taken(self, actions: Tensor) -> list[Tensor]:
        """The option of each choice, int64, each of the shape of `actions`."""
        taken = []
        for options in reversed(self.choices):
            taken.append(actions % options)
            actions = actions // options
        return taken[::-1]


_LEAST_STD = 0.05
"""Imitation raises the density of what was done without end; the noise that exploring needs stays."""
_EDGE = 1 - 1e-6
"""Largest action: atanh of 1 is infinite, and of more than this nothing that float32 can tell apart."""


@dataclass(frozen=True)
class SquashedNormal(ActionHead):
    """Continuous actions in -1..1: tanh of independent normals (Haarnoja et al. 2018, appendix C).

    The parameters are means and standard deviations before tanh. Outputs of 0 give a standard deviation of
    0.74, whose density after tanh is nearly flat.
    """

    dim: int
    """Numbers in an action."""

    @property
    def size(self) -> int:
        """A mean and a width a number."""
        return 2 * self.dim

    def parameters(self, outputs: Tensor) -> Tensor:
        """Means and standard deviations, [..., 2 * dim]."""
        mean, width = outputs.chunk(2, -1)
        return torch.cat([mean, softplus(width) + _LEAST_STD], -1)

    def log_prob(self, parameters: Tensor, actions: Tensor) -> Tensor:
        """The log-density of actions float32 [..., dim] in -1..1."""
        mean, std = parameters.chunk(2, -1)
        before = torch.atanh(actions.clamp(-_EDGE, _EDGE))
        normal = -0.5 * ((before - mean) / std).square() - std.log() - 0.5 * math.log(2 * math.pi)
        return (normal - _log_slope(before)).sum(-1)

    def entropy(self, parameters: Tensor) -> Tensor:
        """That of the normal plus the mean of tanh's log slope, by 16-point Gauss-Hermite quadrature."""
        mean, std = parameters.chunk(2, -1)
        nodes, weights = (torch.from_numpy(values).to(mean) for values in self._quadrature)
        slopes = _log_slope(mean.unsqueeze(-1) + std.unsqueeze(-1) * nodes) @ weights
        return (std.log() + 0.5 * math.log(2 * math.pi * math.e) + slopes).sum(-1)

    def sample(self, parameters: Tensor, generator: torch.Generator) -> Tensor:
        """float32 [n, dim]."""
        mean, std = parameters.chunk(2, -1)
        return torch.tanh(mean + std * torch.randn(mean.shape, generator=generator)).clamp(-_EDGE, _EDGE)

    def mode(self, parameters: Tensor) -> Tensor:
        """The squashed mean, which is the median of each number, float32 [n, dim]."""
        return torch.tanh(parameters.chunk(2, -1)[0])

    @cached_property
    def _quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and weights of a mean over N(0, 1)."""
        nodes, weights = np.polynomial.hermite_e.hermegauss(16)
        return nodes, weights / weights.sum()


def _log_slope(before: Tensor) -> Tensor:
    """log(1 - tanh(u)^2), exact far out as well."""
    return 2 * (math.log(2.0) + logsigmoid(2 * before) - before)


def head_of(spec: TaskSpec) -> ActionHead:
    """The head that fits the actions of a task."""
    if spec.action_dim:
        return SquashedNormal(spec.action_dim)
    if spec.action_parts:
        return MultiCategorical(tuple(spec.action_parts))
    return Categorical(spec.num_actions)
