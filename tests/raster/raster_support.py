"""Scenes, a reference renderer and measures for the renderer's tests."""

from __future__ import annotations

import os

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from vhs.raster import RasterRenderer

SHAPES_XML = """
<mujoco>
  <visual><map znear="0.01" zfar="30"/><quality offsamples="{samples}"/></visual>
  <statistic extent="2" center="0 0 0.4"/>
  <asset>
    <texture name="grid" type="2d" builtin="checker" rgb1=".1 .2 .3" rgb2=".8 .7 .6" width="128" height="128"
      mark="edge" markrgb="1 0 0"/>
    <texture name="ramp" type="2d" builtin="gradient" rgb1="1 0 0" rgb2="0 0 1" width="64" height="64"/>
    <texture name="sides" type="cube" builtin="gradient" rgb1="1 0 0" rgb2="0 1 1" width="64" height="64"
      mark="cross"/>
    <texture type="skybox" builtin="gradient" rgb1="0.3 0.5 0.7" rgb2="0 0 0" width="64" height="384"/>
    <material name="floor" texture="grid" texrepeat="2 2" texuniform="true"/>
    <material name="ramp" texture="ramp"/>
    <material name="grid" texture="grid" texrepeat="2 2" specular="0" emission="0.2"/>
    <material name="sides" texture="sides"/>
    <mesh name="wedge" vertex="-.2 -.2 -.1  .2 -.2 -.1  .2 .2 -.1  -.2 .2 -.1  0 0 .3"/>
  </asset>
  <worldbody>
    <light pos="1 1 3" dir="-.3 -.3 -1" diffuse=".6 .6 .6"/>
    <light pos="0 0 3" dir="0.3 0 -1" type="directional" diffuse=".2 .2 .2" specular=".2 .2 .2"/>
    <geom name="floor" type="plane" size="0 0 .1" material="floor"/>
    <body pos="0 0 .4"><freejoint/><geom type="box" size=".2 .25 .3" material="grid"/></body>
    <body pos=".7 0 .4"><freejoint/><geom type="sphere" size=".25" material="ramp"/></body>
    <body pos="-.7 0 .4"><freejoint/><geom type="cylinder" size=".2 .3" material="grid"/></body>
    <body pos="0 .8 .5"><freejoint/><geom type="capsule" size=".15 .3" material="grid"/></body>
    <body pos=".7 .8 .4"><freejoint/><geom type="ellipsoid" size=".15 .3 .2" material="sides"/></body>
    <body pos="-.7 .8 .4"><freejoint/><geom type="box" size=".15 .3 .2" material="sides"/></body>
    <body pos="0 -.7 .3"><freejoint/><geom type="sphere" size=".15" rgba="1 .2 .1 .5"/></body>
    <body pos=".3 -.9 .3"><freejoint/><geom type="capsule" size=".05 .2" rgba=".2 1 .1 .7"/></body>
    <body pos="-.6 -.7 .3"><freejoint/><geom type="mesh" mesh="wedge" rgba=".3 .4 .9 1"/></body>
    <site name="mark" pos=".6 -.7 .3" type="box" size=".05 .1 .2" rgba="0 1 0 1"/>
    <camera name="fixed" pos="0.1 -2.6 1.5" xyaxes="1 0 0 0 .5 1"/>
    <camera name="parallel" pos="0 -3 2" xyaxes="1 0 0 0 .6 1" projection="orthographic" fovy="2.5"/>
    <camera name="lens" pos="0.2 -2.5 1.4" xyaxes="1 0 0 0 .5 1" resolution="320 240" sensorsize="0.004 0.003"
      focal="0.004 0.0036" principal="0.0002 0.0001"/>
  </worldbody>
</mujoco>
"""
"""Every shape, texture kind, light kind, material and camera that is drawn."""


def shapes_model(samples: int = 0) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(SHAPES_XML.format(samples=samples))


def plain(scene: mujoco.MjvScene) -> None:
    """Switches shadows and reflections off."""
    for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        scene.flags[flag] = False


def ours(model: mujoco.MjModel, height: int, width: int, antialias: str = "off") -> RasterRenderer:
    """Our renderer without shadows and reflections."""
    renderer = RasterRenderer(model, height, width, antialias=antialias)
    plain(renderer.scene)
    return renderer


def reference(model: mujoco.MjModel, height: int, width: int) -> mujoco.Renderer:
    """MuJoCo's renderer without shadows and reflections; skips the test where there is no OpenGL."""
    try:
        renderer = mujoco.Renderer(model, height, width)
    except Exception as error:  # GL bindings raise what their platform happens to raise.
        pytest.skip(f"no OpenGL to compare with: {error}")
    plain(renderer.scene)
    return renderer


def scatter(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator, spread: float) -> None:
    """Moves every joint at random."""
    mujoco.mj_resetData(model, data)
    data.qpos += rng.normal(0, spread, model.nq)
    mujoco.mj_forward(model, data)


def random_camera(rng: np.random.Generator, model: mujoco.MjModel) -> mujoco.MjvCamera:
    """A free camera that looks at the middle of the model from anywhere above the ground."""
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.azimuth, camera.elevation = rng.uniform(0, 360), rng.uniform(-80, -5)
    camera.distance *= rng.uniform(0.5, 1.2)
    return camera


def differences(
    expected: mujoco.Renderer,
    actual: RasterRenderer,
    data: mujoco.MjData,
    camera: object,
    option: object = None,
) -> tuple[float, float, float]:
    """Mean difference of colours (0..255), share of pixels with another segment, and largest relative
    difference of distance; the last two away from the edges of segments.
    """
    # MuJoCo moves endless planes to where the camera was at the last update, hence two of them.
    for _ in range(2):
        expected.update_scene(data, camera, option)
    actual.update_scene(data, camera, option)
    colour = np.abs(expected.render().astype(int) - actual.render()).mean()
    for renderer in (expected, actual):
        renderer.enable_segmentation_rendering()
    segments, ours = expected.render(), actual.render()
    inside = ~near_edges(segments)
    segment = (segments != ours).any(-1)[inside].mean()
    for renderer in (expected, actual):
        renderer.enable_depth_rendering()
    distance = np.abs(actual.render() / expected.render() - 1)[inside].max()
    for renderer in (expected, actual):
        renderer.disable_depth_rendering()
    return float(colour), float(segment), float(distance)


def near_edges(segments: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Pixels with another segment above, below, left or right of them."""
    edge = np.zeros(segments.shape[:2], dtype=bool)
    down = (segments[1:] != segments[:-1]).any(-1)
    across = (segments[:, 1:] != segments[:, :-1]).any(-1)
    edge[1:] |= down
    edge[:-1] |= down
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    return edge
