"""The room as one MuJoCo model, and where things are in it.

Owns the MJCF of floor, walls, lights and objects, and `RoomModel`: the compiled model with the indices that
the environment needs. Models are cached by (config, objects), so that all environments of a process share
one.

Invariants: objects are mocap bodies, so placing them writes poses and never recompiles; the only pairs that
can collide are the bumper with a wall and the bumper with an object's box.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from vhs.envs.config import OBJECT_NAMES, RoomConfig
from vhs.envs.kinematics import Footprint
from vhs.envs.objects import ObjectAsset, load_objects
from vhs.envs.robot import (
    COLLISION_GROUP,
    MATERIALS,
    actuators_xml,
    robot_body_xml,
    tune_servos,
)
from vhs.envs.textures import planks, tiles
from vhs.png import png_bytes

NEAR_WALL_GROUP = 2
"""Geom group of the two walls between the onlooker and the room, cut away in the third-person view."""
ONLOOKER = "onlooker"
"""Camera of the third-person view."""
ONLOOKER_PX = 480
"""Height and width of the third-person view."""

_HALF_SQRT = math.sqrt(0.5)


@dataclass(frozen=True, slots=True)
class ObjectPose:
    """Where and how one object stands or lies."""

    x_m: float
    y_m: float
    yaw_rad: float
    is_lying: bool


@dataclass(frozen=True, slots=True, eq=False)
class RoomModel:
    """A compiled room; shared between environments and never written to after it is built."""

    model: mujoco.MjModel
    half_extents_m: tuple[tuple[float, float, float], ...]
    """Per object: half of the upright, scaled bounding box along x, y and z."""
    mocap_ids: tuple[int, ...]
    """Per object: its row in `MjData.mocap_pos`."""

    def footprint(self, label: int, pose: ObjectPose) -> Footprint:
        """Outline of an object on the floor."""
        half_x, half_y, half_z = self.half_extents_m[label]
        return Footprint(pose.x_m, pose.y_m, pose.yaw_rad, half_z if pose.is_lying else half_x, half_y)

    def place(self, data: mujoco.MjData, label: int, pose: ObjectPose) -> None:
        """Put an object on the floor."""
        half_x, _, half_z = self.half_extents_m[label]
        row = self.mocap_ids[label]
        cos, sin = math.cos(pose.yaw_rad / 2), math.sin(pose.yaw_rad / 2)
        if pose.is_lying:
            # Yaw after a quarter turn about y, which sends the object's z axis to x and its front up.
            data.mocap_quat[row] = (cos * _HALF_SQRT, -sin * _HALF_SQRT, cos * _HALF_SQRT, sin * _HALF_SQRT)
        else:
            data.mocap_quat[row] = (cos, 0.0, 0.0, sin)
        data.mocap_pos[row] = (pose.x_m, pose.y_m, half_x if pose.is_lying else half_z)


@lru_cache(maxsize=8)
def load_room(config: RoomConfig, objects_dir: Path | None) -> RoomModel:
    """Build, compile and tune the room once for all environments that ask for the same one."""
    assets = load_objects(objects_dir)
    files = {f"{asset.name}.png": asset.texture_png for asset in assets}
    files |= {name: content for asset in assets for name, content in asset.files}
    files |= {f"{name}.png": png_bytes(picture) for name, picture in _pictures().items()}
    model = mujoco.MjModel.from_xml_string(room_xml(config, assets), files)
    tune_servos(model, config)
    scale = config.object_scale
    half_extents = tuple(
        (scale * asset.half_extents_m[0], scale * asset.half_extents_m[1], scale * asset.half_extents_m[2])
        for asset in assets
    )
    mocap_ids = tuple(int(model.body(name).mocapid[0]) for name in OBJECT_NAMES)
    return RoomModel(model, half_extents, mocap_ids)


def room_xml(config: RoomConfig, assets: tuple[ObjectAsset, ...]) -> str:
    """The whole room as MJCF text."""
    scale = config.object_scale
    meshes = "".join(
        f'\n    <mesh name="{a.name}" scale="{scale} {scale} {scale}" inertia="shell" {a.mesh_xml}/>'
        for a in assets
    )
    textures = "".join(
        f'\n    <texture name="{name}" type="2d" file="{name}.png"/>'
        f'\n    <material name="{name}" texture="{name}" specular="0" shininess="0"/>'
        for name in (*OBJECT_NAMES, *_pictures())
    )
    bodies = "".join(_object_xml(asset, scale) for asset in assets)
    return f"""
<mujoco model="vhs room">
  <compiler angle="degree" autolimits="true"/>
  <option timestep="{config.physics_dt_s}" integrator="implicitfast"/>
  <visual>
    <global offwidth="{ONLOOKER_PX}" offheight="{ONLOOKER_PX}"/>
    <quality shadowsize="2048" offsamples="0" numquads="1" numslices="20" numstacks="8"/>
    <headlight ambient="0.5 0.5 0.5" diffuse="0.2 0.2 0.2" specular="0 0 0"/>
    <map znear="0.02" zfar="12" shadowclip="3"/>
  </visual>
  <statistic extent="1" center="0 0 0.5"/>
  <default>
    <default class="shell">
      <geom contype="0" conaffinity="0" group="4" mass="0"/>
    </default>
    <default class="link">
      <geom contype="0" conaffinity="0" group="4" material="robot_metal"/>
    </default>
    <default class="cap">
      <geom type="cylinder" euler="90 0 0" contype="0" conaffinity="0" group="4" material="robot_blue"/>
    </default>
    <default class="arm">
      <joint type="hinge" armature="0.5"/>
    </default>
  </default>
  <asset>
    <texture name="backdrop" type="skybox" builtin="gradient" rgb1="0.93 0.94 0.96" rgb2="0.7 0.74 0.8"
      width="32" height="192"/>{meshes}{textures}{MATERIALS}
  </asset>
  <worldbody>
    <light directional="true" pos="0 0 4" dir="0.35 0.25 -0.9" diffuse="0.45 0.45 0.45" specular="0 0 0"/>
    {_onlooker_xml(config)}
    {_walls_xml(config)}{bodies}{robot_body_xml(config)}
  </worldbody>
  <actuator>{actuators_xml()}
  </actuator>
</mujoco>
"""


def _onlooker_xml(config: RoomConfig) -> str:
    """The third-person camera: looks over the two near walls, from as far away as the room is large."""
    eye = tuple(config.half_side_m * factor for factor in (-1.73, -2.2, 2.33))
    forward = np.subtract((0.0, -0.02, 0.12), eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    axes = " ".join(f"{value:.6g}" for value in (*right, *np.cross(right, forward)))
    return f'<camera name="{ONLOOKER}" pos="{eye[0]} {eye[1]} {eye[2]}" xyaxes="{axes}" fovy="49"/>'


def _object_xml(asset: ObjectAsset, scale: float) -> str:
    """One object: what is seen, and the box that the bumper meets."""
    half = " ".join(f"{scale * extent:.6g}" for extent in asset.half_extents_m)
    return f"""
    <body name="{asset.name}" mocap="true">
      <geom type="mesh" mesh="{asset.name}" material="{asset.name}" contype="0" conaffinity="0" mass="0"/>
      <geom name="{asset.name}_box" type="box" size="{half}" contype="0" conaffinity="1"
        group="{COLLISION_GROUP}"/>
    </body>"""


def _walls_xml(config: RoomConfig) -> str:
    """Floor and four planes that face inwards: a plane also stops what has got behind it, a box would not."""
    half, height = config.half_side_m, config.wall_height_m / 2
    # Plane axes: x along the wall to the right as seen from inside, y up, normal into the room.
    walls = {
        "wall_ahead": (f"0 {half} {height}", "1 0 0 0 0 1", 0),
        "wall_right": (f"{half} 0 {height}", "0 -1 0 0 0 1", 0),
        "wall_behind": (f"0 {-half} {height}", "-1 0 0 0 0 1", NEAR_WALL_GROUP),
        "wall_left": (f"{-half} 0 {height}", "0 1 0 0 0 1", NEAR_WALL_GROUP),
    }
    planes = "".join(
        f'\n    <geom name="{name}" type="plane" pos="{pos}" xyaxes="{axes}" size="{half} {height} 1" '
        f'group="{group}" material="{name}" contype="0" conaffinity="1"/>'
        for name, (pos, axes, group) in walls.items()
    )
    return (
        f'<geom name="floor" type="plane" size="{half} {half} 1" material="floor" contype="0" '
        f'conaffinity="0"/>' + planes
    )


def _pictures() -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
    """Floor and walls: muted, and each wall its own, so that a robot can tell where it looks."""
    return {
        "floor": tiles((124, 122, 120), (142, 140, 137), seed=1),
        "wall_ahead": planks((120, 132, 150), (136, 147, 163), seed=2, planks_a_side=12, upright=True),
        "wall_right": planks((154, 138, 122), (140, 124, 108), seed=3, planks_a_side=10, upright=False),
        "wall_behind": planks((110, 112, 118), (150, 152, 158), seed=4, planks_a_side=6, upright=True),
        "wall_left": planks((150, 134, 148), (132, 116, 132), seed=5, planks_a_side=5, upright=False),
    }
