"""Every refusal is typed, says what was expected and found, can be pickled, and changes nothing."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

import vhs

from .bad_calls import BAD_CALLS
from .bad_world import FRAME, Call, World
from .naive import FRAME_SHAPE, FrameSource
from .test_episodes import add_episode, make_buffer


@pytest.fixture
def world(tmp_path: Path) -> World:
    frames = FrameSource()
    store = vhs.GoalStore(4, FRAME_SHAPE, 3)
    store.push(frames.next(), 1)
    prototypes = vhs.Prototypes(4, 2)
    prototypes.update([[1.0, 2.0]], [1])
    buffer = make_buffer()
    for _ in range(5):
        add_episode(buffer, frames, length=3)
    for stream in range(3):
        buffer.begin(stream, frames.next(), 0, 0)
    buffer.append(0, 0, 0.0, 0.0, frames.next())
    for _ in range(4):
        buffer.append(2, 0, 0.0, 0.0, frames.next())
    (tmp_path / "damaged.goals").write_bytes(b"x" * 64)
    return World(store, prototypes, buffer, buffer.gather([4]), tmp_path)


def test_the_world_is_as_described(world: World) -> None:
    assert world.buffer.ids.tolist() == [2, 3, 4]
    assert world.buffer.open.all()


@pytest.mark.parametrize(("expected", "message", "call"), BAD_CALLS, ids=[row[1] for row in BAD_CALLS])
def test_bad_input_is_refused_and_changes_nothing(
    world: World, expected: type[Exception], message: str, call: Call
) -> None:
    before = world.snapshot()
    with pytest.raises(expected) as caught:
        call(world)
    assert type(caught.value) is expected
    assert message in str(caught.value)
    assert world.snapshot() == before
    copy = pickle.loads(pickle.dumps(caught.value))
    assert type(copy) is expected
    assert str(copy) == str(caught.value)


def test_an_episode_cannot_be_finished_twice(world: World) -> None:
    world.buffer.finish(0, "success")
    for again in (lambda: world.buffer.finish(0, "success"), lambda: world.buffer.abort(0)):
        with pytest.raises(vhs.ProtocolError, match="expected an open episode, found none"):
            again()
    with pytest.raises(vhs.ProtocolError, match="`append` on stream 0"):
        world.buffer.append(0, 0, 0.0, 0.0, FRAME)
    with pytest.raises(vhs.ProtocolError, match="`observe` on stream 0"):
        world.buffer.observe()


def test_one_array_cannot_be_written_and_read_at_once() -> None:
    rewards = np.ones((2, 3), np.float32)
    with pytest.raises(vhs.LayoutError, match="in use by another call"):
        vhs.discounted_returns(rewards, [3, 3], 0.5, out=rewards)
    assert (rewards == 1).all()


def test_every_error_class_has_a_row_above() -> None:
    classes = {
        value for value in vars(vhs).values() if isinstance(value, type) and issubclass(value, vhs.VhsError)
    }
    assert classes - {vhs.VhsError} == {row[0] for row in BAD_CALLS} - {KeyError, TypeError}


@pytest.mark.parametrize(
    ("error", "builtin"),
    [
        (vhs.VhsError, Exception),
        (vhs.ShapeError, ValueError),
        (vhs.DtypeError, TypeError),
        (vhs.LayoutError, ValueError),
        (vhs.ArgumentError, ValueError),
        (vhs.LabelError, IndexError),
        (vhs.NonFiniteError, ValueError),
        (vhs.EmptyError, LookupError),
        (vhs.EpisodeError, LookupError),
        (vhs.ProtocolError, RuntimeError),
        (vhs.OutOfMemoryError, MemoryError),
        (vhs.DamagedFileError, ValueError),
        (vhs.UnsupportedError, NotImplementedError),
    ],
)
def test_errors_derive_from_the_fitting_builtin(error: type[Exception], builtin: type[Exception]) -> None:
    assert issubclass(error, builtin)
    assert issubclass(error, vhs.VhsError)
    assert error.__module__ == "vhs._core"
    assert error.__doc__
