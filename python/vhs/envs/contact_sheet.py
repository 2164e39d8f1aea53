"""One picture of what the room looks like, for people who change it.

    python -m vhs.envs.contact_sheet docs/images/room.png

Owns the layout of the sheet: the third-person view, the robot's view along the eight headings, and every
object at three distances, upright and lying. Same picture on every run with the same renderer.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vhs.envs.config import HEADINGS, INTERACTIVE_OBJECT_NAV, OBJECT_NAMES
from vhs.envs.kinematics import Pose
from vhs.envs.rendering import first_person_source
from vhs.envs.room import RoomEnv
from vhs.envs.scene import ObjectPose
from vhs.png import png_bytes

Image = NDArray[np.uint8]

DISTANCES_M = (0.5, 1.0, 2.0)
_SCALE = 2
"""Screen pixels a side for one pixel of an observation."""
_AWAY_M = 40.0
"""Where objects go that are not on show."""


def contact_sheet(seed: int = 1, renderer: str = "raster") -> Image:
    """Draw the sheet.

    Args:
        seed: the episode shown in the upper half.
        renderer: what draws the robot's views.

    Returns:
        Picture, uint8 [H, W, 3].
    """
    env = RoomEnv(INTERACTIVE_OBJECT_NAV, render_mode="rgb_array", renderer=renderer)
    env.reset(seed=seed)
    room = env.render()
    assert room is not None, "the environment was made with a render mode"
    poses = env.world.object_poses
    headings = []
    for heading in range(HEADINGS):
        env.arrange(Pose(0.0, 0.0, heading), poses)
        headings.append(_view(env))
    views = np.concatenate([np.concatenate(headings[i : i + 4], axis=1) for i in (0, 4)])
    objects = np.concatenate([_object_row(env, label) for label in range(len(OBJECT_NAMES))])
    return _side_by_side(np.concatenate([_fitted(room, views.shape[1]), views]), objects)


def main() -> None:
    """Write the sheet to a PNG file."""
    parser = argparse.ArgumentParser(description="Write a picture of the room, its views and its objects.")
    parser.add_argument("path", type=Path, help="PNG file to write")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--renderer", default="raster")
    arguments = parser.parse_args()
    arguments.path.parent.mkdir(parents=True, exist_ok=True)
    arguments.path.write_bytes(png_bytes(contact_sheet(arguments.seed, arguments.renderer)))


def _object_row(env: RoomEnv, label: int) -> Image:
    """One object, upright and lying, from near to far, each time seen from another side."""
    start = Pose(-0.7, -0.7, 1)
    tiles = []
    for number, (is_lying, distance_m) in enumerate(
        (lying, d) for lying in (False, True) for d in DISTANCES_M
    ):
        reach_m = distance_m * math.sqrt(0.5)
        shown = ObjectPose(start.x_m + reach_m, start.y_m + reach_m, 0.9 * number, is_lying)
        env.arrange(
            start,
            [
                shown if i == label else ObjectPose(_AWAY_M, _AWAY_M + i, 0.0, False)
                for i in range(len(OBJECT_NAMES))
            ],
        )
        tiles.append(_view(env))
    return np.concatenate(tiles, axis=1)


def _view(env: RoomEnv) -> Image:
    """The robot's present view, enlarged."""
    size_px = env.config.image_px
    image = np.empty((size_px, size_px, 3), np.uint8)
    first_person_source(env.renderer, env.world.model, size_px).render(env.world.data, image)
    return image.repeat(_SCALE, axis=0).repeat(_SCALE, axis=1)


def _fitted(picture: Image, width: int) -> Image:
    """A picture in the middle of a white strip of this width."""
    left = (width - picture.shape[1]) // 2
    strip = np.full((picture.shape[0], width, 3), 255, np.uint8)
    strip[:, left : left + picture.shape[1]] = picture
    return strip


def _side_by_side(left: Image, right: Image) -> Image:
    """Two pictures with a white gap, the shorter one filled up with white."""
    height = max(left.shape[0], right.shape[0])
    sheet = np.full((height, left.shape[1] + 8 + right.shape[1], 3), 255, np.uint8)
    sheet[: left.shape[0], : left.shape[1]] = left
    sheet[: right.shape[0], left.shape[1] + 8 :] = right
    return sheet


if __name__ == "__main__":
    main()
