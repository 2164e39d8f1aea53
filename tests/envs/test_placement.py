from __future__ import annotations

import math
import time

import numpy as np
import pytest

from vhs.envs import OBJECT_NAMES, RoomConfig, RoomEnv
from vhs.envs.config import INTERACTIVE_OBJECT_NAV
from vhs.envs.placement import PlacementError

RESETS = 10_000


def test_ten_thousand_resets_never_overlap_and_never_start_in_reach(blind_room: RoomEnv) -> None:
    config = blind_room.config
    postures, headings, goals = [], [], []
    started_s = time.perf_counter()
    for seed in range(RESETS):
        observation, info = blind_room.reset(seed=seed)
        assert info == {}
        outlines = blind_room.world.footprints
        for i, one in enumerate(outlines):
            assert math.hypot(one.x_m, one.y_m) > config.reach_m
            assert max(abs(one.x_m), abs(one.y_m)) + one.radius_m < config.half_side_m
            for other in outlines[:i]:
                gap_m = math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) - one.radius_m - other.radius_m
                assert gap_m > 0.0
        assert blind_room.world.object_in_reach() == -1
        postures.append([pose.is_lying for pose in blind_room.world.object_poses])
        headings.append(blind_room.world.start_pose.heading)
        goals.append(observation["goal"])
    print(f"{RESETS} resets in {time.perf_counter() - started_s:.1f} s")
    # Every draw covers its range evenly: 5 standard deviations of a fair coin, die or octagon.
    assert abs(np.mean(postures) - 0.5) < 5 * 0.5 / math.sqrt(5 * RESETS)
    for draws, sides in ((headings, 8), (goals, 5)):
        share = np.bincount(draws, minlength=sides) / RESETS
        assert np.abs(share - 1 / sides).max() < 5 * math.sqrt(1 / sides / RESETS)


def test_footprints_are_the_true_outlines(blind_room: RoomEnv) -> None:
    world = blind_room.world
    for seed in range(20):
        blind_room.reset(seed=seed)
        for name, outline in zip(OBJECT_NAMES, world.footprints, strict=True):
            geom = world.model.geom(f"{name}_box").id
            signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
            corners = (
                world.data.geom_xpos[geom]
                + (signs * world.model.geom_size[geom]) @ world.data.geom_xmat[geom].reshape(3, 3).T
            )
            # Seen from above, the box's corners are the outline's, and it stands on the floor.
            c, s = math.cos(outline.yaw_rad), math.sin(outline.yaw_rad)
            local = (corners[:, :2] - (outline.x_m, outline.y_m)) @ np.array([[c, -s], [s, c]])
            assert np.abs(local[:, 0]).max() == pytest.approx(outline.half_length_m, abs=1e-5)
            assert np.abs(local[:, 1]).max() == pytest.approx(outline.half_width_m, abs=1e-5)
            assert corners[:, 2].min() == pytest.approx(0.0, abs=1e-5)


def test_objects_that_do_not_fit_are_refused() -> None:
    env = RoomEnv(INTERACTIVE_OBJECT_NAV, RoomConfig(separation_m=2.9), renderer="none")
    with pytest.raises(PlacementError, match=r"expected a layout of 5 objects in a 3\.0 m room"):
        env.reset(seed=0)
