"""Everything that MuJoCo's abstract scene can hold looks as it does through OpenGL."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from raster_models import CROWD, MODELS
from raster_support import differences, ours, reference, scatter, shapes_model

THINGS = 0.1
"""Mean difference of colours allowed, in 255ths: leaving out the thinnest thing here makes more."""


def pictures(
    model: mujoco.MjModel, data: mujoco.MjData, option: object = None
) -> tuple[np.ndarray, np.ndarray]:
    """MuJoCo's picture and ours."""
    expected, actual = reference(model, 120, 160), ours(model, 120, 160)
    for renderer in (expected, expected, actual):
        renderer.update_scene(data, "fixed", option)
    found = expected.render().astype(int), actual.render().astype(int)
    expected.close()
    return found


@pytest.fixture(scope="module")
def crowd() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(CROWD)
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.5
    for _ in range(100):
        mujoco.mj_step(model, data)
    assert data.ncon > 3, "the decorations of contacts need contacts"
    return model, data


@pytest.mark.parametrize("name", MODELS)
def test_things_that_are_not_plain_geoms(name: str) -> None:
    model = mujoco.MjModel.from_xml_string(MODELS[name])
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    expected, actual = reference(model, 120, 160), ours(model, 120, 160)
    for spread in (0, 0.05, 0.1):
        scatter(model, data, rng, spread)
        colour, segment, distance = differences(expected, actual, data, "fixed")
        assert colour <= THINGS
        assert segment <= 0.01
        assert distance <= 0.01
    expected.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "flag"),
    [
        ("tendon around a wheel", mujoco.mjtVisFlag.mjVIS_TENDON),
        ("range finder", mujoco.mjtVisFlag.mjVIS_RANGEFINDER),
        ("skin", mujoco.mjtVisFlag.mjVIS_SKIN),
        ("cloth", mujoco.mjtVisFlag.mjVIS_FLEXSKIN),
    ],
)
def test_what_an_option_hides_is_hidden(name: str, flag: int) -> None:
    model, option = mujoco.MjModel.from_xml_string(MODELS[name]), mujoco.MjvOption()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    shown, _ = pictures(model, data)
    option.flags[flag] = 0
    expected, actual = pictures(model, data, option)
    assert np.abs(shown - expected).mean() > THINGS, "it shows when it is not hidden"
    assert np.abs(expected - actual).mean() <= THINGS


@pytest.mark.slow
@pytest.mark.parametrize("flag", range(mujoco.mjtVisFlag.mjNVISFLAG))
def test_decorations(crowd: tuple[mujoco.MjModel, mujoco.MjData], flag: int) -> None:
    option = mujoco.MjvOption()
    option.flags[flag] = 1 - option.flags[flag]
    expected, actual = pictures(*crowd, option)
    assert np.abs(expected - actual).mean() <= 0.5


@pytest.mark.parametrize("frame", range(1, mujoco.mjtFrame.mjNFRAME))
def test_frames(crowd: tuple[mujoco.MjModel, mujoco.MjData], frame: int) -> None:
    option = mujoco.MjvOption()
    option.frame = frame
    expected, actual = pictures(*crowd, option)
    assert np.abs(expected - actual).mean() <= THINGS


def add_markers(scene: mujoco.MjvScene) -> None:
    """Adds one geom of every kind that only programs make."""
    kinds = ("ARROW", "ARROW1", "ARROW2", "LINE", "LINEBOX", "TRIANGLE", "SPHERE", "CAPSULE")
    for i, kind in enumerate(kinds):
        geom = scene.geoms[scene.ngeom]
        place = np.array([-0.7 + 0.2 * i, -0.4, 0.3])
        size = np.array([1.0 if kind == "LINE" else 0.05, 0.05, 0.3])
        turn = np.array([1.0, 0, 0, 0, 0, -1, 0, 1, 0]) if kind == "TRIANGLE" else np.eye(3).ravel()
        colour = np.array([0.2 + 0.1 * i, 1 - 0.1 * i, 0.3, 1], np.float32)
        mujoco.mjv_initGeom(geom, getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"), size, place, turn, colour)
        scene.ngeom += 1


def test_geoms_that_the_caller_adds_and_changes(crowd: tuple[mujoco.MjModel, mujoco.MjData]) -> None:
    model, data = crowd
    found = []
    for renderer in (reference(model, 120, 160), ours(model, 120, 160)):
        renderer.update_scene(data, "fixed")
        before = renderer.render().astype(int)
        add_markers(renderer.scene)
        moved = renderer.scene.geoms[1]
        moved.rgba[:], moved.pos[2], moved.size[0] = (1, 0, 1, 1), 0.4, 0.2
        found.append(renderer.render().astype(int))
        assert np.abs(found[-1] - before).mean() > 1
    assert np.abs(found[0] - found[1]).mean() <= THINGS


@pytest.mark.slow
def test_colours_sizes_and_materials_are_read_at_every_update() -> None:
    model = shapes_model()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    expected, actual = reference(model, 120, 160), ours(model, 120, 160)

    def change(what: str) -> None:
        if what == "colour":
            model.geom_rgba[7], model.site_rgba[0] = (1, 0, 1, 1), (0, 0, 1, 1)
        elif what == "size":
            model.geom_size[1:7] *= 1.5
        elif what == "material":
            model.mat_rgba[:, 1], model.mat_emission[:], model.geom_matid[7] = 0.2, 0.3, 1
        elif what == "texture":
            model.mat_texrepeat[:] *= 2
        elif what == "light":
            model.light_diffuse[0], model.vis.headlight.ambient[:] = (1, 0, 0), 0.3
        elif what == "lens":
            model.cam_fovy[0] *= 1.3

    last = None
    for what in ("nothing", "colour", "size", "material", "light", "lens"):
        change(what)
        colour, segment, distance = differences(expected, actual, data, "fixed")
        assert (colour <= 4, segment <= 0.01, distance <= 0.01) == (True, True, True), what
        picture = actual.render().copy()
        assert last is None or np.abs(picture.astype(int) - last).mean() > 0.3, what
        last = picture
    change("texture")
    actual.update_scene(data, "fixed")
    assert not np.array_equal(actual.render(), last)
    expected.close()
