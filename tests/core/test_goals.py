"""The goal store against plain lists."""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import vhs

from .naive import FRAME_SHAPE, STACK, FrameSource
from .test_episodes import add_episode, make_buffer

CLASSES = 4
pushes = st.lists(st.integers(0, CLASSES - 1), min_size=1, max_size=40)


def filled(labels: list[int], capacity: int = 6, seed: int = 0) -> tuple[vhs.GoalStore, list[list[bytes]]]:
    store, frames = vhs.GoalStore(CLASSES, FRAME_SHAPE, capacity, seed), FrameSource()
    lists: list[list[bytes]] = [[] for _ in range(CLASSES)]
    for label in labels:
        image = frames.next()
        store.push(image, label)
        lists[label] = [*lists[label], image.tobytes()][-capacity:]
    return store, lists


@given(pushes, st.integers(1, 8))
def test_a_class_holds_its_newest_images(labels: list[int], capacity: int) -> None:
    store, lists = filled(labels, capacity)
    assert store.counts.tolist() == [len(images) for images in lists]
    assert len(store) == sum(len(images) for images in lists)
    for label, images in enumerate(lists):
        if images:
            # A stored image is missing from so many draws with probability below 1e-20.
            drawn = store.sample_class(label, 60 * len(images))
            assert {image.tobytes() for image in drawn} == set(images)


@given(pushes, st.integers(1, 40), st.integers(0, 2**64 - 1))
def test_balanced_batches_are_as_equal_as_can_be(labels: list[int], n: int, seed: int) -> None:
    store, lists = filled(labels, seed=seed)
    images, drawn = store.sample(n)
    assert images.shape == (n, *FRAME_SHAPE)
    assert all(image.tobytes() in lists[label] for image, label in zip(images, drawn, strict=True))
    present = [label for label, stored in enumerate(lists) if stored]
    counts = Counter(drawn.tolist())
    assert {counts[label] for label in present} <= {n // len(present), n // len(present) + 1}


@given(pushes, st.booleans())
def test_same_seed_same_batches_with_and_without_out(labels: list[int], balanced: bool) -> None:
    (first, _), (second, _) = filled(labels, seed=3), filled(labels, seed=3)
    images, drawn = first.sample(9, balanced=balanced)
    out = np.zeros((9, *FRAME_SHAPE), np.uint8)
    returned, again = second.sample(9, balanced=balanced, out=out)
    assert returned is out
    np.testing.assert_array_equal(out, images)
    np.testing.assert_array_equal(drawn, again)
    label = labels[0]
    assert second.sample_class(label, 9, out=out) is out
    np.testing.assert_array_equal(out, first.sample_class(label, 9))


def test_labels_of_wrongly_reached_objects_never_enter() -> None:
    buffer, frames = make_buffer(capacity_steps=200), FrameSource()
    said = [(goal, outcome) for goal in range(4) for outcome in vhs.Outcome for _ in range(2)]
    ids = [add_episode(buffer, frames, goal=goal, outcome=outcome) for goal, outcome in said]
    store = vhs.GoalStore(CLASSES, (STACK, *FRAME_SHAPE), 10)
    assert store.collect(buffer, ids) == 8
    batch = buffer.gather(ids)
    finals = batch.observations[batch.offsets + batch.lengths]
    for goal in range(CLASSES):
        successes = (batch.goals == goal) & (batch.outcomes == vhs.Outcome.SUCCESS)
        drawn = {image.tobytes() for image in store.sample_class(goal, 200)}
        assert drawn == {image.tobytes() for image in finals[successes]}
    assert store.collect(buffer, []) == 0


def test_collect_refuses_all_or_nothing() -> None:
    buffer, frames = make_buffer(capacity_steps=200), FrameSource()
    good = add_episode(buffer, frames, goal=0, outcome=vhs.Outcome.SUCCESS)
    beyond = add_episode(buffer, frames, goal=4, outcome=vhs.Outcome.SUCCESS)
    store = vhs.GoalStore(CLASSES, (STACK, *FRAME_SHAPE), 10)
    with pytest.raises(vhs.LabelError, match=r"`goal`: expected a number in 0\.\.4, got 4"):
        store.collect(buffer, [good, beyond])
    with pytest.raises(vhs.EpisodeError):
        store.collect(buffer, [good, 99])
    other = vhs.GoalStore(CLASSES, FRAME_SHAPE, 10)
    with pytest.raises(vhs.ShapeError):
        other.collect(buffer, [good])
    assert len(store) == len(other) == 0


def test_collect_takes_images_of_bytes_alone() -> None:
    buffer = vhs.EpisodeBuffer((2,), num_streams=1, max_episode_steps=3, capacity_steps=30, dtype=np.float32)
    buffer.begin(0, np.zeros(2, np.float32), 0)
    buffer.append(0, 0, 1.0, 0.0, np.ones(2, np.float32))
    id = buffer.finish(0, vhs.Outcome.SUCCESS)
    store = vhs.GoalStore(1, (2, 2), 10)
    with pytest.raises(
        vhs.ArgumentError, match=r"`buffer`: expected observations of unsigned bytes, .* got F32"
    ):
        store.collect(buffer, [id])
    assert len(store) == 0


@given(pushes, pushes)
def test_a_loaded_store_goes_on_alike(before: list[int], after: list[int]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "store.goals"
        saved, _ = filled(before)
        saved.sample(3)
        saved.save(path)
        loaded = vhs.GoalStore.load(str(path))
    frames = FrameSource()
    for label in after:
        image = frames.next()
        saved.push(image, label)
        loaded.push(image, label)
    assert (loaded.num_classes, loaded.observation_shape) == (CLASSES, FRAME_SHAPE)
    assert loaded.capacity_per_class == saved.capacity_per_class
    for left, right in zip(saved.sample(50), loaded.sample(50), strict=True):
        np.testing.assert_array_equal(left, right)


def test_saving_leaves_one_file_and_damage_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "store.goals"
    store, _ = filled([0, 1, 1])
    store.save(path)
    store.save(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["store.goals"]
    whole = path.read_bytes()
    for damaged in [b"", whole[:-1], whole + b"\0", whole[:-9] + b"\xff" + whole[-8:], b"x" * len(whole)]:
        path.write_bytes(damaged)
        with pytest.raises(vhs.DamagedFileError, match=r"expected .* found"):
            vhs.GoalStore.load(path)


def test_errors_of_the_system_are_its_own(tmp_path: Path) -> None:
    store, _ = filled([0])
    with pytest.raises(FileNotFoundError, match=r"missing\.goals") as caught:
        vhs.GoalStore.load(tmp_path / "missing.goals")
    assert caught.value.filename == str(tmp_path / "missing.goals")
    with pytest.raises(FileNotFoundError):
        store.save(tmp_path / "no-folder" / "store.goals")
    with pytest.raises(IsADirectoryError):
        store.save(tmp_path)


def test_memory_grows_as_the_rings_fill() -> None:
    store = vhs.GoalStore(5, (84, 84, 3), 2**30)
    assert store.nbytes == 0
    for _ in range(100):
        store.push(np.zeros((84, 84, 3), np.uint8), 1)
    assert 100 * 21168 <= store.nbytes <= 100 * 21168 + 2**20
    assert repr(store) == "GoalStore(observation_shape=[84, 84, 3], counts=[0, 100, 0, 0, 0])"
