"""Plane geometry of the room: poses, footprints, reach, and how far a stride gets.

Pure functions of plain floats (metres, radians), shared by the environment and the oracle so that the plan
and the world cannot disagree. World frame: origin at the room's centre, x to the right, y ahead, yaw counter-
clockwise from x.

A robot's *commanded pose* lives on a lattice: its heading is one of eight indices, never an integrated angle,
so no heading error can build up over an episode.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from vhs.envs.config import HEADINGS, RoomConfig

# Exact to the last bit at the axes, where math.cos(pi / 2) is 6e-17 and would bend a straight wall contact.
_DIAGONAL = math.sqrt(0.5)
HEADING_COS = (1.0, _DIAGONAL, 0.0, -_DIAGONAL, -1.0, -_DIAGONAL, 0.0, _DIAGONAL)
HEADING_SIN = (0.0, _DIAGONAL, 1.0, _DIAGONAL, 0.0, -_DIAGONAL, -1.0, -_DIAGONAL)
HEADING_RAD = math.tau / HEADINGS

_TOUCHING_M = 1e-6
"""Closer than this counts as touching: far above rounding, far below the bumper's clearance."""


class Pose(NamedTuple):
    """Commanded pose of the base."""

    x_m: float
    y_m: float
    heading: int
    """Index in 0..8 of the heading, in turns of 45 degrees counter-clockwise from x."""


class MeasuredPose(NamedTuple):
    """Where the simulation has the base, which the commanded pose is a lattice point beside."""

    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class Footprint:
    """Outline of one object on the floor: an oriented rectangle around its centre."""

    x_m: float
    y_m: float
    yaw_rad: float
    half_length_m: float
    """Half extent along the object's own x axis after yaw."""
    half_width_m: float
    """Half extent along the object's own y axis after yaw."""

    @property
    def radius_m(self) -> float:
        """Radius of the circle around the rectangle."""
        return math.hypot(self.half_length_m, self.half_width_m)


def turned(pose: Pose, steps: int) -> Pose:
    """The pose after `steps` turns of 45 degrees, positive to the left."""
    return Pose(pose.x_m, pose.y_m, (pose.heading + steps) % HEADINGS)


def strided(pose: Pose, footprints: Sequence[Footprint], config: RoomConfig) -> Pose:
    """The pose after one stride that ends where the bumper first touches a wall or an object."""
    way_m = free_way_m(pose, footprints, config)
    return Pose(
        pose.x_m + way_m * HEADING_COS[pose.heading],
        pose.y_m + way_m * HEADING_SIN[pose.heading],
        pose.heading,
    )


def free_way_m(pose: Pose, footprints: Sequence[Footprint], config: RoomConfig) -> float:
    """How far the bumper can move along the heading, at most one stride, in metres."""
    radius_m = config.bumper_radius_m + config.bumper_clearance_m
    cos, sin = HEADING_COS[pose.heading], HEADING_SIN[pose.heading]
    way_m = config.stride_m
    limit_m = config.half_side_m - radius_m
    for position, direction in ((pose.x_m, cos), (pose.y_m, sin)):
        if direction != 0.0:
            # Distance to the wall ahead on this axis; never negative: a touching robot stands still.
            way_m = min(
                way_m, max(0.0, (limit_m - math.copysign(1.0, direction) * position) / abs(direction))
            )
    for footprint in footprints:
        near_m = way_m + radius_m + footprint.radius_m
        dx, dy = footprint.x_m - pose.x_m, footprint.y_m - pose.y_m
        if dx * dx + dy * dy <= near_m * near_m:
            way_m = min(way_m, way_to_touch_m(pose.x_m, pose.y_m, cos, sin, footprint, radius_m))
    return way_m


def way_to_touch_m(
    x_m: float, y_m: float, cos: float, sin: float, footprint: Footprint, radius_m: float
) -> float:
    """Way of a disc along a unit direction until it touches a rectangle; infinity if it never does.

    The disc's centre moves as a point against the rectangle grown by the radius: two boxes and four corner
    discs.

    Args:
        x_m: disc centre.
        y_m: disc centre.
        cos: direction, x.
        sin: direction, y.
        footprint: the rectangle.
        radius_m: the disc's radius.
    """
    c, s = math.cos(footprint.yaw_rad), math.sin(footprint.yaw_rad)
    dx, dy = x_m - footprint.x_m, y_m - footprint.y_m
    px, py = c * dx + s * dy, c * dy - s * dx
    ux, uy = c * cos + s * sin, c * sin - s * cos
    hx, hy = footprint.half_length_m, footprint.half_width_m
    # Vector from the nearest point of the rectangle to the disc's centre.
    ox, oy = px - min(max(px, -hx), hx), py - min(max(py, -hy), hy)
    if ox * ox + oy * oy <= (radius_m + _TOUCHING_M) ** 2:
        # Touching already. The grown rectangle is convex: whoever moves outwards never meets it again.
        return 0.0 if ox * ux + oy * uy < -1e-9 else math.inf
    way_m = min(
        _way_to_box_m(px, py, ux, uy, hx + radius_m, hy), _way_to_box_m(px, py, ux, uy, hx, hy + radius_m)
    )
    for corner_x in (-hx, hx):
        for corner_y in (-hy, hy):
            way_m = min(way_m, _way_to_disc_m(px - corner_x, py - corner_y, ux, uy, radius_m))
    return way_m


def _way_to_box_m(px: float, py: float, ux: float, uy: float, hx: float, hy: float) -> float:
    """Way of a point outside an axis-aligned box until it enters it; infinity if it never does."""
    enter_m, leave_m = 0.0, math.inf
    for position, direction, half in ((px, ux, hx), (py, uy, hy)):
        if abs(direction) < 1e-12:
            if abs(position) >= half:
                return math.inf
            continue
        near_m, far_m = (-half - position) / direction, (half - position) / direction
        enter_m, leave_m = max(enter_m, min(near_m, far_m)), min(leave_m, max(near_m, far_m))
    return enter_m if enter_m < leave_m else math.inf


def _way_to_disc_m(px: float, py: float, ux: float, uy: float, radius_m: float) -> float:
    """Way of a point outside a disc around the origin until it enters it; infinity if it never does."""
    along_m = -(px * ux + py * uy)
    discriminant = radius_m * radius_m - (px * px + py * py - along_m * along_m)
    if along_m <= 0.0 or discriminant <= 0.0:
        return math.inf
    return along_m - math.sqrt(discriminant)


def nearest_in_reach(
    x_m: float, y_m: float, cos: float, sin: float, centres: Sequence[tuple[float, float]], config: RoomConfig
) -> int:
    """Index of the nearest object within reach and near enough to the heading; -1 if there is none.

    Args:
        x_m: robot centre.
        y_m: robot centre.
        cos: heading, x.
        sin: heading, y.
        centres: objects' centres in the plane, in order of their class labels.
        config: reach and its half angle.
    """
    found, found_m = -1, config.reach_m
    cos_limit = math.cos(math.radians(config.reach_half_angle_deg))
    for label, (object_x_m, object_y_m) in enumerate(centres):
        dx, dy = object_x_m - x_m, object_y_m - y_m
        distance_m = math.hypot(dx, dy)
        if distance_m <= found_m and dx * cos + dy * sin >= cos_limit * distance_m:
            found, found_m = label, distance_m
    return found
