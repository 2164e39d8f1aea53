"""The pictures are those of MuJoCo's OpenGL renderer."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest
from raster_support import differences, ours, random_camera, reference, scatter, shapes_model

import vhs.envs
from vhs.envs.robot import CAMERA, COLLISION_GROUP, ROBOT_GROUP

COLOUR, SEGMENT, DISTANCE = 4.0, 0.01, 0.01
"""The differences allowed: mean of colours in 255ths, share of pixels, relative distance."""

GYMNASIUM_MODELS = sorted((Path(gymnasium.__file__).parent / "envs/mujoco/assets").glob("*.xml"))
MUJOCO_MODELS = [Path(mujoco.__file__).parent / "testdata/msh.xml"]


def assert_close(found: tuple[float, float, float]) -> None:
    colour, segment, distance = found
    assert colour <= COLOUR
    assert segment <= SEGMENT
    assert distance <= DISTANCE


@pytest.mark.slow
@pytest.mark.parametrize("antialias", ["off", "multisample"])
def test_every_shape_texture_light_and_camera(antialias: str) -> None:
    model = shapes_model(samples=4 if antialias == "multisample" else 0)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    expected = reference(model, 120, 160)
    actual = ours(model, 120, 160, antialias)
    for turn in range(10):
        scatter(model, data, rng, 0.1 * (turn > 0))
        for camera in (-1, "fixed", "parallel", "lens", random_camera(rng, model)):
            assert_close(differences(expected, actual, data, camera))


@pytest.mark.parametrize("antialias", ["off", "multisample"])
def test_planes_seen_from_below_are_nearly_clear(antialias: str) -> None:
    model = shapes_model(samples=4 if antialias == "multisample" else 0)
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    mujoco.mj_forward(model, data)
    camera.lookat[:], camera.distance = (0, 0, 0.4), 2
    expected = reference(model, 120, 160)
    actual = ours(model, 120, 160, antialias)
    for camera.elevation in (20, 40, 60):
        assert_close(differences(expected, actual, data, camera))


def test_the_room_in_two_hundred_random_states() -> None:
    vhs.envs.register_envs()
    env = gymnasium.make("vhs/MultiInteractionObjNav-v0", renderer="none").unwrapped
    env.reset(seed=0)
    model, rng = env.world.model, np.random.default_rng(0)
    option = mujoco.MjvOption()
    option.geomgroup[:] = [group not in (COLLISION_GROUP, ROBOT_GROUP) for group in range(6)]
    expected, actual = reference(model, 84, 84), ours(model, 84, 84)
    found = []
    for seed in range(200):
        env.reset(seed=seed)
        for _ in range(rng.integers(0, 6)):
            env.step(int(rng.integers(0, 3)))
        found.append(differences(expected, actual, env.world.data, CAMERA, option))
        assert_close(found[-1])
    print("room: worst of colour, segment, distance", np.max(found, axis=0))


@pytest.mark.parametrize("path", GYMNASIUM_MODELS + MUJOCO_MODELS, ids=lambda path: path.stem)
def test_models_that_people_use(path: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(path))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    expected = reference(model, 128, 128)
    actual = ours(model, 128, 128, "multisample")
    for turn in range(4):
        scatter(model, data, rng, 0.1 * (turn > 0))
        for camera in (*range(-1, model.ncam), random_camera(rng, model)):
            assert_close(differences(expected, actual, data, camera))
    expected.close()


def test_a_tracking_camera() -> None:
    model = shapes_model()
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    scatter(model, data, rng, 0.1)
    camera = random_camera(rng, model)
    camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, 3
    assert_close(differences(reference(model, 96, 96), ours(model, 96, 96), data, camera))


def test_hidden_groups_and_static_bodies() -> None:
    model = shapes_model()
    model.geom_group[1:4] = 2
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    option = mujoco.MjvOption()
    option.geomgroup[2] = option.sitegroup[0] = 0
    option.flags[mujoco.mjtVisFlag.mjVIS_STATIC] = 0
    expected, actual = reference(model, 96, 96), ours(model, 96, 96)
    assert_close(differences(expected, actual, data, "fixed", option))
    actual.enable_segmentation_rendering()
    shown = set(actual.render()[..., 0].ravel())
    assert 0 not in shown, "the floor is static"
    assert not shown & {1, 2, 3}, "their group is hidden"
    assert shown & {4, 5, 6}
