from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vhs.envs import RoomConfig
from vhs.envs.kinematics import (
    HEADING_COS,
    HEADING_SIN,
    Footprint,
    Pose,
    free_way_m,
    nearest_in_reach,
    strided,
    turned,
    way_to_touch_m,
)

CONFIG = RoomConfig()
RADIUS_M = CONFIG.bumper_radius_m + CONFIG.bumper_clearance_m


def distance_to_rectangle_m(x_m: float, y_m: float, footprint: Footprint) -> float:
    """The definition, written apart from the code under test."""
    c, s = math.cos(footprint.yaw_rad), math.sin(footprint.yaw_rad)
    dx, dy = x_m - footprint.x_m, y_m - footprint.y_m
    along, across = abs(c * dx + s * dy), abs(-s * dx + c * dy)
    return math.hypot(max(0.0, along - footprint.half_length_m), max(0.0, across - footprint.half_width_m))


footprints = st.builds(
    Footprint,
    st.floats(-1.2, 1.2),
    st.floats(-1.2, 1.2),
    st.floats(0.0, math.tau),
    st.floats(0.03, 0.25),
    st.floats(0.03, 0.25),
)


@settings(max_examples=300, deadline=None)
@given(
    footprint=footprints, angle=st.floats(0.0, math.tau), x_m=st.floats(-1.2, 1.2), y_m=st.floats(-1.2, 1.2)
)
def test_way_to_touch_agrees_with_tiny_steps(
    footprint: Footprint, angle: float, x_m: float, y_m: float
) -> None:
    if distance_to_rectangle_m(x_m, y_m, footprint) < RADIUS_M + 1e-3:
        return  # Overlapping starts are tested by themselves.
    cos, sin = math.cos(angle), math.sin(angle)
    way_m = way_to_touch_m(x_m, y_m, cos, sin, footprint, RADIUS_M)
    step_m = 0.005
    walked = [
        distance_to_rectangle_m(x_m + i * step_m * cos, y_m + i * step_m * sin, footprint)
        for i in range(int(min(way_m, 4.0) / step_m))
    ]
    # Free all the way there ...
    assert all(distance_m >= RADIUS_M - 1e-9 for distance_m in walked)
    # ... and touching at its end.
    if math.isfinite(way_m):
        at_end_m = distance_to_rectangle_m(x_m + way_m * cos, y_m + way_m * sin, footprint)
        assert at_end_m == pytest.approx(RADIUS_M, abs=1e-9)


def test_a_touching_robot_may_leave_and_slide_by_but_not_press_on() -> None:
    box = Footprint(1.0, 0.0, 0.0, 0.1, 0.2)
    x_m = 1.0 - 0.1 - RADIUS_M
    assert way_to_touch_m(x_m, 0.0, 1.0, 0.0, box, RADIUS_M) == 0.0
    assert way_to_touch_m(x_m, 0.0, math.sqrt(0.5), math.sqrt(0.5), box, RADIUS_M) == 0.0
    assert way_to_touch_m(x_m, 0.0, -1.0, 0.0, box, RADIUS_M) == math.inf
    assert way_to_touch_m(x_m, 0.0, 0.0, 1.0, box, RADIUS_M) == math.inf


@pytest.mark.parametrize("heading", range(8))
def test_free_stride_is_half_a_metre_along_the_heading(heading: int) -> None:
    pose = strided(Pose(0.0, 0.0, heading), [], CONFIG)
    assert pose.x_m == pytest.approx(0.5 * math.cos(heading * math.pi / 4), abs=1e-12)
    assert pose.y_m == pytest.approx(0.5 * math.sin(heading * math.pi / 4), abs=1e-12)
    assert pose.heading == heading


@pytest.mark.parametrize("heading", range(8))
def test_walls_stop_the_bumper_and_let_it_go(heading: int) -> None:
    pose = Pose(0.2, -0.1, heading)
    for _ in range(10):
        pose = strided(pose, [], CONFIG)
    limit_m = CONFIG.half_side_m - RADIUS_M
    assert max(abs(pose.x_m), abs(pose.y_m)) == pytest.approx(limit_m, abs=1e-12)
    assert free_way_m(pose, [], CONFIG) == pytest.approx(0.0, abs=1e-12)
    assert free_way_m(turned(pose, 4), [], CONFIG) == CONFIG.stride_m


def test_eight_turns_close_the_circle() -> None:
    pose = Pose(0.1, 0.2, 3)
    for _ in range(8):
        pose = turned(pose, 1)
    assert pose == Pose(0.1, 0.2, 3)


@pytest.mark.parametrize(
    ("distance_m", "angle_deg", "is_reached"),
    [
        (0.59, 0.0, True),
        (0.61, 0.0, False),
        (0.5, 29.9, True),
        (0.5, -29.9, True),
        (0.5, 30.1, False),
        (0.5, 180.0, False),
    ],
)
@pytest.mark.parametrize("heading", range(8))
def test_reach_needs_nearness_and_heading(
    distance_m: float, angle_deg: float, is_reached: bool, heading: int
) -> None:
    angle = heading * math.pi / 4 + math.radians(angle_deg)
    centre = (0.3 + distance_m * math.cos(angle), -0.2 + distance_m * math.sin(angle))
    cos, sin = HEADING_COS[heading], HEADING_SIN[heading]
    assert nearest_in_reach(0.3, -0.2, cos, sin, [centre], CONFIG) == (0 if is_reached else -1)


def test_the_nearest_of_several_objects_counts() -> None:
    centres = [(0.55, 0.0), (0.45, 0.05), (0.2, 0.4), (-0.3, 0.0)]
    assert nearest_in_reach(0.0, 0.0, 1.0, 0.0, centres, CONFIG) == 1
