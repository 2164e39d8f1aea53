"""The robot as MJCF: a Fetch-like base on planar joints, a camera mast, a UR5-like six-joint arm.

Owns the robot's geometry and its servo gains. Built from primitives, since the real meshes are not freely
licensed.

Invariants: nine degrees of freedom in the order `JOINTS`, one position servo each in the same order; one
colliding geom, the bumper cylinder; everything stays within the bumper's radius, and behind the lower edge of
the camera's view, so that leaving the robot out of its own images changes no pixel.
"""

from __future__ import annotations

import mujoco
import numpy as np

from vhs.envs.config import RoomConfig

BASE_JOINTS = ("base_x", "base_y", "base_yaw")
ARM_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
JOINTS = BASE_JOINTS + ARM_JOINTS
ARM_FOLDED_RAD = (1.571, 0.45, -2.1, 0.8, -1.571, 0.0)
"""Posture held by the arm's servos: across the robot's back, out of the camera's view (chosen)."""
CAMERA = "first_person"
BUMPER = "bumper"
ROBOT_GROUP = 4
"""Geom group of the robot's visible parts, left out of its own images."""
COLLISION_GROUP = 3
"""Geom group of collision shapes, never drawn."""

_ARM_SERVO_RATE_PER_S = 150.0
"""Stiffer than the base's servos: a stride must not whip the arm (chosen)."""

MATERIALS = """
    <material name="robot_light" rgba="0.88 0.89 0.91 1" specular="0" shininess="0"/>
    <material name="robot_dark" rgba="0.17 0.18 0.21 1" specular="0" shininess="0"/>
    <material name="robot_blue" rgba="0.16 0.39 0.68 1" specular="0" shininess="0"/>
    <material name="robot_metal" rgba="0.62 0.64 0.67 1" specular="0" shininess="0"/>"""


def robot_body_xml(config: RoomConfig) -> str:
    """The robot's body, 2-space indented for inclusion under `<worldbody>`."""
    return f"""
    <body name="base">
      <joint name="base_x" type="slide" axis="1 0 0"/>
      <joint name="base_y" type="slide" axis="0 1 0"/>
      <joint name="base_yaw" type="hinge" axis="0 0 1"/>
      <geom name="{BUMPER}" type="cylinder" size="{config.bumper_radius_m} 0.05" pos="0 0 0.07"
        group="{COLLISION_GROUP}" contype="1" conaffinity="0" mass="{config.base_mass_kg}"/>
      <geom class="shell" type="cylinder" size="{config.bumper_radius_m} 0.03" pos="0 0 0.06"
        material="robot_dark"/>
      <geom class="shell" type="cylinder" size="0.22 0.05" pos="0 0 0.14" material="robot_light"/>
      <geom class="shell" type="cylinder" size="0.19 0.005" pos="0 0 0.193" material="robot_blue"/>
      <geom class="shell" type="box" size="0.035 0.06 0.17" pos="-0.02 0 0.36" material="robot_light"/>
      <geom class="shell" type="box" size="0.05 0.1 0.04" pos="-0.02 0 0.6" material="robot_light"/>
      <geom class="shell" type="cylinder" size="0.018 0.006" pos="0.03 0 0.6"
        euler="0 90 0" material="robot_dark"/>
      {_camera_xml(config)}{_ARM}
    </body>"""


def actuators_xml() -> str:
    """One position servo a joint, in the order of `JOINTS`; `tune_servos` sets the gains."""
    return "".join(f'\n    <position name="{joint}" joint="{joint}" kp="1"/>' for joint in JOINTS)


def tune_servos(model: mujoco.MjModel, config: RoomConfig) -> None:
    """Give each servo the gains that settle fastest without overshoot at this physics step.

    `implicitfast` treats damping implicitly and stiffness explicitly, which moves critical damping from a
    ratio of 1 to 1 + rate * dt / 2: there both discrete poles are 1 / (1 + rate * dt). With 1 / 2 a physics
    step, 15 steps leave 5e-4 of a stride.
    """
    rates = np.array([config.servo_rate_per_s] * len(BASE_JOINTS) + [_ARM_SERVO_RATE_PER_S] * len(ARM_JOINTS))
    damping_ratio = 1.0 + rates * config.physics_dt_s / 2
    inertia = model.dof_M0
    model.actuator_gainprm[:, 0] = inertia * rates**2
    model.actuator_biasprm[:, 1] = -inertia * rates**2
    model.actuator_biasprm[:, 2] = -2 * damping_ratio * rates * inertia


def _camera_xml(config: RoomConfig) -> str:
    """The first-person camera: looks along the heading (x), pitched down."""
    pitch_rad = np.radians(config.camera_pitch_deg)
    # Image x is the robot's right (-y); image y is up, tilted forward by the pitch.
    axes = f"0 -1 0 {np.sin(pitch_rad):.9f} 0 {np.cos(pitch_rad):.9f}"
    return (
        f'<camera name="{CAMERA}" pos="{config.camera_forward_m} 0 {config.camera_height_m}" '
        f'xyaxes="{axes}" fovy="{config.camera_vfov_deg}"/>'
    )


# UR5 proportions at 0.6 of its size; the axes follow the UR convention: z, y, y, y, z, y.
_ARM = """
      <body name="shoulder" pos="-0.14 0 0.2">
        <joint name="shoulder_pan" class="arm" axis="0 0 1"/>
        <geom class="link" type="cylinder" size="0.045 0.035" pos="0 0 0.035" mass="1.2"/>
        <body name="upper_arm" pos="0 0 0.075">
          <joint name="shoulder_lift" class="arm" axis="0 1 0"/>
          <geom class="cap" size="0.042 0.045" mass="0.5"/>
          <geom class="link" type="capsule" size="0.03" fromto="0 0 0 0 0 0.25" mass="2"/>
          <body name="forearm" pos="0 0 0.25">
            <joint name="elbow" class="arm" axis="0 1 0"/>
            <geom class="cap" size="0.036 0.04" mass="0.4"/>
            <geom class="link" type="capsule" size="0.025" fromto="0 0 0 0 0 0.2" mass="1"/>
            <body name="wrist_1_link" pos="0 0 0.2">
              <joint name="wrist_1" class="arm" axis="0 1 0"/>
              <geom class="cap" size="0.026 0.03" mass="0.3"/>
              <body name="wrist_2_link" pos="0 0 0.055">
                <joint name="wrist_2" class="arm" axis="0 0 1"/>
                <geom class="cap" size="0.025 0.028" mass="0.3" euler="0 0 0"/>
                <body name="wrist_3_link" pos="0 0 0.05">
                  <joint name="wrist_3" class="arm" axis="0 1 0"/>
                  <geom class="cap" size="0.023 0.02" mass="0.2"/>
                  <geom class="link" type="box" size="0.02 0.03 0.008" pos="0 0 0.025" mass="0.1"/>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>"""
