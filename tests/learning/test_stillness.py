"""Steps that changed nothing: what counts as the same, and that they are not imitated."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from toy import TOY_SPEC, toy_config

from vhs import EpisodeBatch, EpisodeBuffer, Field
from vhs.learning.learner import Learner
from vhs.learning.stillness import Stillness
from vhs.train.build import make_learner

from .parts import FRAME, goals_for

MOVES = {0: (1.0, 0.0, 0.0)}
MOVING = replace(TOY_SPEC, moves=MOVES)


def batch_of(frames: list[NDArray[Any]], *, channels: bool = True, **given: Any) -> EpisodeBatch:
    """One failure that shows these frames."""
    told = given.pop("told", None)
    buffer = EpisodeBuffer(
        frames[0].shape,
        num_streams=1,
        max_episode_steps=9,
        capacity_steps=9,
        stacking="channels" if channels else "frames",
        dtype=frames[0].dtype,
        num_goals=3,
        interactions={4: 0, 3: 1},
        **given,
    )

    def beside(step: int) -> dict[str, Any]:
        return {} if told is None else {"fields": {"told": told[step]}}

    buffer.begin(0, frames[0], 1, 0, **beside(0))
    for step, frame in enumerate(frames[1:], 1):
        buffer.append(0, 3 if step == len(frames) - 1 else step % 3, 0.0, 0.5, frame, **beside(step))
    return buffer.gather([buffer.finish(0, "failure")])


def pictures(*numbers: int) -> list[NDArray[np.uint8]]:
    """A picture a number; the same number is the same picture."""
    return [np.random.default_rng(number).integers(0, 256, FRAME, np.uint8) for number in numbers]


def found(spec: Any, batch: EpisodeBatch) -> list[bool]:
    result: list[bool] = Stillness(spec)(batch, batch.mask)[0].tolist()
    return result


def test_a_small_thing_that_moves_before_a_plain_wall_is_seen() -> None:
    """Wherever it stands between the rows and columns that are compared first."""
    frames = [np.full((84, 84, 3), 40, np.uint8) for _ in range(4)]
    for frame, column in zip(frames, (9, 13, 17, 17), strict=True):
        frame[9:12, column : column + 3] = 255
    spec = replace(MOVING, frame_shape=(84, 84, 3))
    assert found(spec, batch_of(frames)) == [False, False, True]


def test_pictures_of_small_numbers_are_compared_by_their_own_scale() -> None:
    frames = [np.random.default_rng(0).integers(0, 11, (7, 7, 3)).astype(np.uint8) for _ in range(3)]
    frames[1] = np.roll(frames[0], 1, axis=1)
    frames[2] = frames[1]
    few = np.zeros((7, 7, 3), np.uint8), np.zeros((7, 7, 3), np.uint8)
    few[1][3, 3] = 2
    spec = replace(MOVING, frame_shape=(7, 7, 3))
    assert found(spec, batch_of([*frames, *few])) == [False, True, False, False]


def test_a_camera_that_settles_is_still() -> None:
    """A tenth of all numbers one level off, and an edge of four pixels a hundred."""
    rng = np.random.default_rng(0)
    one = rng.integers(0, 200, (84, 84, 3)).astype(np.uint8)
    other = one + (rng.random(one.shape) < 0.1)
    other[40, 40:44] = one[40, 40:44] + 100
    spec = replace(MOVING, frame_shape=(84, 84, 3))
    assert found(spec, batch_of([one, other.astype(np.uint8), one])) == [True, True]


@pytest.mark.parametrize("spec", [TOY_SPEC, MOVING])
def test_a_step_is_still_where_the_newest_frame_is_the_one_before(spec: Any) -> None:
    """A picture that was seen two steps ago is another one."""
    batch = batch_of(pictures(0, 0, 1, 0, 2, 2, 2))
    assert found(spec, batch) == [True, False, False, False, True, True]
    chosen = batch.mask.copy()
    chosen[0, [0, 4]] = False
    assert Stillness(spec)(batch, chosen)[0].tolist() == [False] * 5 + [True]
    assert not Stillness(spec)(batch, np.zeros_like(chosen)).any()


def test_a_camera_that_stands_may_tremble_and_one_pixel_counts_where_nothing_moves_it() -> None:
    (frame,) = pictures(0)
    noise = (np.random.default_rng(1).random(FRAME) < 0.4).astype(np.uint8)
    pixel = np.zeros(FRAME, np.uint8)
    pixel[1, 1, 0] = 1
    for change, is_still in ((noise, (True, False)), (3 * noise, (False, False)), (pixel, (True, False))):
        batch = batch_of([frame, frame ^ change])
        assert (found(MOVING, batch), found(TOY_SPEC, batch)) == ([is_still[0]], [is_still[1]])


def test_what_lies_beside_a_frame_is_seen_too() -> None:
    compass = [np.float32([0]), np.float32([0]), np.float32([1]), np.float32([1])]
    batch = batch_of(pictures(0, 0, 0, 0), told=compass, fields={"told": Field((1,), "float32")})
    assert found(MOVING, batch) == [True, False, True]


def test_frames_that_are_vectors_are_compared() -> None:
    frames = [np.float32([1, 2, 3]), np.float32([1, 2, 3]), np.float32([1, 2, 4])]
    spec = replace(TOY_SPEC, frame_shape=(3,), frame_dtype=np.float32)
    assert found(spec, batch_of(frames, channels=False)) == [True, False]


def imitating(still: bool, *settings: str) -> Learner:
    """A learner that relabels every failure."""
    always = ("method.relabel_probability=1", "method.hindsight_goal=feature", "method.memory_weight=0")
    settings = (f"method.imitate_still={str(still).lower()}", *always, *settings)
    return make_learner(toy_config("vhs", *settings), MOVING)


def test_what_changed_nothing_is_not_imitated_and_the_end_always_is() -> None:
    """Against a loop over the steps; the discount counts the steps that are imitated."""
    batch = batch_of(pictures(0, 0, 1, 1, 2, 2))
    moving = [1, 3, 4]  # the last shows nothing new, and reached what it reached
    for still, steps in ((True, range(5)), (False, moving)):
        learner = imitating(still, "method.hindsight_discount=0.5")
        agent = copy.deepcopy(learner.agent).train()
        features = agent.extractor(torch.from_numpy(batch.observations))
        seen = agent(features[None, :5], features[-1].detach()[None], torch.tensor([1]))
        taken = agent.head.log_prob(seen.policy, torch.from_numpy(batch.actions))[0]
        weights = [0.5 ** (len(steps) - 1 - place) for place in range(len(steps))]
        expected = (
            -sum(weight * float(taken[step].detach()) for weight, step in zip(weights, steps, strict=True))
            / 5
        )
        assert learner.update(batch, goals_for(batch, 16))["imitation_policy"] == pytest.approx(
            expected, rel=1e-4
        )


def test_a_task_whose_moves_are_known_leaves_them_out_unless_told_otherwise() -> None:
    def stillness(spec: Any, *settings: str, name: str = "vhs") -> Any:
        return make_learner(toy_config(name, *settings), spec)._stillness

    assert stillness(MOVING) is not None
    assert stillness(MOVING, "method.imitate_still=true") is None
    assert stillness(MOVING, name="gcsl") is None, "Ghosh et al. imitate all"
    assert stillness(TOY_SPEC) is None
    assert stillness(TOY_SPEC, "method.imitate_still=false") is not None
