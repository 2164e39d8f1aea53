"""The room in motion: one simulation state, the robot's commanded pose, and what is in its reach.

Owns `World`. It carries movements out with real dynamics and knows nothing of goals, rewards or images.

Invariants: the commanded pose is on the lattice of `vhs.envs.kinematics` and the servos hold it; the measured
pose follows to within a millimetre of it by the end of a control period. A stride that would touch something
is cut short by what the bumper foresees; contacts stay enabled in the physics, so that nothing can be driven
through either way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco

from vhs.envs.config import (
    FIRST_INTERACTION,
    HEADINGS,
    MOVE_FORWARD,
    OBJECT_NAMES,
    TURN_LEFT,
    RoomConfig,
)
from vhs.envs.kinematics import HEADING_RAD, Footprint, MeasuredPose, Pose, nearest_in_reach, strided, turned
from vhs.envs.robot import ARM_FOLDED_RAD, BASE_JOINTS, JOINTS
from vhs.envs.scene import ObjectPose, RoomModel

_BASE = slice(0, len(BASE_JOINTS))
_ARM = slice(len(BASE_JOINTS), len(JOINTS))


class World:
    """A robot and five objects in a room."""

    def __init__(self, room: RoomModel, config: RoomConfig) -> None:
        """Make a state for a room; `arrange` fills it.

        Args:
            room: the compiled room, shared between worlds.
            config: the room's numbers.
        """
        self.config = config
        self.data = mujoco.MjData(room.model)
        """The simulation's state."""
        self.start_pose = Pose(0.0, 0.0, 0)
        """Commanded pose when the world was arranged."""
        self.commanded_pose = self.start_pose
        """Pose that the servos hold."""
        self.object_poses: tuple[ObjectPose, ...] = ()
        """Poses of the objects, in order of their class labels."""
        self.footprints: tuple[Footprint, ...] = ()
        """Outlines of the objects on the floor, in the same order."""
        self._room = room
        self._centres: tuple[tuple[float, float], ...] = ()
        self._physics_steps = config.physics_steps_per_action
        # Whole turns are kept apart from the heading so that the yaw servo never unwinds.
        self._whole_turns = 0

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled room, shared with other worlds: read only."""
        return self._room.model

    @property
    def measured_pose(self) -> MeasuredPose:
        """From the simulation."""
        return MeasuredPose(*self.data.qpos[_BASE].tolist())

    def arrange(self, start: Pose, poses: Sequence[ObjectPose]) -> None:
        """Put robot and objects in place, at rest.

        Args:
            start: the robot's commanded pose.
            poses: one pose per object, in order of the class labels; nothing checks that they are fair.
        """
        if len(poses) != len(OBJECT_NAMES):
            raise ValueError(f"poses: expected {len(OBJECT_NAMES)} object poses, found {len(poses)}")
        self.object_poses = tuple(poses)
        self.footprints = tuple(self._room.footprint(label, pose) for label, pose in enumerate(poses))
        self._centres = tuple((pose.x_m, pose.y_m) for pose in poses)
        self.start_pose = self.commanded_pose = start
        self._whole_turns = 0
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[_BASE] = self.data.ctrl[_BASE] = (start.x_m, start.y_m, start.heading * HEADING_RAD)
        self.data.qpos[_ARM] = self.data.ctrl[_ARM] = ARM_FOLDED_RAD
        for label, pose in enumerate(poses):
            self._room.place(self.data, label, pose)
        mujoco.mj_forward(self.model, self.data)

    def move(self, action: int) -> None:
        """Command the pose that an action leads to and let the dynamics follow for one control period.

        Args:
            action: any action of any task; interactions hold the present pose.
        """
        pose = self.commanded_pose
        if action == MOVE_FORWARD:
            self.commanded_pose = strided(pose, self.footprints, self.config)
        elif action < FIRST_INTERACTION:
            step = 1 if action == TURN_LEFT else -1
            self._whole_turns += (pose.heading + step) // HEADINGS
            self.commanded_pose = turned(pose, step)
        x_m, y_m, heading = self.commanded_pose
        self.data.ctrl[_BASE] = (x_m, y_m, (heading + HEADINGS * self._whole_turns) * HEADING_RAD)
        mujoco.mj_step(self.model, self.data, self._physics_steps)
        # mj_step leaves bodies and cameras one physics step behind the joints.
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def object_in_reach(self) -> int:
        """Class label of the nearest object in reach of the measured pose; -1 if there is none."""
        x_m, y_m, yaw_rad = self.measured_pose
        return nearest_in_reach(x_m, y_m, math.cos(yaw_rad), math.sin(yaw_rad), self._centres, self.config)
