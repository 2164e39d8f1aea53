"""What `bad_calls` are made on, and short ways to write them."""

from __future__ import annotations

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
