"""Every way to go wrong that we could think of, one row each; `test_errors` runs them."""

from __future__ import annotations

import copy
import pickle

import numpy as np

import vhs

from .bad_world import (
    FRAME,
    HUGE,
    IMAGES,
    INF,
    NAN,
    Call,
    append,
    append_batch,
    begin,
    new_buffer,
    new_canvas,
    new_prototypes,
    new_store,
    posed_canvas,
    push,
    raster_canvas,
    raster_mesh,
    raster_texture,
    read_only,
    relabel,
    restore,
    returns,
    sample,
    sizes,
    update,
)
from .naive import FRAME_SHAPE
from .test_episodes import make_buffer

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
        "`interactions`: expected which action does which of num_interactions = 3, got none",
        lambda _: new_buffer(num_actions=6, num_interactions=3),
    ),
    (
        vhs.ArgumentError,
        "`interactions`: expected actions in 0..4 that do interactions in 0..2, got action 4, interaction 1",
        lambda _: new_buffer(num_actions=4, interactions={3: 0, 4: 1}),
    ),
    (
        vhs.ArgumentError,
        "`interactions`: expected actions in 0..1048576 that do interactions in 0..1",
        lambda _: new_buffer(num_interactions=1, interactions={3: 1}),
    ),
    (
        vhs.ArgumentError,
        "`interactions`: expected actions in 0..1048576 that do interactions in 0..0",
        lambda _: new_buffer(interactions={3: -1}),
    ),
    (
        vhs.ArgumentError,
        "`interactions`: expected none where actions are continuous, got some",
        lambda _: new_buffer(action_dim=2, interactions={3: 0}),
    ),
    (
        vhs.DtypeError,
        "`interactions`: expected a mapping of actions to interactions, such as {3: 0}, got list",
        lambda _: new_buffer(interactions=[3]),
    ),
    (
        vhs.DtypeError,
        "`interactions`: expected an integer, got str",
        lambda _: new_buffer(interactions={"3": 0}),
    ),
    (
        vhs.ArgumentError,
        '`stacking`: expected "frames", "channels", got "rows"',
        lambda _: new_buffer(stacking="rows"),
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
        "`num_actions`: expected a number in 1..=",
        sizes(num_actions=0),
    ),
    (
        vhs.ArgumentError,
        "`first_action`: expected a number in -1048576..=1048576, got 1048577",
        sizes(first_action=2**20 + 1),
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
