"""What a task is found to be by trying it; what does not fit is said by the field that it stands in."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from multiprocessing import active_children
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from toy import Toy, toy_config, toy_task

from vhs import ArgumentError, Outcome, OutcomeReward, Seen, Task
from vhs.acting.environment import TaskEnv
from vhs.acting.setup import learn_spec
from vhs.acting.trial import try_task, try_task_apart
from vhs.envs.opengl import has_library
from vhs.errors import ConfigError
from vhs.task import default_outcome


def read(observation: dict[str, Any]) -> Seen:
    return Seen(observation["image"], int(observation["goal"]), int(observation["interaction"]))


def read_late(observation: dict[str, Any], change: Any, _met: list[int]) -> Seen:
    """As `read` for the first three observations; then something about it is another."""
    _met.append(1)
    seen = read(observation)
    return seen if len(_met) <= 3 else replace(seen, **change(seen))


def late(change: Any) -> Any:
    return partial(read_late, change=change, _met=[])


class Endless(Toy):
    def step(self, action: Any) -> Any:
        observation, reward, *_ = super().step(action)
        return observation, reward, False, False, {}


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"make": "NoSuchEnvironment-v0"}, "`make`: expected an answer, got NameNotFound"),
        ({"make": lambda: 1 / 0}, r"`make`: .*ZeroDivisionError: .* \(test_trial.py, line \d+\)"),
        ({"read": lambda seen: seen["picture"]}, "`read`: .*KeyError: 'picture'"),
        ({"read": late(lambda seen: {"frame": seen.frame[1:]})}, r"`read`: .*uint8 \[16, 16, 3\] .*\[15, 16"),
        ({"read": late(lambda seen: {"frame": seen.frame / 255})}, r"`read`: expected frames uint8.*float64"),
        ({"read": late(lambda _: {"label": 3})}, r"`goals`: expected a number in 0\.\.2, got 3"),
        ({"read": late(lambda _: {"interaction": 2})}, r"`interactions`: expected a number in 0\.\.1, got 2"),
        ({"judge": lambda *_: "success"}, "`judge`: expected an Outcome, got 'success'"),
        ({"judge": lambda *last: last[3]["won"]}, "`judge`: .*KeyError: 'won'"),
        ({"touched": lambda info: info["near"]}, "`touched`: .*KeyError: 'near'"),
        ({"reached": lambda info: info["reached"]}, "`reached`: .*KeyError: 'reached'"),
        ({"reached": lambda info: 7}, r"`reached`: expected a number in -1\.\.2, got 7"),
        ({"metrics": ("distance",)}, "`metrics`: expected distance in the last info, got outcome"),
        ({"keys": {"x": 9}}, "`keys`: expected actions below 5, got 9"),
        ({"moves": {5: None}}, "`moves`: expected one of 5 numbered actions, got 5"),
    ],
)
def test_a_field_that_does_not_fit_is_named_before_anything_is_trained(
    fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(ArgumentError, match=message):
        try_task(replace(toy_task(), **({"read": read} | fields)))


def test_an_episode_ends_with_the_longest_of_its_task() -> None:
    task = replace(toy_task(), make=Endless)
    env = TaskEnv(task.new_env(), task, try_task(task))
    env.reset(seed=0)
    ends = [any(env.step(0)[2:4]) for _ in range(6)]
    assert ends == [False] * 5 + [True]
    env.reset(seed=0)
    assert not any(env.step(0)[2:4]), "steps count from the reset"


def test_a_reward_of_the_tasks_own_follows_the_outcome() -> None:
    task = replace(toy_task(), reward=OutcomeReward(success=2.0, failure=-3.0, timeout=-0.5, step=-0.25))
    spec = task.spec()
    assert spec.success_reward == 1.75
    env = TaskEnv(task.new_env(), task, spec)
    rewards = {}
    for seed in range(12):
        env.reset(seed=seed)
        toy, is_over = env.unwrapped, False
        while not is_over:
            to_the_centre = 1 if toy.offset < 0 else 2 if toy.offset > 0 else 3 + seed % 2
            _, reward, terminated, truncated, info = env.step(to_the_centre if seed else 0)
            is_over = terminated or truncated
            assert is_over or reward == -0.25
        rewards[info["outcome"]] = reward
    assert rewards == {Outcome.SUCCESS: 1.75, Outcome.FAILURE: -3.25, Outcome.TIMEOUT: -0.75}


def test_a_judge_without_an_answer_leaves_it_to_the_default() -> None:
    task = replace(toy_task(), judge=lambda *_: None)
    assert try_task(task) == toy_task().spec()


def test_an_environment_is_made_in_no_process_that_learns() -> None:
    learner = os.getpid()

    def make() -> gymnasium.Env[Any, Any]:
        assert os.getpid() != learner, "made in the learner's process"
        return Toy()

    task = replace(toy_task(), make=make)
    assert learn_spec(toy_config("vhs", "env.num_workers=1"), task) == toy_task().spec()
    with pytest.raises(ArgumentError, match="made in the learner's process"):
        learn_spec(toy_config("vhs", "env.num_workers=0"), task)


def test_a_process_that_dies_is_told() -> None:
    class Fatal(Toy):
        def reset(self, **_: Any) -> Any:
            os._exit(11)

    with pytest.raises(ConfigError, match="task toy: expected an episode, found its process dead"):
        try_task_apart(replace(toy_task(), make=Fatal))


def test_an_error_of_another_process_is_the_same_error() -> None:
    with pytest.raises(ArgumentError, match="`judge`: expected an Outcome, got 3"):
        try_task_apart(replace(toy_task(), judge=lambda *_: 3))


def test_pictures_are_asked_of_whoever_draws_some() -> None:
    rooms = Task(name="cart", make="CartPole-v1")
    assert rooms.new_env(rendering=True).render_mode == "rgb_array"
    assert rooms.new_env().render_mode is None
    assert replace(rooms, make=lambda: Toy()).new_env(rendering=True).render_mode is None
    assert replace(toy_task(), kwargs={"frame": (8, 8, 3)}).new_env().frame == (8, 8, 3)
    assert np.array_equal(read(Toy().reset(seed=0)[0]).frame, Toy().reset(seed=0)[0]["image"])


def test_the_step_is_counted_at_which_something_was_last_reached() -> None:
    class Passing(Toy):
        def step(self, action: Any) -> Any:
            observation, reward, terminated, truncated, _ = super().step(0)
            return observation, reward, terminated, truncated, {"near": action == 2}

    task = replace(toy_task(), make=Passing, touched=lambda info: info["near"], judge=default_outcome)
    env = TaskEnv(task.new_env(), task, try_task(task))
    for actions, expected in [((0, 2, 0, 2, 0, 0), 4), ((0,) * 6, 0), ((2,) * 6, 6)]:
        env.reset(seed=0)
        infos = [env.step(action)[4] for action in actions]
        assert infos[-1]["touched"] == expected
        assert not any(infos[:-1])


@pytest.mark.slow
@pytest.mark.parametrize("when", ["made", "stepped"])
def test_an_environment_that_hangs_is_told(when: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Hung(Toy):
        def __init__(self, *arguments: Any, **sizes: Any) -> None:
            super().__init__(*arguments, **sizes)
            if when == "made":
                time.sleep(1000)

        def step(self, action: Any) -> Any:
            time.sleep(1000)

    monkeypatch.setattr("vhs.acting.trial.START_LIMIT_S", 3.0)
    with pytest.raises(ConfigError, match=r"task toy: .* hanging after [01] steps"):
        try_task_apart(replace(toy_task(), make=Hung), deadline_s=0.5)


# A task that hangs in its first step; says the process in which it does.
HANGING = """
import os, signal, sys, time
sys.path[:0] = sys.argv[1:2]
from dataclasses import replace
from toy import Toy, toy_task
from vhs.acting.trial import try_task_apart

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background has it ignored

class Hanging(Toy):
    def step(self, action):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # as where it hangs in native code
        print(os.getpid(), flush=True)
        time.sleep(1000)

try_task_apart(replace(toy_task(), make=Hanging))
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel says who ended on Linux alone")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_trial_ends_with_whoever_asked_for_it(number: int) -> None:
    support = str(Path(__file__).parents[1] / "support")
    with subprocess.Popen(
        [sys.executable, "-c", HANGING, support], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        trial = int(process.stdout.readline())
        process.send_signal(number)
        try:
            process.wait(30)
        finally:
            process.kill()
    deadline = time.monotonic() + 30
    while Path(f"/proc/{trial}").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not Path(f"/proc/{trial}").exists()


def test_a_trial_ends_that_is_stopped_before_its_pool_knows_its_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As by Ctrl-C just after the fork; the end of this process would wait for it for ever."""

    class Hanging(Toy):
        def step(self, action: Any) -> Any:
            time.sleep(1000)

    start = ForkProcess.start

    def stopped(process: ForkProcess) -> None:
        start(process)
        raise KeyboardInterrupt

    before = set(active_children())
    monkeypatch.setattr(ForkProcess, "start", stopped)
    with pytest.raises(KeyboardInterrupt):
        try_task_apart(replace(toy_task(), make=Hanging))
    deadline = time.monotonic() + 30
    while set(active_children()) - before and time.monotonic() < deadline:
        time.sleep(0.02)
    left = set(active_children()) - before
    for process in left:
        process.kill()
    assert not left


DRAWN = """
import gymnasium, mujoco, torch
from gymnasium.spaces import Box, Dict, Discrete
from vhs import Task
from vhs.acting.setup import learn_spec
from vhs.config import resolve_config

class Drawn(gymnasium.Env):
    observation_space = Dict(image=Box(0, 255, (16, 16, 3), "uint8"), goal=Discrete(2))
    action_space = Discrete(2)

    def __init__(self):
        model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
        self.data, self.renderer = mujoco.MjData(model), mujoco.Renderer(model, 16, 16)

    def reset(self, *, seed=None, options=None):
        self.renderer.update_scene(self.data)
        return {"image": self.renderer.render(), "goal": 0}, {}

    def step(self, action):
        return self.reset()[0], 0.0, False, False, {}

learn_spec(resolve_config([{"env": {"num_workers": 0}}]), Task(make=Drawn, max_steps=2))
torch.optim.Adam([torch.zeros(1, requires_grad=True)])
"""


@pytest.mark.slow
@pytest.mark.skipif(not has_library("libEGL.so.1"), reason="needs libegl1")
def test_an_environment_that_draws_with_opengl_leaves_the_learner_its_optimiser() -> None:
    """Of torch, which loads triton with the first one: after Mesa that crashed the process."""
    environ = os.environ | {"MUJOCO_GL": "egl"}
    done = subprocess.run(
        [sys.executable, "-c", DRAWN], capture_output=True, text=True, check=False, timeout=60, env=environ
    )
    assert done.returncode == 0, done.stderr
