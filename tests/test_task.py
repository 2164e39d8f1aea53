"""What is read off an environment, and what a task refuses: nothing is assumed of anyone's environment."""

import math
import subprocess
import sys
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from toy import Toy, toy_task

from vhs import ArgumentError, Move, Outcome, Rng, Task, TaskSpec, Turn, relabel
from vhs.buffer import make_buffer
from vhs.envs.task import ROOMS, load_room
from vhs.recorder import HindsightRecorder
from vhs.recorder import make_buffer as recorder_buffer


@pytest.mark.parametrize("moves", [2, 3, 5])
def test_the_interaction_that_was_done_is_the_one_that_is_relabelled(moves: int) -> None:
    """In the trainer's buffer and in the recorder's, however many moves come before."""
    spec = toy_task(moves=moves).spec()
    of_task = make_buffer(spec, capacity_steps=60)
    of_recorder = recorder_buffer(
        Toy(moves=moves), capacity_steps=60, max_episode_steps=6, interactions={moves: 0, moves + 1: 1}
    )
    for buffer in (of_task, of_recorder):
        frame = np.zeros((16, 16, 3), np.uint8)
        for action in (moves, moves + 1):
            buffer.begin(0, frame, 0, 0)
            buffer.append(0, action, 0.0, 0.0, frame)
            buffer.finish(0, Outcome.FAILURE)
        hindsight = relabel(buffer.gather(np.array([0, 1])), on=["failure"], probability=1.0, rng=Rng(0))
        assert hindsight.interactions.tolist() == [0, 1]


def test_a_spec_is_read_without_drawing_or_resetting() -> None:
    class Untouched(Toy):
        def reset(self, **_: object) -> tuple[dict[str, object], dict[str, object]]:
            raise AssertionError("reset")

    spec = Task(name="untouched", make=Untouched, max_steps=6, interactions={3: 0, 4: 1}).spec()
    assert spec == TaskSpec(
        frame_shape=(16, 16, 3),
        num_actions=5,
        max_episode_steps=6,
        frame_dtype=np.dtype(np.uint8),
        num_goals=3,
        interactions={3: 0, 4: 1},
        num_interactions=2,
    )
    assert (spec.num_interactions, dict(spec.interactions)) == (2, {3: 0, 4: 1})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"interactions": {}}, "which action does which of the 2 interactions that toy instructs, got {}"),
        ({"max_steps": None}, "`max_steps`: expected a number, as toy registers none, got None"),
        ({"actions": ("left", "right")}, "`actions`: expected 5 names, one an action of toy, got 2"),
        ({"goals": ("red",)}, "`goals`: expected 3 names, one a goal class of toy, got 1"),
        ({"interactions": {0: 0, 5: 1}}, "`interactions`: expected actions below 5, got 5"),
        ({"moves": {5: Turn(deg=1.0)}}, "`moves`: expected one of 5 numbered actions, got 5"),
        (
            {"moves": {0: Move(forward_m=float("nan"))}},
            "`moves`: expected a Move or a Turn by a finite number",
        ),
        (
            {"max_steps": None, "max_steps_keyword": "limit"},
            "`max_steps`: expected a number to call `make` with as limit, got None",
        ),
        (
            {"max_steps_keyword": "limit", "kwargs": {"limit": 7}},
            "`kwargs`: expected no limit, as `max_steps` says 6, got 7",
        ),
        ({"moves": {0: (1.0, 0.0)}}, "`moves`: expected a Move or a Turn by a finite number for action 0"),
    ],
)
def test_what_does_not_fit_the_environment_is_refused(changes: dict[str, object], message: str) -> None:
    fields = {"name": "toy", "make": Toy, "max_steps": 6, "interactions": {3: 0, 4: 1}} | changes
    with pytest.raises(ArgumentError, match=message):
        Task(**fields).spec()  # type: ignore[arg-type]


def test_a_space_that_says_nothing_of_goals_needs_a_reader() -> None:
    task = Task(name="cart", make=lambda: gymnasium.make("CartPole-v1"))
    with pytest.raises(ArgumentError, match="`read`: expected one for an observation space without"):
        task.spec()


@pytest.mark.parametrize("name", ROOMS)
def test_the_rooms_are_tasks(name: str) -> None:
    task, kind = load_room(name, renderer="none"), ROOMS[name]
    spec = task.spec()
    assert (task.name, task.title) == (name, f"Task {name[-1]}")
    assert spec.num_interactions == kind.interactions
    assert spec.num_actions == len(task.actions) == 3 + kind.interactions
    assert spec.num_goals == 5
    assert spec.max_episode_steps == 20
    assert set(task.keys.values()) == set(range(spec.num_actions))
    assert spec.moves == {0: (0.5, 0.0, 0.0), 1: (0.0, 0.0, math.pi / 4), 2: (0.0, 0.0, -math.pi / 4)}
    assert replace(task, max_steps=40).new_env().unwrapped.config.horizon_steps == 40  # type: ignore[attr-defined]
    env = task.new_env()
    env.reset(seed=1)
    assert task.shortest is not None
    assert 1 <= task.shortest(env) <= 20


def test_a_recorder_and_a_task_see_the_same_sizes() -> None:
    env = Toy(frame=(12, 20, 3))
    buffer = recorder_buffer(env, capacity_steps=60, max_episode_steps=6, interactions={3: 0, 4: 1})
    recorder = HindsightRecorder(env, buffer)
    recorder.reset(seed=0)
    assert buffer.frame_shape == toy_task(frame=(12, 20, 3)).spec().frame_shape


def test_importing_tasks_needs_numpy_alone() -> None:
    code = (
        "import sys, vhs.task, vhs.buffer; print(sorted({'gymnasium', 'torch', 'mujoco'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
