"""Where the objects go: rejection sampling of places and postures.

Owns the rules of a fair start. Every accepted layout keeps all objects out of reach of the robot at the
room's centre, inside the walls, and apart from each other by their true bounding circles and by a minimum
separation. Draws only from the generator that it is given.
"""

from __future__ import annotations

import math

import numpy as np

from vhs.envs.config import OBJECT_NAMES, RoomConfig
from vhs.envs.kinematics import Footprint
from vhs.envs.scene import ObjectPose, RoomModel

_MAX_DRAWS = 10_000
"""Draws before the room is called too small; a layout of the default room takes about 20."""
_DRAWS_BEFORE_RESTART = 60
"""A first few objects can leave no place for the rest: start over instead of insisting."""


class PlacementError(RuntimeError):
    """The objects do not fit the room."""


def sample_layout(room: RoomModel, config: RoomConfig, rng: np.random.Generator) -> tuple[ObjectPose, ...]:
    """Draw poses for all objects.

    Args:
        room: sizes of the objects.
        config: the rules.
        rng: the only source of randomness.

    Returns:
        One pose per object, in order of the class labels.

    Raises:
        PlacementError: no layout was found; the objects are too large for the room.
    """
    poses: list[ObjectPose] = []
    footprints: list[Footprint] = []
    start_m = config.reach_m + config.start_clearance_m
    draws_here = 0
    for _ in range(_MAX_DRAWS):
        x, y, yaw, posture = rng.random(4).tolist()
        label = len(poses)
        pose = ObjectPose(
            (2 * x - 1) * config.half_side_m, (2 * y - 1) * config.half_side_m, math.tau * yaw, posture < 0.5
        )
        footprint = room.footprint(label, pose)
        draws_here += 1
        if _is_free(footprint, footprints, start_m, config):
            poses.append(pose)
            footprints.append(footprint)
            if len(poses) == len(OBJECT_NAMES):
                return tuple(poses)
        elif draws_here > _DRAWS_BEFORE_RESTART:
            poses.clear()
            footprints.clear()
            draws_here = 0
    raise PlacementError(
        f"expected a layout of {len(OBJECT_NAMES)} objects in a {config.room_side_m} m room within "
        f"{_MAX_DRAWS} draws, found none: enlarge room_side_m, or lower object_scale or separation_m"
    )


def _is_free(new: Footprint, placed: list[Footprint], start_m: float, config: RoomConfig) -> bool:
    """Whether an object may stand here beside those already placed."""
    limit_m = config.half_side_m - new.radius_m - config.object_gap_m
    if abs(new.x_m) > limit_m or abs(new.y_m) > limit_m:
        return False
    # Two rules for the start: out of reach, and clear of the bumper whatever the object's size.
    clear_m = max(start_m, config.bumper_radius_m + new.radius_m + config.object_gap_m)
    if math.hypot(new.x_m, new.y_m) < clear_m:
        return False
    return all(
        math.hypot(new.x_m - other.x_m, new.y_m - other.y_m)
        >= max(config.separation_m, new.radius_m + other.radius_m + config.object_gap_m)
        for other in placed
    )
