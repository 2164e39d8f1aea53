"""Every way to go wrong that we could think of, one row each; `test_errors` runs them."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import vhs
from vhs._core import RasterCanvas, RasterScene, RasterSource

from .naive import FRAME_SHAPE
from .test_episodes import make_buffer

FRAME = np.zeros(FRAME_SHAPE, np.uint8)
HUGE = 2**62


@dataclass
class World:
    """One of each, in use: stream 0 open with a step, 1 open without, 2 full, episode 0 evicted."""

    store: vhs.GoalStore
    prototypes: vhs.Prototypes
    buffer: vhs.EpisodeBuffer
    batch: vhs.EpisodeBatch
    folder: Path

    def snapshot(self) -> list[bytes]:
        """All state that a call could change, generators included."""
        self.store.save(self.folder / "snapshot.goals")
        arrays = [
            *self.prototypes.state_dict().values(),
            self.buffer.rng_state,
            self.buffer.observe(self.buffer.open.nonzero()[0]),
            self.buffer.ids,
            self.buffer.open,
            self.buffer.gather(self.buffer.ids).observations,
            np.array(self.buffer.num_steps),
        ]
        return [(self.folder / "snapshot.goals").read_bytes(), *(array.tobytes() for array in arrays)]


Call = Callable[[World], object]


def read_only(shape: tuple[int, ...]) -> np.ndarray:
    array = np.zeros(shape, np.uint8)
    array.flags.writeable = False
    return array


def sizes(**changes: object) -> Call:
    """A buffer built with some of its settings changed."""
    return lambda _: make_buffer(**changes)


def new_buffer(**arguments: object) -> vhs.EpisodeBuffer:
    """A buffer of tiny frames with these arguments besides."""
    return vhs.EpisodeBuffer((1,), num_streams=1, max_episode_steps=2, capacity_steps=2, **arguments)


def new_store(*arguments: object) -> Call:
    return lambda _: vhs.GoalStore(*arguments)


def new_prototypes(*arguments: object) -> Call:
    return lambda _: vhs.Prototypes(*arguments)


def push(observation: object, label: object) -> Call:
    return lambda world: world.store.push(observation, label)


def append(*arguments: object) -> Call:
    return lambda world: world.buffer.append(*arguments)


def append_batch(*arguments: object) -> Call:
    return lambda world: world.buffer.append_batch(*arguments)


def begin(*arguments: object) -> Call:
    return lambda world: world.buffer.begin(*arguments)


def relabel(**arguments: object) -> Call:
    return lambda world: vhs.relabel(world.batch, **({"rng": 0} | arguments))


def returns(*arguments: object, **out: object) -> Call:
    return lambda _: vhs.discounted_returns(*arguments, **out)


def update(features: object, labels: object) -> Call:
    return lambda world: world.prototypes.update(features, labels)


def sample(*arguments: object, **out: object) -> Call:
    return lambda world: world.store.sample(*arguments, **out)


def restore(**changes: object) -> Call:
    return lambda world: world.prototypes.load_state_dict(world.prototypes.state_dict() | changes)


def new_scene() -> RasterScene:
    return RasterScene(8, 4, 1, 10.0)


def new_source(kind: int = 2) -> RasterSource:
    """One geom of this type, of which nothing else is known, and no light."""
    flags = np.zeros(12, np.uint8)
    flags[10] = 1  # cull faces
    return RasterSource(
        geoms=np.array([[kind]], np.int32).view(np.uint8), geom_places=[0, *[None] * 19],
        lights=np.zeros((0, 4), np.uint8), light_places=[None] * 12, flags=flags, geom_size=np.zeros((1, 3)),
        mat_texid=np.zeros((0, 10), np.int32), mat_texuniform=np.zeros(0, np.uint8),
        mat_texrepeat=np.zeros((0, 2), np.float32), textures=[], meshes=[], line_width=1.0,
    )  # fmt: skip


def new_canvas(height: int = 5, kind: int = 2) -> RasterCanvas:
    return RasterCanvas(new_scene(), new_source(kind), height, 5, 0)


def posed_canvas(x: float) -> RasterCanvas:
    """A canvas that is bound to a simulation of one ball at `x` and one camera."""
    at, turned, none = np.array([[x, 0.0, 0.0]]), np.eye(3).reshape(1, 9), np.zeros((0, 3))
    canvas = new_canvas()
    canvas.bind(at, turned, none, np.zeros((0, 9)), np.zeros((1, 3)), turned)
    return canvas


def raster_texture(data: np.ndarray) -> Call:
    return lambda _: new_scene().add_texture(False, data)


def raster_mesh(**changes: np.ndarray) -> Call:
    floats, ints = np.zeros((3, 3), np.float32), np.zeros((1, 3), np.int32)
    mesh = {
        "vertices": floats, "normals": floats, "uv": np.zeros((0, 2), np.float32), "faces": ints,
        "face_normals": ints, "face_uv": np.zeros((0, 3), np.int32),
    }  # fmt: skip
    return lambda _: new_scene().add_mesh(**(mesh | changes))


def raster_canvas(**changes: int) -> Call:
    return lambda _: new_canvas(**changes)


NAN, INF = float("nan"), float("inf")
IMAGES = np.zeros((4, *FRAME_SHAPE), np.uint8)

# (class, part of the message, call). One row a way to go wrong.
BAD_CALLS: list[tuple[type[Exception], str, Call]] = [
    # Sizes
    (vhs.ArgumentError, "`num_classes`: expected a number in 1..=1048576, got 0", new_store(0, (2,), 3)),
    (
        vhs.ArgumentError,
        "`num_classes`: expected a number in 0..=9223372036854775807, got -1",
        new_store(-1, (2,), 3),
    ),
    (
        vhs.ArgumentError,
        "`num_classes`: expected a number in 1..=1048576, got 4611686018427387904",
        new_store(HUGE, (2,), 3),
    ),
    (vhs.ArgumentError, "`capacity_per_class`: expected a number in 0..=", new_store(4, (2,), -5)),
    (vhs.ArgumentError, "`capacity_per_class`: expected a number in 1..=", new_store(4, (2,), 0)),
    (vhs.ArgumentError, "`capacity_per_class`: expected a total of at most", new_store(4, (2,), HUGE)),
    (vhs.ArgumentError, "`capacity_per_class`: expected a number in 0..=", new_store(4, (2,), 2**70)),
    (vhs.ArgumentError, "`observation_shape`: expected one or more sizes", new_store(4, (), 3)),
    (vhs.ArgumentError, "`observation_shape`: expected one or more sizes", new_store(4, (84, 0, 3), 3)),
    (vhs.ArgumentError, "`observation_shape`: expected a total of at most", new_store(4, (HUGE, HUGE), 3)),
    (vhs.DtypeError, "`observation_shape`: expected a sequence of sizes, got int", new_store(4, 84, 3)),
    (vhs.DtypeError, "`observation_shape`: expected an integer, got float", new_store(4, (84.5, 84), 3)),
    (vhs.DtypeError, "`num_classes`: expected an integer, got str", new_store("4", (2,), 3)),
    (vhs.DtypeError, "`num_classes`: expected an integer, got bool", new_store(True, (2,), 3)),
    (vhs.ArgumentError, "`seed`: expected an integer in 0..2**64, got -1", new_store(4, (2,), 3, -1)),
    (vhs.DtypeError, "`seed`: expected an integer, got str", new_store(4, (2,), 3, "x")),
    (vhs.ArgumentError, "`dim`: expected a number in 1..=", new_prototypes(4, 0)),
    (vhs.ArgumentError, "`dim`: expected a total of at most", new_prototypes(4, HUGE)),
    (vhs.OutOfMemoryError, "Prototypes: expected room for", new_prototypes(1, 2**55)),
    (vhs.ArgumentError, "`momentum`: expected a number in 0..=1, got 1.5", new_prototypes(4, 2, 1.5)),
    (vhs.ArgumentError, "`momentum`: expected a number in 0..=1, got NaN", new_prototypes(4, 2, NAN)),
    (vhs.ArgumentError, "`num_streams`: expected a number in 1..=", sizes(num_streams=0)),
    (vhs.ArgumentError, "`num_streams`: expected a number in 1..=", sizes(num_streams=HUGE)),
    (vhs.ArgumentError, "`max_episode_steps`: expected a number in 1..=", sizes(max_episode_steps=0)),
    (
        vhs.ArgumentError,
        "`capacity_steps`: expected at least num_streams * max_episode_steps = 12, got 11",
        sizes(capacity_steps=11),
    ),
    (
        vhs.ArgumentError,
        "`num_actions`: expected at least num_interactions = 3, got 2",
        lambda _: new_buffer(num_actions=2, num_interactions=3),
    ),
    (
        vhs.ArgumentError,
        "`num_actions`: expected either it or first_interaction_action, got both",
        lambda _: new_buffer(num_actions=4, first_interaction_action=3),
    ),
    # How to relabel, where nothing says that anything is
    (
        vhs.ArgumentError,
        '`ratio`: expected a strategy beside it, such as relabel="final", got relabel=None',
        lambda world: world.buffer.sample_transitions(4, ratio=4),
    ),
    (
        vhs.ArgumentError,
        "`reward`: expected a strategy beside it",
        lambda world: world.buffer.sample_transitions(4, reward=vhs.SparseReward()),
    ),
    (
        vhs.ArgumentError,
        "`probability`: expected a strategy beside it",
        lambda world: world.buffer.sample_windows(4, 2, probability=0.5),
    ),
    (
        vhs.ArgumentError,
        "`on`: expected a strategy beside it",
        lambda world: world.buffer.sample_episodes(4, on=("failure",)),
    ),
    # Goals that are missing, or of no use
    (
        vhs.DtypeError,
        "`desired_goal`: expected an array of shape [2], got None",
        lambda _: new_buffer(goals="vectors", goal_shape=(2,)).begin(0, np.zeros(1, np.uint8)),
    ),
    (
        vhs.ArgumentError,
        '`desired_goal`: expected None where goals are "labels", got an array',
        lambda _: new_buffer().begin(0, np.zeros(1, np.uint8), desired_goal=[1]),
    ),
    # What is not pickled
    (TypeError, "EpisodeBuffer is not pickled or copied", lambda world: copy.deepcopy(world.buffer)),
    (TypeError, "GoalStore is not pickled or copied", lambda world: pickle.dumps(world.store)),
    (vhs.ArgumentError, "`capacity_steps`: expected a number in 0..=", sizes(capacity_steps=-1)),
    (vhs.ArgumentError, "`capacity_steps`: expected a total of at most", sizes(capacity_steps=HUGE)),
    (vhs.ArgumentError, "`frame_stack`: expected a number in 1..=", sizes(frame_stack=0)),
    (vhs.ArgumentError, "`num_goals`: expected a number in 1..=", sizes(num_goals=0)),
    (vhs.ArgumentError, "`num_interactions`: expected a number in 0..=", sizes(num_interactions=HUGE)),
    (
        vhs.ArgumentError,
        "`actions`: expected a number in 1..=",
        sizes(num_interactions=0, first_interaction_action=0),
    ),
    # Goals
    (vhs.ShapeError, "`observation`: expected shape [2, 3], got [3, 2]", push(np.zeros((3, 2), np.uint8), 0)),
    (vhs.ShapeError, "`observation`: expected shape [2, 3], got [6]", push(np.zeros(6, np.uint8), 0)),
    (vhs.DtypeError, "`observation`: expected uint8, got float32", push(np.zeros((2, 3), np.float32), 0)),
    (vhs.DtypeError, "`observation`: expected uint8, got int64", push([[0, 0, 0]] * 2, 0)),
    (vhs.DtypeError, "`observation`: expected uint8, got object", push(None, 0)),
    (vhs.LabelError, "`label`: expected a number in 0..4, got 4", push(FRAME, 4)),
    (vhs.LabelError, "`label`: expected a number in 0..4, got -1", push(FRAME, -1)),
    (vhs.DtypeError, "`label`: expected an integer, got float", push(FRAME, 1.0)),
    (
        vhs.EmptyError,
        "GoalStore: expected at least one image, found none",
        lambda _: vhs.GoalStore(4, (2,), 3).sample(1),
    ),
    (
        vhs.EmptyError,
        "GoalStore class 0: expected at least one image",
        lambda world: world.store.sample_class(0, 1),
    ),
    (
        vhs.LabelError,
        "`label`: expected a number in 0..4, got 9",
        lambda world: world.store.sample_class(9, 1),
    ),
    (vhs.ArgumentError, "`n`: expected a number in 1..=", sample(0)),
    (vhs.ArgumentError, "`n`: expected a number in 0..=", sample(-3)),
    (vhs.ArgumentError, "`n`: expected a total of at most", sample(HUGE)),
    (vhs.OutOfMemoryError, "sample: expected room for", sample(2**55)),
    (
        vhs.ShapeError,
        "`out`: expected shape [4, 2, 3], got [4, 3, 2]",
        sample(4, out=np.zeros((4, 3, 2), np.uint8)),
    ),
    (vhs.DtypeError, "`out`: expected an array of uint8, got int64", sample(4, out=IMAGES.astype(int))),
    (vhs.DtypeError, "`out`: expected an array of uint8, got list", sample(4, out=[0])),
    (
        vhs.LayoutError,
        "`out`: expected a C-contiguous array",
        sample(4, out=np.zeros((8, *FRAME_SHAPE), np.uint8)[::2]),
    ),
    (
        vhs.LayoutError,
        "`out`: expected an array free to be used, got a read-only one",
        sample(4, out=read_only((4, 2, 3))),
    ),
    (
        vhs.DamagedFileError,
        "`first bytes`: expected vhsgoals, found xxxxxxxx",
        lambda world: vhs.GoalStore.load(world.folder / "damaged.goals"),
    ),
    # Prototypes
    (vhs.ShapeError, "`features`: expected shape [1, 2], got [1, 3]", update([[1.0, 2.0, 3.0]], [0])),
    (vhs.ShapeError, "`features`: expected shape [2, 2], got [1, 2]", update([[1.0, 2.0]], [0, 1])),
    (
        vhs.LabelError,
        "`labels`: expected a number in 0..4, got 7 at index 1",
        update(np.zeros((2, 2)), [0, 7]),
    ),
    (
        vhs.NonFiniteError,
        "`features`: expected a finite number, got NaN at index 3",
        update([[0.0, 0.0], [0.0, NAN]], [0, 1]),
    ),
    (
        vhs.NonFiniteError,
        "`features`: expected a finite number, got inf at index 0",
        update([[INF, 0.0]], [0]),
    ),
    (vhs.DtypeError, "`features`: expected real numbers, got complex128", update([[1j, 0]], [0])),
    (vhs.DtypeError, "`labels`: expected integers, got float64", update([[0.0, 0.0]], [0.5])),
    (vhs.DtypeError, "`labels`: expected integers, got bool", update([[0.0, 0.0]], [True])),
    (vhs.ShapeError, "`labels`: expected shape [1], got [1, 1]", update([[0.0, 0.0]], [[0]])),
    (
        vhs.LabelError,
        "`labels`: expected a number in 0..4, got -1",
        lambda world: world.prototypes.embed([0, -1]),
    ),
    (
        vhs.ShapeError,
        "`out`: expected shape [1, 2], got [2]",
        lambda world: world.prototypes.embed([0], out=np.zeros(2, np.float32)),
    ),
    (
        vhs.ShapeError,
        "`table`: expected shape [4, 2], got [2, 4]",
        restore(table=np.zeros((2, 4), np.float32)),
    ),
    (
        vhs.NonFiniteError,
        "`table`: expected a finite number, got NaN",
        restore(table=np.full((4, 2), NAN, np.float32)),
    ),
    (vhs.ShapeError, "`seen`: expected shape [4], got [3]", restore(seen=np.zeros(3, bool))),
    (vhs.DtypeError, "`rng`: expected uint64, got int64", restore(rng=np.arange(4))),
    (vhs.ShapeError, "`rng`: expected shape [4], got [3]", restore(rng=np.arange(3, dtype=np.uint64))),
    (vhs.ArgumentError, "`rng`: expected a state that is not all zero", restore(rng=np.zeros(4, np.uint64))),
    (KeyError, "table", lambda world: world.prototypes.load_state_dict({})),
    # Episodes
    (
        vhs.ProtocolError,
        "`begin` on stream 0: expected a stream between episodes, found an open",
        begin(0, FRAME, 0, 0),
    ),
    (vhs.LabelError, "`stream`: expected a number in 0..3, got 3", begin(3, FRAME, 0, 0)),
    (vhs.LabelError, "`goal`: expected a number in 0..5, got 5", begin(1, FRAME, 5, 0)),
    (vhs.LabelError, "`interaction`: expected a number in 0..3, got 3", begin(1, FRAME, 0, 3)),
    (vhs.ShapeError, "`frame`: expected shape [2, 3], got [6]", begin(1, np.zeros(6, np.uint8), 0, 0)),
    (
        vhs.NonFiniteError,
        "`rewards`: expected a finite number, got NaN at index 0",
        append(0, 0, NAN, 0.0, FRAME),
    ),
    (
        vhs.NonFiniteError,
        "`values`: expected a finite number, got -inf at index 0",
        append(0, 0, 0.0, -INF, FRAME),
    ),
    (vhs.LabelError, "`actions`: expected a number in 0..6, got 6", append(0, 6, 0.0, 0.0, FRAME)),
    (vhs.LabelError, "`streams`: expected a number in 0..3, got -1", append(-1, 0, 0.0, 0.0, FRAME)),
    (vhs.ProtocolError, "`append` on stream 2: expected at most 4 steps", append(2, 0, 0.0, 0.0, FRAME)),
    (
        vhs.ShapeError,
        "`frame`: expected shape [2, 3], got [3, 2]",
        append(0, 0, 0.0, 0.0, np.zeros((3, 2), np.uint8)),
    ),
    (
        vhs.ArgumentError,
        "`streams`: expected each stream at most once, got stream 0 twice",
        append_batch([0, 0], [0, 0], [0, 0], [0, 0], IMAGES[:2]),
    ),
    (
        vhs.ProtocolError,
        "`append` on stream 2: expected at most",
        append_batch([0, 1, 2], [0] * 3, [0] * 3, [0] * 3, IMAGES[:3]),
    ),
    (
        vhs.NonFiniteError,
        "`rewards`: expected a finite number, got NaN at index 1",
        append_batch([0, 1], [0, 0], [0, NAN], [0, 0], IMAGES[:2]),
    ),
    (
        vhs.LabelError,
        "`actions`: expected a number in 0..6, got 9 at index 1",
        append_batch([0, 1], [0, 9], [0, 0], [0, 0], IMAGES[:2]),
    ),
    (
        vhs.ShapeError,
        "`actions`: expected shape [2], got [1]",
        append_batch([0, 1], [0], [0, 0], [0, 0], IMAGES[:2]),
    ),
    (
        vhs.ShapeError,
        "`frames`: expected shape [2, 2, 3], got [4, 2, 3]",
        append_batch([0, 1], [0, 0], [0, 0], [0, 0], IMAGES),
    ),
    (
        vhs.ProtocolError,
        "`finish` on stream 1: expected an open episode with at least one step",
        lambda world: world.buffer.finish(1, "failure"),
    ),
    (
        vhs.LabelError,
        "`stream`: expected a number in 0..3, got 5",
        lambda world: world.buffer.finish(5, "failure"),
    ),
    (
        vhs.ArgumentError,
        '`outcome`: expected "success" (0), "failure" (1), "timeout" (2), got "won"',
        lambda world: world.buffer.finish(0, "won"),
    ),
    (vhs.ArgumentError, "`outcome`: expected", lambda world: world.buffer.finish(0, 3)),
    (
        vhs.EpisodeError,
        "episode 0: expected an id of 2 or later, found one already evicted",
        lambda world: world.buffer.gather([0]),
    ),
    (
        vhs.EpisodeError,
        "episode 5: expected an id below 5, found one never given",
        lambda world: world.buffer.gather([4, 5]),
    ),
    (vhs.ArgumentError, "`ids`: expected a number in 1..=", lambda world: world.buffer.gather([])),
    (
        vhs.ShapeError,
        "`out`: expected shape [4, 12], got [3, 12]",
        lambda world: world.buffer.gather([4], out=np.zeros((3, 2, *FRAME_SHAPE), np.uint8)),
    ),
    (
        vhs.ShapeError,
        "`out`: expected shape [9, 2, 2, 3], got [9, 2, 6]",
        lambda world: world.buffer.gather([4], out=np.zeros((9, 2, 6), np.uint8)),
    ),
    (
        vhs.LabelError,
        "`stream`: expected a number in 0..3, got 3",
        lambda world: world.buffer.observe([0, 3]),
    ),
    (
        vhs.ShapeError,
        "`out`: expected shape [1, 2, 2, 3], got [2, 3]",
        lambda world: world.buffer.observe([0], out=FRAME),
    ),
    (
        vhs.EmptyError,
        "EpisodeBuffer: expected at least one finished episode",
        lambda _: make_buffer().sample_episodes(1),
    ),
    (vhs.ArgumentError, "`n`: expected a number in 1..=", lambda world: world.buffer.sample_episodes(0)),
    (
        vhs.ArgumentError,
        '`strategy`: expected "final", got "future"',
        lambda world: world.buffer.sample_episodes(1, relabel="future"),
    ),
    # Relabelling and returns
    (vhs.ArgumentError, '`strategy`: expected "final", got "best"', relabel(strategy="best")),
    (vhs.ArgumentError, "`probability`: expected a number in 0..=1, got 1.01", relabel(probability=1.01)),
    (vhs.ArgumentError, "`probability`: expected a number in 0..=1, got NaN", relabel(probability=NAN)),
    (vhs.ArgumentError, '`outcome`: expected "success" (0)', relabel(on=["lost"])),
    (vhs.DtypeError, "`on`: expected a sequence of outcomes", relabel(on="failure")),
    (vhs.DtypeError, "`seed`: expected an integer, got Generator", relabel(rng=np.random.default_rng(0))),
    (vhs.ShapeError, "`rewards`: expected shape [1, 3], got [2, 3]", returns(np.zeros((2, 3)), [1], 0.9)),
    (vhs.ShapeError, "`rewards`: expected shape [3, 1], got [3]", returns(np.zeros(3), [1, 1, 1], 0.9)),
    (
        vhs.LabelError,
        "`lengths`: expected a number in 0..4, got 4 at index 1",
        returns(np.zeros((2, 3)), [1, 4], 0.9),
    ),
    (
        vhs.NonFiniteError,
        "`rewards`: expected a finite number, got NaN at index 4",
        returns([[0, 0, 0], [0, NAN, 0]], [3, 2], 0.9),
    ),
    (
        vhs.ArgumentError,
        "`gamma`: expected a number in 0..=1, got -0.5",
        returns(np.zeros((1, 1)), [1], -0.5),
    ),
    (
        vhs.ShapeError,
        "`out`: expected shape [1, 3], got [3]",
        returns(np.zeros((1, 3)), [1], 0.9, out=np.zeros(3, np.float32)),
    ),
    (
        vhs.ShapeError,
        "`state`: expected shape [4], got [2]",
        lambda _: vhs.Rng.from_state(np.ones(2, np.uint64)),
    ),
    # The renderer
    (
        vhs.UnsupportedError,
        "not drawn by this renderer: geom type 9",
        lambda _: new_canvas(kind=9).take(1, 0),
    ),
    (vhs.ShapeError, "expected shape [2, bytes]", lambda _: new_canvas().take(2, 0)),
    (
        vhs.ShapeError,
        "`texture`: expected shape [height, width, channels], got [2, 3]",
        raster_texture(FRAME),
    ),
    (
        vhs.ArgumentError,
        "texture channels: expected 3 or 4, got 2",
        raster_texture(np.zeros((4, 4, 2), np.uint8)),
    ),
    (
        vhs.LayoutError,
        "`texture`: expected a C-contiguous array",
        raster_texture(np.zeros((4, 4, 4), np.uint8)[:, ::2]),
    ),
    (
        vhs.ShapeError,
        "`vertices`: expected shape [n, 3], got [1, 2]",
        raster_mesh(vertices=np.zeros((1, 2), np.float32)),
    ),
    (
        vhs.ArgumentError,
        "faces: expected indices of at least 0, got -1",
        raster_mesh(faces=np.full((1, 3), -1, np.int32)),
    ),
    (vhs.ArgumentError, "picture height: expected 1 to 8192, got 0", raster_canvas(height=0)),
    (
        vhs.ShapeError,
        "picture bytes: expected 75 values, got 12",
        lambda _: new_canvas().draw(np.zeros((2, 2, 3), np.uint8), False),
    ),
    (
        vhs.ProtocolError,
        "`update`: expected a bound simulation, found none",
        lambda _: new_canvas().update(0, None, [45.0], 0.01, 10.0),
    ),
    (
        vhs.NonFiniteError,
        "pose of geom 0: expected finite numbers, got NaN or infinity",
        lambda _: posed_canvas(NAN).update(0, None, [45.0], 0.01, 10.0),
    ),
]
