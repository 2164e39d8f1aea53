"""Real dynamics: strides, turns, walls and objects."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product

import mujoco
import numpy as np
import pytest

from vhs.envs import OBJECT_NAMES, RoomConfig, RoomEnv
from vhs.envs.config import MOVE_FORWARD, TURN_LEFT, TURN_RIGHT
from vhs.envs.kinematics import Pose
from vhs.envs.scene import ObjectPose

Arrange = Callable[..., None]
CONFIG = RoomConfig()


def yaw_error_deg(env: RoomEnv, heading: int) -> float:
    error_rad = env.world.measured_pose[2] - heading * math.pi / 4
    return math.degrees(math.remainder(error_rad, math.tau))


def bumper_gap_m(env: RoomEnv, other: str) -> float:
    """Gap between the bumper and another geom, by MuJoCo's own collision code."""
    model, data = env.world.model, env.world.data
    ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name) for name in ("bumper", other)]
    return float(mujoco.mj_geomDistance(model, data, ids[0], ids[1], 2.0, np.zeros(6)))


def test_the_robot_has_nine_degrees_of_freedom_and_steps_as_designed(blind_room: RoomEnv) -> None:
    model = blind_room.world.model
    assert (model.nv, model.nu) == (9, 9)
    assert model.opt.timestep == 0.02
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def test_only_the_bumper_collides_with_walls_and_object_boxes(blind_room: RoomEnv) -> None:
    model = blind_room.world.model
    moving = {model.geom(i).name for i in range(model.ngeom) if model.geom_contype[i]}
    solid = {model.geom(i).name for i in range(model.ngeom) if model.geom_conaffinity[i]}
    assert moving == {"bumper"}
    assert {name for name in solid if name.startswith("wall_")} == {
        "wall_ahead",
        "wall_right",
        "wall_behind",
        "wall_left",
    }
    assert len(solid) == 4 + 5


@pytest.mark.parametrize("heading", range(8))
def test_a_free_stride_ends_within_a_centimetre(blind_room: RoomEnv, arrange: Arrange, heading: int) -> None:
    arrange(blind_room, Pose(0.0, 0.0, heading))
    blind_room.step(MOVE_FORWARD)
    x_m, y_m, _ = blind_room.world.measured_pose
    assert math.hypot(x_m, y_m) == pytest.approx(0.5, abs=0.01)
    assert math.atan2(y_m, x_m) == pytest.approx(math.remainder(heading * math.pi / 4, math.tau), abs=0.01)
    assert abs(yaw_error_deg(blind_room, heading)) < 1.0


@pytest.mark.parametrize(("action", "sign"), [(TURN_LEFT, 1), (TURN_RIGHT, -1)])
def test_turns_end_within_a_degree_and_do_not_add_up_errors(
    blind_room: RoomEnv, arrange: Arrange, action: int, sign: int
) -> None:
    arrange(blind_room, Pose(0.0, 0.0, 2))
    for turn in range(1, 20):
        blind_room.step(action)
        assert abs(yaw_error_deg(blind_room, 2 + sign * turn)) < 1.0
    x_m, y_m, _ = blind_room.world.measured_pose
    assert math.hypot(x_m, y_m) < 0.01


def test_a_long_walk_stays_on_the_lattice_and_touches_nothing(blind_room: RoomEnv) -> None:
    rng = np.random.default_rng(0)
    worst_m = worst_deg = 0.0
    for episode in range(60):
        blind_room.reset(seed=episode)
        for _ in range(CONFIG.horizon_steps):
            blind_room.step(int(rng.integers(3)))
            commanded = blind_room.world.commanded_pose
            x_m, y_m, _ = blind_room.world.measured_pose
            worst_m = max(worst_m, math.hypot(x_m - commanded.x_m, y_m - commanded.y_m))
            worst_deg = max(worst_deg, abs(yaw_error_deg(blind_room, commanded.heading)))
            assert blind_room.world.data.ncon == 0
    print(f"worst pose error over 1200 random movements: {1000 * worst_m:.2f} mm, {worst_deg:.3f} degrees")
    assert worst_m < 0.001
    assert worst_deg < 0.1


def test_the_camera_is_up_to_date_with_the_joints_after_a_movement(
    blind_room: RoomEnv, arrange: Arrange
) -> None:
    arrange(blind_room, Pose(0.0, 0.0, 1))
    world = blind_room.world
    for action in (MOVE_FORWARD, TURN_LEFT):
        blind_room.step(action)
        x_m, y_m, yaw_rad = world.measured_pose
        forward_m = CONFIG.camera_forward_m
        expected = (x_m + forward_m * math.cos(yaw_rad), y_m + forward_m * math.sin(yaw_rad), 0.6)
        assert world.data.cam("first_person").xpos == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("heading", "wall"), [(0, "wall_right"), (2, "wall_ahead"), (4, "wall_left"), (6, "wall_behind")]
)
def test_a_wall_stops_the_robot_without_drift(
    blind_room: RoomEnv, arrange: Arrange, heading: int, wall: str
) -> None:
    arrange(blind_room, Pose(0.1, -0.1, heading))
    poses = []
    for _ in range(12):
        blind_room.step(MOVE_FORWARD)
        poses.append(blind_room.world.measured_pose)
    assert 0.0 <= bumper_gap_m(blind_room, wall) < 0.002
    settled = np.array(poses[4:])
    assert np.ptp(settled, axis=0).max() < 1e-6


@pytest.mark.parametrize("heading", [1, 3, 5, 7])
def test_a_wall_met_at_an_angle_does_not_let_the_robot_slide(
    blind_room: RoomEnv, arrange: Arrange, heading: int
) -> None:
    arrange(blind_room, Pose(0.4, 0.0, heading))
    poses = []
    for _ in range(10):
        blind_room.step(MOVE_FORWARD)
        poses.append(blind_room.world.measured_pose)
    # Still on the line of the first stride, and at rest.
    along = [
        (x - 0.4) * math.sin(heading * math.pi / 4) - y * math.cos(heading * math.pi / 4) for x, y, _ in poses
    ]
    assert max(map(abs, along)) < 1e-3
    assert np.ptp(np.array(poses[5:]), axis=0).max() < 1e-6


@pytest.mark.parametrize("is_lying", [False, True])
@pytest.mark.parametrize("label", range(5))
def test_an_object_stops_the_robot_where_the_bumper_touches(
    blind_room: RoomEnv, arrange: Arrange, label: int, is_lying: bool
) -> None:
    pose = ObjectPose(0.5, 0.06, 0.7, is_lying)
    arrange(blind_room, Pose(-0.3, 0.0, 0), {label: pose})
    for _ in range(4):
        blind_room.step(MOVE_FORWARD)
    name = f"{OBJECT_NAMES[label]}_box"
    assert 0.0 <= bumper_gap_m(blind_room, name) < 0.002
    stopped = blind_room.world.measured_pose
    blind_room.step(MOVE_FORWARD)
    assert blind_room.world.measured_pose == pytest.approx(stopped, abs=1e-6)
    # A touching bumper does not hold the robot back: it turns round and leaves with a full stride.
    for _ in range(4):
        blind_room.step(TURN_LEFT)
    blind_room.step(MOVE_FORWARD)
    assert stopped[0] - blind_room.world.measured_pose[0] == pytest.approx(0.5, abs=0.01)


def test_walls_are_solid_even_for_a_servo_that_ignores_the_bumper(
    blind_room: RoomEnv, arrange: Arrange
) -> None:
    arrange(blind_room, Pose(1.2, 0.0, 0))
    data = blind_room.world.data
    data.ctrl[0] = 1.35
    mujoco.mj_step(blind_room.world.model, data, 150)
    assert data.ncon > 0
    assert data.qpos[0] < 1.5 - CONFIG.bumper_radius_m + 0.05


def test_the_arm_stays_folded_through_strides_and_turns(blind_room: RoomEnv, arrange: Arrange) -> None:
    arrange(blind_room, Pose(0.0, 0.0, 0))
    folded = blind_room.world.data.qpos[3:].copy()
    for action in (MOVE_FORWARD, TURN_LEFT, TURN_LEFT, MOVE_FORWARD, TURN_RIGHT):
        blind_room.step(action)
        assert np.abs(blind_room.world.data.qpos[3:] - folded).max() < 0.02


def test_the_whole_robot_stays_within_its_bumper(blind_room: RoomEnv, arrange: Arrange) -> None:
    arrange(blind_room, Pose(0.0, 0.0, 0))
    model, data = blind_room.world.model, blind_room.world.data
    robot = [i for i in range(model.ngeom) if model.geom_group[i] == 4]
    assert len(robot) > 12
    base = model.body("base").id
    for geom in robot:
        # The bounding box in the geom's frame, its corners in the world's.
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        corners = np.array([centre + half * signs for signs in product((-1, 1), repeat=3)])
        if model.geom_bodyid[geom] == base and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
            assert np.hypot(*data.geom_xpos[geom, :2]) + half[0] <= CONFIG.bumper_radius_m + 1e-9
            continue
        spots = data.geom_xpos[geom] + corners @ data.geom_xmat[geom].reshape(3, 3).T
        assert np.hypot(spots[:, 0], spots[:, 1]).max() <= CONFIG.bumper_radius_m, model.geom_bodyid[geom]
