"""`vhs.raster.install()` serves real packages, in processes that never load OpenGL."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from raster_support import reference, scatter, shapes_model

import vhs.raster
from vhs._core import RasterCanvas
from vhs.raster.assets import Assets, source_of

PROGRAMS = {
    "gymnasium": """
import gymnasium
env = gymnasium.make("Ant-v5", render_mode="rgb_array")
env.reset(seed=0)
pictures = [env.render()]
env.step(env.action_space.sample())
pictures.append(env.render())
""",
    "gymnasium_robotics": """
import gymnasium, gymnasium_robotics
gymnasium.register_envs(gymnasium_robotics)
env = gymnasium.make("PointMaze_UMaze-v3", render_mode="rgb_array")
env.reset(seed=0)
pictures = [env.render()]
for _ in range(10):
    env.step(env.action_space.sample())
pictures.append(env.render())
""",
    "dm_control": """
from dm_control import suite
env = suite.load("ball_in_cup", "catch", task_kwargs={"random": 0})
env.reset()
pictures = [env.physics.render(120, 160, camera_id=0)]
env.physics.data.qpos[:2] += 0.1
env.physics.forward()
pictures.append(env.physics.render(120, 160, camera_id=0))
depth = env.physics.render(120, 160, camera_id=0, depth=True)
assert 0 < depth.min() < depth.max(), depth
assert (env.physics.render(120, 160, camera_id=0, segmentation=True) >= 0).any()
""",
    "robosuite": """
import robosuite
env = robosuite.make(
    "Lift", robots="Panda", has_renderer=False, has_offscreen_renderer=True, use_camera_obs=True, seed=0,
    camera_names="agentview", camera_heights=84, camera_widths=84,
)
pictures = [env.reset()["agentview_image"]]
for _ in range(5):
    seen, *_ = env.step([0.5] * env.action_dim)
pictures.append(seen["agentview_image"])
""",
    "ogbench": """
import gymnasium, ogbench
env = gymnasium.make("cube-single-v0", render_mode="rgb_array", width=84, height=84)
env.reset(seed=0)
pictures = [env.render()]
for _ in range(5):
    env.step(env.action_space.sample())
pictures.append(env.render())
""",
    "mujoco": """
import mujoco
model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size="1"/></worldbody></mujoco>')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer, pictures = mujoco.Renderer(model, 60, 80), []
for distance in (3, 5):
    camera = mujoco.MjvCamera()
    camera.distance = distance
    renderer.update_scene(data, camera)
    pictures.append(renderer.render())
""",
}
"""Programs that leave two pictures of a scene that has moved."""

CHECK = """
import numpy as np
for picture in pictures:
    assert picture.dtype == np.uint8 and picture.shape[-1] == 3 and picture.std() > 5, picture
assert (pictures[0] != pictures[1]).any(), "the scene moved"
with open("/proc/self/maps") as maps:
    names = ("libEGL", "libOSMesa")
    loaded = [line for line in maps if any(name in line for name in names)]
assert not loaded, loaded
"""


@pytest.mark.skipif(sys.platform != "linux", reason="looks at loaded libraries in /proc")
@pytest.mark.parametrize("package", PROGRAMS)
def test_programs_that_draw_through_mujoco_need_no_opengl(package: str) -> None:
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    program = "import vhs.raster\nvhs.raster.install()\n" + PROGRAMS[package] + CHECK
    environment = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "DISPLAY")}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.parametrize("samples", [0, 4])
def test_mujocos_renderer_gives_the_same_results_without_opengl(samples: int) -> None:
    model = shapes_model(samples)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    scatter(model, data, rng, 0.1)

    def results(renderer: mujoco.Renderer) -> list[np.ndarray]:
        found = []
        for camera in ("fixed", "lens", "parallel", -1):
            renderer.update_scene(data, camera)
            renderer.update_scene(data, camera)
            found.append(renderer.render().astype(float))
            renderer.enable_depth_rendering()
            found.append(renderer.render())
            renderer.enable_segmentation_rendering()
            found.append(renderer.render())
            renderer.disable_segmentation_rendering()
        return found

    expected = results(reference(model, 96, 128))
    before = mujoco.MjrContext
    with vhs.raster.install():
        assert mujoco.MjrContext is not before
        actual = results(reference(model, 96, 128))
    assert mujoco.MjrContext is before
    for i in range(0, len(expected), 3):
        assert np.abs(expected[i] - actual[i]).mean() <= 1
        assert np.median(np.abs(expected[i + 1] / actual[i + 1] - 1)) <= 1e-3
        assert (expected[i + 2] != actual[i + 2]).any(-1).mean() <= 0.01


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_scenes_of_one_model_share_its_textures() -> None:
    # dm_control makes a scene for every picture, and each had a copy of all textures.
    model = mujoco.MjModel.from_xml_string("""<mujoco><asset>
      <texture name="large" type="2d" builtin="checker" width="1024" height="1024"/>
      <material name="m" texture="large"/>
    </asset><worldbody><geom size="1" material="m"/></worldbody></mujoco>""")
    pages, copy = Path("/proc/self/statm"), 4 * 1024 * 1024

    def held() -> int:
        return int(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    assets = Assets.of(model, has_sky=True)
    scenes = [mujoco.MjvScene(model, 10) for _ in range(25)]
    canvases, start = [], 0
    for scene in scenes:
        source = source_of(mujoco, model, scene, assets)
        canvases.append(RasterCanvas(assets.scene, source, 8, 8, 0))
        start = start or held()
    assert held() - start < 8 * copy


def test_a_read_before_anything_was_rendered_says_so() -> None:
    model = shapes_model()
    with vhs.raster.install():
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150)
        with pytest.raises(RuntimeError, match="expected a rendered scene, found none"):
            mujoco.mjr_readPixels(np.zeros(12, np.uint8), None, mujoco.MjrRect(0, 0, 2, 2), context)
        context.free()
        with pytest.raises(RuntimeError, match="found it freed"):
            mujoco.mjr_render(mujoco.MjrRect(0, 0, 2, 2), mujoco.MjvScene(model, 10), context)
