"""The window, under a virtual display: the agent plays in it, a person drives in it. Skips without Xvfb."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import pytest
from debug import debug_config

from vhs import Outcome, Task
from vhs.acting.setup import task_of
from vhs.cli import main
from vhs.envs import RoomEnv

pytest.importorskip("tkinter")


@pytest.fixture(scope="module")
def display() -> Iterator[None]:
    pytest.importorskip("tkinter")
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed")
    ours, theirs = os.pipe()
    # The server chooses a free display and writes its number once it is ready.
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(theirs), "-screen", "0", "1280x800x24"],
        pass_fds=[theirs],
        stderr=subprocess.DEVNULL,
    )
    os.close(theirs)
    with pytest.MonkeyPatch.context() as patch, os.fdopen(ours) as number:
        patch.setenv("DISPLAY", f":{number.readline().strip()}")
        yield
    server.terminate()
    server.wait()


def watched(task: Task) -> tuple[Task, list[RoomEnv]]:
    """The task, and the rooms that it makes from now on."""
    made: list[RoomEnv] = []

    def make(**kwargs: Any) -> gymnasium.Env[Any, Any]:
        env = gymnasium.make(task.make, **kwargs)
        made.append(env.unwrapped)
        return env

    return replace(task, make=make), made


@pytest.mark.usefixtures("display")
def test_a_person_drives_and_sees_the_outcome() -> None:
    from vhs.play.driver import Person
    from vhs.play.window import Window

    config = debug_config("task=task2")
    task, made = watched(task_of(config))
    window = Window("test")
    person = Person(window, config, task, [1, 2])
    room = made[-1]
    start = room.world.commanded_pose
    window.press("Left")
    assert room.world.commanded_pose.heading == (start.heading + 1) % 8
    window.press("Right")
    window.press("Up")
    assert room.world.commanded_pose[:2] != start[:2]
    for _ in range(17):
        window.press("Left")
    assert person.outcomes == [Outcome.TIMEOUT]
    window.press("Left")  # nothing: the episode has ended
    assert room.steps == 20
    window.press("Return")
    assert room.steps == 0
    window.press("space")
    assert room.steps == 1
    window.close()


@pytest.mark.usefixtures("display")
def test_the_agent_plays_in_a_window_that_closes_by_itself(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("vhs.play.command.FPS", 1000)
    monkeypatch.setattr("vhs.play.driver.LAST_FRAME_S", 0.001)
    assert main(["play", str(run), "--episodes", "2"]) == 0
    assert "window closed" in capsys.readouterr().out


@pytest.mark.usefixtures("display")
def test_an_error_in_the_window_ends_it_and_is_raised() -> None:
    from vhs.play.window import Window

    window = Window("test")

    def fail() -> None:
        raise ValueError("from within")

    window.after(0, fail)
    with pytest.raises(ValueError, match="from within"):
        window.run()
