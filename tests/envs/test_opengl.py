from __future__ import annotations

import os
import subprocess
import sys

import pytest

from vhs.envs import opengl


@pytest.fixture(autouse=True)
def headless_linux(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "MUJOCO_GL", "LP_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(("has_egl", "platform"), [(True, "egl"), (False, "disable")])
def test_egl_is_chosen_only_where_it_exists(
    monkeypatch: pytest.MonkeyPatch, has_egl: bool, platform: str
) -> None:
    monkeypatch.setattr(opengl, "has_library", lambda name: has_egl)
    opengl.choose_defaults()
    assert os.environ["MUJOCO_GL"] == platform
    assert os.environ["LP_NUM_THREADS"] == "0"


def test_what_the_user_has_set_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setenv("LP_NUM_THREADS", "3")
    opengl.choose_defaults()
    assert (os.environ["MUJOCO_GL"], os.environ["LP_NUM_THREADS"]) == ("osmesa", "3")


def test_a_display_is_used_where_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    opengl.choose_defaults()
    assert "MUJOCO_GL" not in os.environ


def test_other_systems_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    opengl.choose_defaults()
    assert "MUJOCO_GL" not in os.environ


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks for Linux's C library")
def test_libraries_are_looked_up_by_the_loader() -> None:
    assert opengl.has_library("libc.so.6")
    assert not opengl.has_library("libnothing-of-the-kind.so.1")


def test_without_opengl_the_dynamics_work_and_drawing_is_refused() -> None:
    code = """
import gymnasium, vhs.envs
env = gymnasium.make("vhs/ObjectNav-v0", renderer="none")
env.reset(seed=0)
env.step(0)
try:
    gymnasium.make("vhs/ObjectNav-v0", renderer="mujoco").reset(seed=0)
except vhs.envs.NoOpenGLError as error:
    print("refused:", error)
"""
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env={**os.environ, "MUJOCO_GL": "disable"},
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("refused: expected a working OpenGL to draw the room, found none")
    assert "libegl1 libgl1-mesa-dri" in result.stdout
