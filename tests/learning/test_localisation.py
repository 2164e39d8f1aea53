"""Hindsight localisation: what dead reckoning says of rooms, whom it teaches, and when it is left out."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from toy import TOY, TOY_SPEC, toy_config

from vhs import EpisodeBatch, EpisodeBuffer, Outcome
from vhs.acting.setup import check_spec
from vhs.config import load_config
from vhs.config.yaml12 import dump_yaml
from vhs.envs import RoomEnv
from vhs.envs.task import load_room
from vhs.errors import ConfigError
from vhs.learning.learner import Learner
from vhs.learning.reckoning import Reckoning
from vhs.learning.terms import Remembered
from vhs.train.build import make_learner

from .parts import FRAME, fill_store, goals_for

MOVES = {0: (1.0, 0.0, 0.0), 1: (0.0, 0.0, math.pi / 2), 2: (0.0, 0.0, -math.pi / 2)}
SPEC = replace(TOY_SPEC, moves=MOVES)
ON = "method.localisation_weight=1"
KEYS = ("localisation_weight", "memory_weight")


def episodes(*walks: tuple[list[int], Outcome, int], noise: int = 0) -> EpisodeBatch:
    """Walks as a batch; action 0 shows another picture unless it is written -1: a stride that is blocked."""
    rng = np.random.default_rng(0)
    buffer = EpisodeBuffer(
        FRAME,
        num_streams=1,
        max_episode_steps=6,
        capacity_steps=60,
        frame_stack=2,
        stacking="channels",
        num_goals=3,
    )
    ids = []
    for actions, outcome, goal in walks:
        frame = rng.integers(0, 256, FRAME, dtype=np.uint8)
        buffer.begin(0, frame, goal, 0)
        for action in actions:
            if action != -1:
                frame = rng.integers(0, 256, FRAME, dtype=np.uint8)
            elif noise:
                frame = frame ^ (rng.random(FRAME) < noise / 256).astype(np.uint8)
            buffer.append(0, max(action, 0), 0.0, 0.0, frame)
        ids.append(buffer.finish(0, outcome))
    return buffer.gather(np.array(ids, dtype=np.int64))


def localising(*overrides: str) -> Learner:
    return make_learner(toy_config("vhs", ON, *overrides), SPEC)


@pytest.mark.parametrize("noise", [0, 100])
def test_a_stride_after_which_the_picture_is_the_same_went_nowhere(noise: int) -> None:
    walks = ([1, 0, 3], Outcome.SUCCESS, 0), ([1, -1, 3], Outcome.FAILURE, 1)
    found = Reckoning(MOVES, SPEC, ahead_m=1.0)(episodes(*walks, noise=noise))
    assert found.rows.tolist() == [0, 1]
    np.testing.assert_allclose(found.bearings_rad, [[math.pi / 2, 0, 0]] * 2, atol=1e-6)
    # Out and, if nothing is in the way, back: what is reached lies behind the first stride, else before it.
    walks = ([2, 0, 1, 1, 0, 3], Outcome.SUCCESS, 0), ([2, 0, 1, 1, -1, 3], Outcome.SUCCESS, 0)
    first, second = Reckoning(MOVES, SPEC, ahead_m=0.5)(episodes(*walks, noise=noise)).bearings_rad[:, 1]
    assert (abs(first), second) == (pytest.approx(math.pi), pytest.approx(0, abs=1e-6))


def test_only_what_reached_something_is_looked_back_on() -> None:
    batch = episodes(([0], Outcome.TIMEOUT, 0), ([0, 1], Outcome.SUCCESS, 0), ([1], Outcome.FAILURE, 0))
    assert Reckoning(MOVES, SPEC, ahead_m=1.0)(batch).rows.tolist() == [1, 2]
    none = Reckoning(MOVES, SPEC, ahead_m=1.0)(episodes(([0], Outcome.TIMEOUT, 0)))
    assert (none.rows.shape, none.bearings_rad.shape) == ((0,), (0, 1))


def test_dead_reckoning_points_at_the_object_that_was_reached() -> None:
    """In rooms, on random walks that bump into things, against where the simulator has the object."""
    task = load_room("task2")
    spec, env = task.spec(), task.new_env()
    room: RoomEnv = env.unwrapped
    assert spec.moves is not None
    reckoning, rng = Reckoning(spec.moves, spec, ahead_m=0.5), np.random.default_rng(0)
    buffer = EpisodeBuffer(
        spec.frame_shape,
        num_streams=1,
        max_episode_steps=20,
        capacity_steps=40,
        frame_stack=2,
        stacking="channels",
    )
    off = []
    for seed in range(60):
        frame, truth, reached = env.reset(seed=seed)[0]["image"], [], -1
        buffer.begin(0, frame, 0, 0)
        while True:
            truth.append(room.world.measured_pose)
            action = int(rng.choice(4, p=(0.5, 0.15, 0.15, 0.2)))
            observation, _, terminated, truncated, info = env.step(action)
            buffer.append(0, action, 0.0, 0.0, observation["image"])
            if terminated or truncated:
                reached = info["reached_object"]
                break
        ended = buffer.finish(0, Outcome.FAILURE if terminated else Outcome.TIMEOUT)
        if not terminated:
            continue
        found = reckoning(buffer.gather(np.array([ended]))).bearings_rad[0]
        thing = room.world.object_poses[reached]
        for bearing, pose in zip(found, truth, strict=True):
            true = math.atan2(thing.y_m - pose.y_m, thing.x_m - pose.x_m) - pose.yaw_rad
            off.append(abs(math.remainder(bearing - true, math.tau)))
    assert len(off) > 50
    # 10 and 30 degrees where every stride is taken for a whole one.
    assert math.degrees(float(np.median(off))) < 8
    assert math.degrees(float(np.quantile(off, 0.9))) < 22


def test_a_success_is_what_it_was_told_and_a_failure_the_nearest_prototype() -> None:
    learner = localising("method.warmup=6")
    fill_store(learner.goals)
    batch = episodes(([0, 1], Outcome.SUCCESS, 2), ([0], Outcome.TIMEOUT, 1), ([1, 0], Outcome.FAILURE, 1))
    features = torch.randn(len(batch.observations), 16, generator=torch.Generator().manual_seed(0))
    sequences = features[: 3 * 2].view(3, 2, 16)
    reckon = Reckoning(MOVES, SPEC, ahead_m=0.5)
    reckoned = reckon(batch)
    reached = learner._reached(batch, reckoned, features, sequences)
    assert reached is not None
    assert reached.labels.tolist() == [2], "before there are prototypes nobody knows what a failure reached"
    end = features[batch.offsets[2] + batch.lengths[2]]
    table = torch.stack([-end, end * 3, end.flip(0)]).numpy()
    learner.goals.prototypes.update(table, np.arange(3))
    reached = learner._reached(batch, reckoned, features, sequences)
    assert reached is not None
    assert reached.labels.tolist() == [2, 1]
    assert torch.equal(reached.features, sequences[[0, 2]])
    assert reached.valid.tolist() == [[1, 1], [1, 1]]
    timeouts = episodes(([0], Outcome.TIMEOUT, 0))
    assert learner._reached(timeouts, reckon(timeouts), features, sequences[:1]) is None


def test_the_term_teaches_its_head_and_the_extractor_alone() -> None:
    learner = localising("train.value_weight=0", "train.entropy_weight=0", "method.relabel_probability=0")
    before = {name: weight.detach().clone() for name, weight in learner.agent.named_parameters()}
    batch = episodes(([0, 1, 0], Outcome.SUCCESS, 0))
    found = learner.update(batch, goals_for(batch, 16))
    assert found["localise"] == pytest.approx(math.log(2), rel=0.1), "a head that starts undecided"
    changed = {
        name for name, weight in learner.agent.named_parameters() if not torch.equal(weight, before[name])
    }
    assert {"sight.0.weight", "sight.2.weight", "extractor.project.weight"} <= changed
    nothing = episodes(([0, 1, 0], Outcome.TIMEOUT, 0))
    assert learner.update(nothing, goals_for(nothing, 16))["localise"] == 0.0


def test_memory_is_asked_of_every_episode_under_the_goal_that_it_reached() -> None:
    """A success as it was lived, a failure only in hindsight, a timeout not at all."""
    learner = localising("method.relabel_probability=1", "method.hindsight_goal=feature")
    batch = episodes(([0, 1], Outcome.SUCCESS, 2), ([0], Outcome.TIMEOUT, 1), ([1, 0, 0], Outcome.FAILURE, 1))
    asked: list[Remembered] = []
    learner._evaluate = lambda x: asked.append(x.remembered) or {}  # type: ignore[method-assign,func-returns-value]
    learner.update(batch, goals_for(batch, 16))
    (kept,) = asked
    bearings = Reckoning(MOVES, SPEC, ahead_m=0.5)(batch).bearings_rad
    assert torch.equal(kept.bearings_rad, torch.from_numpy(bearings))
    assert kept.valid.tolist() == [[1, 1, 0], [1, 1, 1]]
    assert kept.hidden.shape == (2, 3, learner.agent.hidden_dim)
    learner.update(episodes(([0], Outcome.TIMEOUT, 0)), goals_for(batch, 16)[:1])
    assert asked[1] is None


def test_memory_is_learned_to_the_end_and_teaches_eyes_and_memory() -> None:
    quiet = ("train.value_weight=0", "train.entropy_weight=0", "method.relabel_probability=0")
    rate = ("train.learning_rate=1e-2", "train.learning_rate_end=null", "method.memory_weight=1")
    learner = make_learner(toy_config("vhs", "method.localisation_weight=0", *quiet, *rate), SPEC)
    before = {name: weight.detach().clone() for name, weight in learner.agent.named_parameters()}
    batch = episodes(([1, 1, 0, 0], Outcome.SUCCESS, 0), ([0, 2, 0], Outcome.SUCCESS, 1))
    losses = [learner.update(batch, goals_for(batch, 16))["remember"] for _ in range(60)]
    assert losses[0] == pytest.approx(math.log(8), rel=0.1), "a head that starts undecided"
    assert losses[-1] < 0.1
    changed = {
        name for name, weight in learner.agent.named_parameters() if not torch.equal(weight, before[name])
    }
    assert {"bearing.0.weight", "lstm.weight_ih_l0", "extractor.project.weight"} <= changed


def test_the_head_is_learned_to_the_end() -> None:
    """What lies ahead is told from what does not, where the picture says it."""
    learner = localising("train.learning_rate=1e-2", "train.learning_rate_end=null")
    batch = episodes(([1, 1, 0, 0], Outcome.SUCCESS, 0), ([0, 2, 0], Outcome.SUCCESS, 1))
    goals = goals_for(batch, 16)
    losses = [learner.update(batch, goals)["localise"] for _ in range(40)]
    assert losses[-1] < 0.1 < 0.6 < losses[0]


def test_weights_are_the_same_with_and_without_the_head() -> None:
    nothing = ("method.localisation_weight=0", "method.memory_weight=0")
    plain = make_learner(toy_config("vhs", *nothing), SPEC).agent
    assert plain.sight is None
    assert plain.bearing is None
    own = localising().agent.state_dict()
    for name, weight in plain.state_dict().items():
        assert torch.equal(own.pop(name), weight), name
    assert {name.partition(".")[0] for name in own} == {"sight", "bearing"}


def test_a_task_without_moves_does_without() -> None:
    assert TOY_SPEC.moves is None
    for weight in ("0", "null"):
        config = toy_config("vhs", *(f"method.{key}={weight}" for key in KEYS))
        check_spec(config, TOY, TOY_SPEC)
        learner = make_learner(config, TOY_SPEC)
        assert learner.agent.sight is learner.agent.bearing is None
        batch = episodes(([0, 1, 0], Outcome.SUCCESS, 0))
        assert not {"localise", "remember"} & learner.update(batch, goals_for(batch, 16)).keys()
    for key in KEYS:
        message = (
            f"method.{key}: expected 0 or null, as task toy has not all of `moves` (what its "
            "actions do to the pose), goals that are classes, and pictures, found 1.0"
        )
        with pytest.raises(ConfigError) as caught:
            check_spec(toy_config("vhs", f"method.{key}=1"), TOY, TOY_SPEC)
        assert str(caught.value) == message


def test_a_task_with_moves_localises_unless_told_otherwise(tmp_path: Path) -> None:
    assert make_learner(toy_config("vhs"), SPEC).agent.sight is not None
    assert make_learner(toy_config("vhs", "method.localisation_weight=0"), SPEC).agent.sight is None
    assert make_learner(toy_config("pg"), SPEC).agent.sight is None
    tree = load_config().model_dump(mode="json")
    for key in (*KEYS, "imitate_still"):
        del tree["method"][key]
    path = tmp_path / "config.yaml"
    path.write_text(dump_yaml(tree))
    method = load_config([path]).method
    assert (method.localisation_weight, method.memory_weight) == (0, 0), "saved before there were such terms"
    assert method.imitate_still


def test_the_paper_has_none_of_it() -> None:
    paper = load_config([Path(__file__).parents[2] / "configs" / "paper.yaml"])
    method = paper.method
    assert (method.localisation_weight, method.memory_weight, method.imitate_still) == (0, 0, True)


@pytest.mark.parametrize(
    ("assignments", "message"),
    [
        (
            ["method.localisation_in_view_deg=50"],
            "method.localisation_in_view_deg: expected at most method.localisation_out_of_view_deg = 48.0, "
            "found 50.0",
        ),
        (
            ["method.name=pg", ON],
            "method.localisation_weight: expected none for method.name = pg, which has no localise, "
            "found 1.0",
        ),
    ],
)
def test_settings_that_do_not_fit_are_refused(assignments: list[str], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config([], assignments)
    assert str(caught.value) == message
