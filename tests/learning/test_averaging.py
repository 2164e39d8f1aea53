"""Averaged weights: what they are, and that training does not read them."""

import copy
from types import SimpleNamespace

import numpy as np
import torch
from torch import Tensor

from vhs import Outcome
from vhs.learning.averaging import Average, averaged

from .parts import DIM, GOALS, fill_store, goals_for, make_batch, small_learner

OUTCOMES = [Outcome.SUCCESS, Outcome.FAILURE, Outcome.TIMEOUT]


def learned(updates: int, *overrides: str) -> tuple[dict[str, Tensor], list[dict[str, Tensor]]]:
    """The weights averaged over some updates of a learner, and those that each update left."""
    learner, batch, seen = small_learner(*overrides), make_batch(OUTCOMES), []
    fill_store(learner.goals)
    for _ in range(updates):
        learner.update(batch, goals_for(batch))
        seen.append({name: weights.clone() for name, weights in learner.agent.state_dict().items()})
    return dict(averaged(learner.state_dict())[0]), seen


def test_the_average_is_that_of_its_formula() -> None:
    found, seen = learned(6, "train.ema_decay=0.3")
    expected = {name: weights.double() for name, weights in seen[0].items()}
    for update, newest in enumerate(seen):
        kept = min(0.3, (1 + update) / (10 + update))
        for name, weights in newest.items():
            expected[name] = kept * expected[name] + (1 - kept) * weights.double()
    for name, weights in found.items():
        if weights.is_floating_point():
            torch.testing.assert_close(weights.double(), expected[name], rtol=1e-5, atol=1e-6)
            assert not torch.equal(weights, seen[-1][name]) or torch.equal(weights, seen[0][name]), name
        else:
            assert torch.equal(weights, seen[-1][name]), f"{name} counts batches"


def test_training_does_not_read_it() -> None:
    averaged_too, seen = learned(3)
    newest, alone = learned(3, "train.ema_decay=0")
    for name, weights in seen[-1].items():
        assert torch.equal(weights, alone[-1][name]), name
        assert torch.equal(newest[name], alone[-1][name]), f"{name}: without an average the newest are it"
    assert any(not torch.equal(weights, seen[-1][name]) for name, weights in averaged_too.items())


def test_a_class_that_is_seen_late_begins_with_its_first_prototype() -> None:
    learner, average = small_learner(), Average(0.9)
    table = np.zeros((GOALS, DIM), np.float32)
    for update in range(30):
        table[0] = update
        if update >= 28:
            table[1] = 5.0
        learner.goals.load_state_dict(learner.goals.state_dict() | {"table": torch.from_numpy(table.copy())})
        average.update(learner.agent, learner.goals)
    kept = average.state_dict()
    found, now = kept["table"], learner.goals.state_dict()
    _, named = averaged({"agent": {}, "prototypes": now, "average": kept})
    assert torch.equal(named["table"], found)
    assert not torch.equal(found, now["table"])
    assert torch.equal(named["seen"], now["seen"])
    assert 0 < found[0, 0] < 29
    assert torch.equal(found[1], torch.full((DIM,), 5.0))
    assert not found[2].any()


def test_what_is_no_number_or_changes_its_shape_is_as_it_is_now() -> None:
    """An extractor of one's own may keep anything that a checkpoint can hold."""
    goals, average = small_learner().goals, Average(0.9)
    kept = torch.zeros(2, dtype=torch.int64)
    for update in range(4):
        kept[0] = update
        state = {
            "weight": torch.full((3,), float(update)),
            "memory": torch.ones(update),
            "count": kept,
            "_extra_state": {"seen": update},
        }
        average.update(SimpleNamespace(state_dict=lambda state=state: state), goals)
    kept[0] = 100
    found = average.state_dict()["agent"]
    assert 0 < found["weight"][0] < 3
    assert found["memory"].tolist() == [1, 1, 1]
    assert found["count"].tolist() == [3, 0], "a copy"
    assert found["_extra_state"] == {"seen": 3}
    again = Average(0.9)
    again.load_state_dict(average.state_dict(), torch.device("cpu"))
    assert again.state_dict()["agent"].keys() == found.keys()


def test_a_learner_goes_on_with_its_average() -> None:
    learner, again = small_learner(), small_learner()
    for one in (learner, again):
        fill_store(one.goals)
    batch = make_batch(OUTCOMES)
    learner.update(batch, goals_for(batch))
    again.load_state_dict(copy.deepcopy(learner.state_dict()))
    again.goals.store.rng_state = learner.goals.store.rng_state
    for one in (learner, again):
        one.update(batch, goals_for(batch))
    ours, theirs = (averaged(one.state_dict())[0] for one in (learner, again))
    for name, weights in ours.items():
        assert torch.equal(weights, theirs[name]), name


def test_a_state_without_one_is_read_as_it_is() -> None:
    learner = small_learner("train.ema_decay=0")
    weights, prototypes = averaged(learner.state_dict())
    assert all(torch.equal(weights[name], own) for name, own in learner.agent.state_dict().items())
    assert torch.equal(prototypes["table"], learner.goals.state_dict()["table"])
