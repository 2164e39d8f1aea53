"""What is read off an environment, and what a task refuses: nothing is assumed of anyone's environment."""

import subprocess
import sys

import gymnasium
import pytest
from toy import Toy, toy_task

from vhs import ArgumentError, Task
from vhs.envs.task import ROOMS, load_task
from vhs.recorder import HindsightRecorder
from vhs.recorder import make_buffer as recorder_buffer


def test_a_space_that_says_nothing_of_goals_needs_a_reader() -> None:
    task = Task(name="cart", make=lambda: gymnasium.make("CartPole-v1"))
    with pytest.raises(ArgumentError, match="`reader`: expected one for an observation space without"):
        task.spec()


@pytest.mark.parametrize("name", ROOMS)
def test_the_rooms_are_tasks(name: str) -> None:
    task, kind = load_task(name, renderer="none"), ROOMS[name]
    spec = task.spec()
    assert (task.name, task.title) == (name, f"Task {name[-1]}")
    assert spec.num_interactions == kind.interactions
    assert spec.num_actions == len(task.actions) == 3 + kind.interactions
    assert spec.num_goals == 5
    assert spec.max_episode_steps == 20
    assert set(task.keys.values()) == set(range(spec.num_actions))
    env = task.make()
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
