"""Untidy arrays may come in; what goes out is tidy, writable and shared with torch."""

from __future__ import annotations

import numpy as np
import pytest

import vhs

from .naive import FRAME_SHAPE, STACK, FrameSource
from .test_episodes import add_episode, make_buffer
from .test_fields import recorded


def one_of_each() -> dict[str, np.ndarray]:
    """Every array that vhs hands out."""
    buffer = make_buffer(capacity_steps=60)
    ids = [add_episode(buffer, FrameSource(), outcome=outcome) for outcome in vhs.Outcome]
    buffer.begin(0, np.zeros(FRAME_SHAPE, np.uint8), 0, 0)
    store = vhs.GoalStore(5, (STACK, *FRAME_SHAPE), 4)
    store.collect(buffer, ids)
    prototypes = vhs.Prototypes(3, 2)
    batch = buffer.sample_episodes(4, relabel="final")
    arrays = {name: getattr(batch, name) for name in dir(batch) if not name.startswith("_")}
    hindsight = arrays.pop("hindsight")
    assert arrays.pop("desired_goals") is arrays.pop("achieved_goals") is None  # goals are labels here
    for kind, rows in [
        ("step", buffer.sample_transitions(4, "final")),
        ("part", buffer.sample_windows(4, 2)),
    ]:
        named = {f"{kind} {name}": getattr(rows, name) for name in dir(rows) if not name.startswith("_")}
        arrays |= {name: array for name, array in named.items() if array is not None}
    assert (
        arrays.pop("fields") == arrays.pop("step fields") == arrays.pop("part fields") == {}
    )  # there are none
    assert arrays.pop("step next_fields") == {}
    arrays |= {f"field {name}": array for name, array in recorded().sample_windows(3, 2).fields.items()}
    arrays |= {f"new {name}": getattr(hindsight, name) for name in ("selected", "goal_rows", "interactions")}
    arrays |= {"observed": buffer.observe([0]), "ids": buffer.ids, "open": buffer.open}
    arrays |= {"goals": store.sample(3)[0], "labels": store.sample(3)[1], "counts": store.counts}
    arrays |= {"one class": store.sample_class(0, 2), "embedded": prototypes.embed([0, 1])}
    arrays |= {"table": prototypes.table, "seen": prototypes.seen, "rng": vhs.Rng(1).state}
    return arrays | {"returns": vhs.discounted_returns(batch.rewards, batch.lengths, 0.9)}


@pytest.mark.parametrize("name", one_of_each())
def test_results_are_tidy_and_torch_shares_their_memory(name: str) -> None:
    torch = pytest.importorskip("torch")
    array = one_of_each()[name]
    assert isinstance(array, np.ndarray)
    assert array.flags.writeable
    assert array.flags.c_contiguous
    assert array.flags.aligned
    assert torch.from_numpy(array).data_ptr() == array.ctypes.data


def test_results_outlive_what_made_them_and_are_not_shared() -> None:
    store = vhs.GoalStore(1, (3,), 2)
    store.push(np.array([1, 2, 3], np.uint8), 0)
    first, _ = store.sample(1)
    first[:] = 0
    second, _ = store.sample(1)
    del store
    assert second.tolist() == [[1, 2, 3]]


def test_arguments_are_copied_in() -> None:
    image = np.array([1, 2, 3], np.uint8)
    store = vhs.GoalStore(1, (3,), 2)
    store.push(image, 0)
    image[:] = 0
    assert store.sample_class(0, 1).tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    "untidy",
    [
        lambda image: np.asfortranarray(image),
        lambda image: np.repeat(image, 2, axis=1)[:, ::2],
        lambda image: image[::-1][::-1],
        lambda image: np.ascontiguousarray(image.T).T,
    ],
    ids=["fortran", "strided", "reversed twice", "transposed"],
)
def test_images_of_any_layout_are_stored_as_they_look(untidy: object) -> None:
    image = np.arange(12, dtype=np.uint8).reshape(3, 4)
    store = vhs.GoalStore(1, (3, 4), 1)
    store.push(untidy(image), 0)
    np.testing.assert_array_equal(store.sample_class(0, 1)[0], image)


def test_read_only_images_are_accepted() -> None:
    image = np.arange(3, dtype=np.uint8)
    image.flags.writeable = False
    store = vhs.GoalStore(1, (3,), 1)
    store.push(image, 0)
    assert store.sample_class(0, 1).tolist() == [[0, 1, 2]]


def test_torch_tensors_are_accepted() -> None:
    torch = pytest.importorskip("torch")
    prototypes = vhs.Prototypes(2, 2)
    prototypes.update(torch.tensor([[1.0, 2.0]]), torch.tensor([1]))
    assert prototypes.embed(torch.tensor([1])).tolist() == [[1.0, 2.0]]


def test_a_tensor_with_a_gradient_says_what_to_do() -> None:
    torch = pytest.importorskip("torch")
    features = torch.zeros((1, 2), requires_grad=True)
    with pytest.raises(vhs.DtypeError, match=r"`features`: expected an array, got Tensor \(.*detach"):
        vhs.Prototypes(2, 2).update(features, [1])


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int32, np.uint64, ">i8"])
def test_any_integer_type_will_do_for_labels(dtype: object) -> None:
    prototypes = vhs.Prototypes(3, 1)
    prototypes.update(np.array([[1], [2]], np.float64), np.array([0, 2], dtype))
    assert prototypes.table.ravel().tolist() == [1, 0, 2]


def test_numpy_scalars_will_do_for_numbers() -> None:
    buffer = make_buffer()
    buffer.begin(np.int64(1), np.zeros(FRAME_SHAPE, np.uint8), np.int32(2), np.uint8(1))
    buffer.append(np.int64(1), np.int64(4), np.float32(0.5), np.float64(0.25), np.ones(FRAME_SHAPE, np.uint8))
    batch = buffer.gather([buffer.finish(np.int64(1), np.int64(1))])
    assert (batch.goals[0], batch.interactions[0], batch.actions[0, 0]) == (2, 1, 4)
    assert (batch.rewards[0, 0], batch.values[0, 0]) == (0.5, 0.25)


def test_a_larger_out_is_used_from_its_beginning() -> None:
    buffer, frames = make_buffer(), FrameSource()
    ids = [add_episode(buffer, frames, length=length) for length in (2, 3)]
    out = np.full((20, STACK, *FRAME_SHAPE), 255, np.uint8)
    batch = buffer.gather(ids, out=out)
    assert batch.observations.base is out
    np.testing.assert_array_equal(batch.observations, buffer.gather(ids).observations)
    assert (out[7:] == 255).all()


def unaligned(values: list[int]) -> np.ndarray:
    """Contiguous integers that begin at an odd byte, as those of a packed message do."""
    array = np.frombuffer(b"\0" + np.array(values, np.int64).tobytes(), np.int64, offset=1)
    assert array.flags.c_contiguous
    assert not array.flags.aligned
    return array


def test_arrays_that_are_not_aligned_are_read_as_what_they_are() -> None:
    prototypes = vhs.Prototypes(3, 4)
    assert prototypes.embed(unaligned([1, 2])).shape == (2, 4)
    buffer, frames = make_buffer(), FrameSource()
    ids = [add_episode(buffer, frames, outcome=vhs.Outcome.SUCCESS) for _ in range(2)]
    assert buffer.gather(unaligned(ids)).ids.tolist() == ids
    store = vhs.GoalStore(5, (STACK, *FRAME_SHAPE), 4)
    assert store.collect(buffer, unaligned(ids)) == 2
    state = vhs.Rng(3).state
    copy = np.frombuffer(b"\0" + state.tobytes(), np.uint64, offset=1)
    assert vhs.Rng.from_state(copy).state.tolist() == state.tolist()


def test_an_out_that_is_not_aligned_is_refused() -> None:
    prototypes = vhs.Prototypes(3, 2)
    room = np.frombuffer(bytearray(1 + 2 * 2 * 4), np.float32, offset=1).reshape(2, 2)
    with pytest.raises(vhs.VhsError, match="`out`: expected an aligned array"):
        prototypes.embed([0, 1], out=room)


def test_every_true_byte_of_a_boolean_array_is_true() -> None:
    mask = np.array([0, 255, 2], np.uint8).view(np.bool_)
    prototypes = vhs.Prototypes(3, 1)
    prototypes.load_state_dict(prototypes.state_dict() | {"seen": mask})
    assert prototypes.seen.view(np.uint8).tolist() == [0, 1, 1]
    buffer = make_buffer()
    add_episode(buffer, FrameSource(), length=3)
    rows = buffer.sample_transitions(
        3, "final", probability=1.0, reward=lambda achieved, goals: (np.zeros(3), mask)
    )
    assert rows.terminated.view(np.uint8).tolist() == [0, 1, 1]
    assert not (rows.terminated & rows.truncated).any()
