"""Prototypes against means taken class by class in double precision."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import vhs

CLASSES, DIM = 4, 3
batches = st.lists(
    st.integers(0, 8).flatmap(
        lambda n: st.tuples(
            hnp.arrays(np.float32, (n, DIM), elements=st.floats(-2, 2, width=32)),
            hnp.arrays(np.int64, n, elements=st.integers(0, CLASSES - 1)),
        )
    ),
    max_size=6,
)


@given(batches, st.floats(0, 1))
def test_the_table_is_the_running_mean(batches: list, momentum: float) -> None:
    prototypes = vhs.Prototypes(CLASSES, DIM, momentum)
    table, seen = np.zeros((CLASSES, DIM)), np.zeros(CLASSES, bool)
    for features, labels in batches:
        prototypes.update(features, labels)
        for label in np.unique(labels):
            mean = features[labels == label].astype(np.float64).mean(0)
            past = momentum if seen[label] else 0.0
            table[label] = past * table[label] + (1 - past) * mean
            seen[label] = True
    np.testing.assert_allclose(prototypes.table, table, atol=2e-6)
    np.testing.assert_array_equal(prototypes.seen, seen)
    assert prototypes.table.dtype == np.float32


def test_momentum_zero_is_the_exact_mean_of_the_last_batch() -> None:
    prototypes = vhs.Prototypes(1, 1, momentum=0)
    prototypes.update([[100.0]], [0])
    prototypes.update([[1.0], [2.0], [6.0]], [0, 0, 0])
    assert prototypes.table.tolist() == [[3.0]]


def test_an_unseen_class_embeds_as_fresh_noise() -> None:
    prototypes = vhs.Prototypes(2, 10_000, seed=4)
    prototypes.update(np.full((1, 10_000), 7, np.float32), [1])
    first, second = prototypes.embed([0, 1, 0]), prototypes.embed([0, 1, 0])
    assert (first[1] == 7).all()
    noise = np.stack([first[0], first[2], second[0], second[2]])
    assert len({row.tobytes() for row in noise}) == 4
    assert abs(noise.mean()) < 0.03  # six standard deviations of the mean of 40,000
    assert abs(noise.std() - 1) < 0.03


@given(batches, st.integers(0, 2**64 - 1))
def test_a_restored_table_goes_on_alike(batches: list, seed: int) -> None:
    prototypes = vhs.Prototypes(CLASSES, DIM, seed=seed)
    for features, labels in batches:
        prototypes.update(features, labels)
    prototypes.embed([0, 1])
    other = vhs.Prototypes(CLASSES, DIM, seed=seed ^ 1)
    other.load_state_dict(prototypes.state_dict())
    out = np.empty((4, DIM), np.float32)
    assert other.embed([0, 1, 2, 3], out=out) is out
    np.testing.assert_array_equal(out, prototypes.embed([0, 1, 2, 3]))


def test_the_table_is_a_copy() -> None:
    prototypes = vhs.Prototypes(1, 2)
    prototypes.update([[1.0, 2.0]], [0])
    prototypes.table[:] = 9
    prototypes.state_dict()["table"][:] = 9
    assert prototypes.table.tolist() == [[1.0, 2.0]]
    assert (prototypes.num_classes, prototypes.dim, prototypes.momentum) == (1, 2, 0.9)
    assert repr(prototypes) == "Prototypes(num_classes=1, dim=2, seen=1)"
