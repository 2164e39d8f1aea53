"""How often the interpreter waits for the device: on a GPU each time is a round trip that stops all kernels.

Counted on the CPU, where the same calls cost nothing: what brings numbers back, and what must know them, as
choosing rows by truths does. Uploads are queued and are none of these.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from toy import TOY_SPEC, toy_config

from vhs import Outcome
from vhs.acting.actor import Actor
from vhs.learning.learner import Learner
from vhs.train.build import make_learner

from .parts import make_batch

aten = torch.ops.aten
ASKS = {aten._local_scalar_dense.default, aten.nonzero.default, aten.masked_select.default}
"""What `.item()`, `bool(tensor)`, `nonzero` and their like become."""


class Reads(TorchDispatchMode):
    """Counts reads of the device."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__()
        self.found: list[str] = []
        for name in ("cpu", "tolist"):
            monkeypatch.setattr(Tensor, name, self.counted(name, getattr(Tensor, name)))

    def counted(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def read(tensor: Tensor, *arguments: Any, **options: Any) -> Any:
            self.found.append(name)
            return method(tensor, *arguments, **options)

        return read

    def __torch_dispatch__(self, function: Any, types: Any, arguments: Any = (), options: Any = None) -> Any:
        indices = arguments[1] if function in (aten.index.Tensor, aten.index_put.default) else ()
        if function in ASKS or any(i is not None and i.dtype == torch.bool for i in indices):
            self.found.append(str(function))
        return function(*arguments, **(options or {}))


def warm_learner(name: str, *overrides: str) -> Learner:
    learner = make_learner(toy_config(name, "method.warmup=6", *overrides), TOY_SPEC)
    rng = np.random.default_rng(0)
    for label in range(12):
        learner.goals.store.push(rng.integers(0, 256, (16, 16, 6), dtype=np.uint8), label % 3)
    return learner


OUTCOMES = [Outcome.SUCCESS, Outcome.FAILURE, Outcome.TIMEOUT, Outcome.FAILURE]


def test_an_update_reads_its_losses_once_and_the_features_of_goal_images(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    learner, batch = warm_learner("vhs", "method.relabel_probability=1"), make_batch(OUTCOMES)
    goals = torch.zeros(len(OUTCOMES), 16)
    learner.update(batch, goals)  # what the first one makes for all
    with Reads(monkeypatch) as reads:
        metrics = learner.update(batch, goals)
    assert {"supcon", "imitation_policy"} <= metrics.keys(), "every loss was at work"
    assert reads.found == ["tolist", "cpu"]


def test_a_step_reads_the_device_once(monkeypatch: pytest.MonkeyPatch) -> None:
    learner = warm_learner("vhs")
    actor = Actor(learner.agent, 4, dtype=torch.float32, generator=torch.Generator().manual_seed(0))
    for stream in range(4):
        actor.begin(stream, torch.zeros(16), 0)
    streams, observations = np.arange(4), np.zeros((4, 16, 16, 6), np.uint8)
    actor.act(streams, observations)
    with Reads(monkeypatch) as reads:
        actor.act(streams, observations)
    assert reads.found == ["cpu"]


@pytest.mark.parametrize(
    "read",
    [
        lambda x: x.sum().item(),
        lambda x: bool(x.any()),
        lambda x: x.tolist(),
        lambda x: x.nonzero(),
        lambda x: x[x > 0],
        lambda x: x.cpu(),
    ],
)
def test_every_kind_of_read_is_counted(
    read: Callable[[Tensor], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Reads(monkeypatch) as reads:
        read(torch.ones(3))
    assert reads.found
