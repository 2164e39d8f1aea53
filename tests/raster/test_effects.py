"""Shadows, reflections and fog are those of MuJoCo's OpenGL renderer, and obey the flags of the scene."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest
from raster_models import MODELS
from raster_support import SHAPES_XML, ours, random_camera, reference, scatter, shapes_model

COLOUR = 4.0
"""Mean difference allowed, in 255ths."""
SHADOW, REFLECTION = mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION
FOG = mujoco.mjtRndFlag.mjRND_FOG

GYMNASIUM = Path(gymnasium.__file__).parent / "envs/mujoco/assets"


def compare(
    model: mujoco.MjModel, data: mujoco.MjData, camera: object, flags: list[int], antialias: str = "off"
) -> tuple[float, float]:
    """Mean difference of the pictures, and how much the flags change ours."""
    expected, actual = reference(model, 120, 160), ours(model, 120, 160, antialias)
    actual.update_scene(data, camera)
    before = actual.render().astype(int)
    for renderer in (expected, actual):
        for flag in flags:
            renderer.scene.flags[flag] = 1
        # MuJoCo moves endless planes to where the camera was at the last update, hence two of them.
        for _ in range(2):
            renderer.update_scene(data, camera)
    pictures = [renderer.render().astype(int) for renderer in (expected, actual)]
    expected.close()
    return float(np.abs(pictures[0] - pictures[1]).mean()), float(np.abs(pictures[1] - before).mean())


@pytest.mark.slow
@pytest.mark.parametrize("antialias", ["off", "multisample"])
def test_shadows_of_spots_and_directional_lights(antialias: str) -> None:
    model = shapes_model(samples=4 if antialias == "multisample" else 0)
    model.light_castshadow[:] = 1
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for turn in range(3):
        scatter(model, data, rng, 0.1 * turn)
        for camera in ("fixed", "parallel", random_camera(rng, model)):
            difference, change = compare(model, data, camera, [SHADOW], antialias)
            assert difference <= 1
            assert change > 2


@pytest.mark.parametrize("cutoff", [20, 90, 100])
def test_spots_shine_as_far_around_as_opengl_lets_them(cutoff: int) -> None:
    # OpenGL refuses angles above 90 degrees and leaves such a light without a cone, as OGBench's have it.
    model = shapes_model()
    model.light_cutoff[0], model.light_castshadow[:] = cutoff, 0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert compare(model, data, "fixed", [SHADOW])[0] <= 1


@pytest.mark.parametrize("size", [0, 64, 1024])
def test_shadows_are_as_coarse_as_the_model_asks(size: int) -> None:
    model = shapes_model()
    model.vis.quality.shadowsize, model.vis.map.shadowclip, model.vis.map.shadowscale = size, 0.8, 0.9
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    difference, change = compare(model, data, "fixed", [SHADOW])
    assert difference <= COLOUR
    assert (change > 1) == (size > 0)


@pytest.mark.parametrize("name", ["humanoid", "ant", "pusher", "reacher"])
def test_models_that_people_use(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(GYMNASIUM / f"{name}.xml"))
    model.vis.quality.offsamples = 0
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    scatter(model, data, rng, 0.05)
    assert compare(model, data, -1, [SHADOW])[0] <= 1
    assert compare(model, data, random_camera(rng, model), [SHADOW])[0] <= 1


@pytest.mark.parametrize("name", ["tendon around a wheel", "clear tendon", "height field", "cloth", "skin"])
def test_things_that_are_not_plain_geoms_cast_shadows(name: str) -> None:
    model = mujoco.MjModel.from_xml_string(MODELS[name])
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert compare(model, data, "fixed", [SHADOW])[0] <= 0.1


MIRRORS = {
    "plane": ('texuniform="true"/>', 'texuniform="true" reflectance=".5"/>'),
    "box": (
        '<site name="mark"',
        """<geom type="box" size=".6 .5 .1" pos="0 -.8 .1" euler="10 5 0" material="mirror"/>
        <site name="mark\"""",
    ),
}
"""What to put into the model of all shapes so that something mirrors."""


def mirror_model(name: str, samples: int = 0) -> mujoco.MjModel:
    xml = SHAPES_XML.format(samples=samples).replace(*MIRRORS[name])
    mirror = '<material name="mirror" reflectance=".7" rgba=".2 .2 .3 1"/></asset>'
    return mujoco.MjModel.from_xml_string(xml.replace("</asset>", mirror))


@pytest.mark.slow
@pytest.mark.parametrize("antialias", ["off", "multisample"])
@pytest.mark.parametrize("name", MIRRORS)
def test_the_first_plane_or_box_that_reflects_mirrors_the_scene(name: str, antialias: str) -> None:
    model = mirror_model(name, 4 if antialias == "multisample" else 0)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for camera in ("fixed", "parallel", "lens"):
        for flags in ([REFLECTION], [REFLECTION, SHADOW]):
            difference, change = compare(model, data, camera, flags, antialias)
            assert difference <= 1
            assert change > 0.1


def test_a_mirror_seen_from_behind_shows_nothing() -> None:
    model, camera = mirror_model("plane"), mujoco.MjvCamera()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera.lookat[:], camera.distance, camera.elevation = (0, 0, 0.4), 2, 40
    difference, change = compare(model, data, camera, [REFLECTION])
    assert difference <= COLOUR
    assert change == 0


@pytest.mark.parametrize("camera", ["fixed", "parallel", -1])
def test_fog(camera: str | int) -> None:
    model = shapes_model()
    model.vis.map.fogstart, model.vis.map.fogend = 1, 3
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for flags in ([FOG], [FOG, SHADOW], [FOG, SHADOW, REFLECTION]):
        difference, change = compare(model, data, camera, flags)
        assert difference <= 1
        assert change > 5


def test_lights_and_geoms_that_cast_no_shadows() -> None:
    model = shapes_model()
    model.light_castshadow[:] = 0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert compare(model, data, "fixed", [SHADOW])[1] == 0
