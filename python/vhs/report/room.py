"""A room from above, as a drawing: objects, the way a robot took, a shortest way, its reach at the end."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import escape

import gymnasium

from vhs.envs import OBJECT_NAMES, RoomConfig, RoomEnv, plan
from vhs.envs.config import FIRST_INTERACTION, MOVE_FORWARD, TURN_LEFT
from vhs.envs.kinematics import Footprint, MeasuredPose, strided, turned
from vhs.envs.oracle import NoPlanError
from vhs.report.svg import svg

_SIDE = 300.0
"""Width and height, in drawing units."""
_ARROW = ((12.0, 0.0), (-8.0, 7.5), (-4.0, 0.0), (-8.0, -7.5))
"""Corners of the robot, pointing along x."""

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class RoomWay:
    """What is drawn of an episode in a room, in metres of the world's frame."""

    goal: int
    """Label of the instructed object."""
    poses: Sequence[MeasuredPose]
    """Of the robot, at every moment."""
    footprints: tuple[Footprint, ...]
    """Outlines of the objects, in order of labels."""
    shortest: tuple[Point, ...]
    """Places on a shortest way, the start included; empty where there is none."""
    config: RoomConfig


class RoomWatch:
    """Follows one episode in a room, by its true state."""

    def __init__(self, room: RoomEnv) -> None:
        """Begin at the first moment of an episode."""
        self._room = room
        self._poses: list[MeasuredPose] = []
        world = room.world
        self.way = RoomWay(room.goal, self._poses, world.footprints, _shortest(room), room.config)
        self.look()

    @classmethod
    def of(cls, env: gymnasium.Env[Any, Any]) -> RoomWatch | None:
        """A watch over a room under its wrappers; None over any other environment."""
        return cls(env.unwrapped) if isinstance(env.unwrapped, RoomEnv) else None

    def look(self) -> None:
        """Take down where the robot is now."""
        self._poses.append(self._room.world.measured_pose)


def top_view(way: RoomWay, title: str) -> str:
    """Draw an episode; north is up, as in the world's frame."""
    scale = _SIDE / way.config.room_side_m
    parts = [f'<rect class="wall" x="1" y="1" width="{_SIDE - 2:g}" height="{_SIDE - 2:g}" rx="3"/>']
    parts += [
        _object(footprint, label, scale, is_goal=label == way.goal)
        for label, footprint in enumerate(way.footprints)
    ]
    if len(way.shortest) > 1:
        parts.append(f'<polyline class="shortest" points="{_points(way.shortest, scale)}"/>')
    parts.append(_reach(way.poses[-1], way.config, scale))
    places = [(pose.x_m, pose.y_m) for pose in way.poses]
    parts.append(f'<polyline class="way" points="{_points(places, scale)}"/>')
    parts += [_stay(place, count, scale) for place, count in _places(way.poses).items()]
    parts += [_arrow(way.poses[0], scale, "start"), _arrow(way.poses[-1], scale, "end")]
    return svg(_SIDE, _SIDE, title, "".join(parts), kind="room")


def _shortest(room: RoomEnv) -> tuple[Point, ...]:
    try:
        actions = plan(room)
    except NoPlanError:
        return ()
    pose, places = room.world.start_pose, [room.world.start_pose[:2]]
    for action in actions:
        if action == MOVE_FORWARD:
            pose = strided(pose, room.world.footprints, room.config)
            places.append(pose[:2])
        elif action < FIRST_INTERACTION:
            pose = turned(pose, 1 if action == TURN_LEFT else -1)
    return tuple(places)


def _at(x_m: float, y_m: float, scale: float) -> Point:
    """World to drawing: y ahead is up."""
    return _SIDE / 2 + x_m * scale, _SIDE / 2 - y_m * scale


def _points(places_m: Iterable[Point], scale: float) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in (_at(*place, scale) for place in places_m))


def _object(footprint: Footprint, label: int, scale: float, *, is_goal: bool) -> str:
    x, y = _at(footprint.x_m, footprint.y_m, scale)
    width, height = 2 * footprint.half_length_m * scale, 2 * footprint.half_width_m * scale
    colour = f'style="--object:var(--o{label})"'
    turn = f"rotate({-math.degrees(footprint.yaw_rad):.1f} {x:.1f} {y:.1f})"
    box = (
        f'<rect x="{x - width / 2:.1f}" y="{y - height / 2:.1f}" width="{width:.1f}" height="{height:.1f}" '
        f'rx="3" transform="{turn}"/>'
    )
    radius = footprint.radius_m * scale
    ring = f'<circle class="ring" cx="{x:.1f}" cy="{y:.1f}" r="{radius + 6:.1f}"/>' if is_goal else ""
    name = _name(OBJECT_NAMES[label].replace("_", " "), x, y, radius + (19 if is_goal else 14))
    return f'<g class="object{" goal" if is_goal else ""}" {colour}>{ring}{box}{name}</g>'


def _name(text: str, x: float, y: float, drop: float) -> str:
    """A name below an object, or where the walls leave room for it."""
    anchor = "start" if x < _SIDE / 4 else "end" if x > 3 * _SIDE / 4 else "middle"
    shift = {"start": -12, "end": 12, "middle": 0}[anchor]
    below = y + drop if y + drop < _SIDE - 5 else y - drop + 9
    return f'<text x="{x + shift:.1f}" y="{below:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _reach(pose: MeasuredPose, room: RoomConfig, scale: float) -> str:
    """The sector in which an object is in reach of a pose."""
    half, radius = math.radians(room.reach_half_angle_deg), room.reach_m
    angles = [pose.yaw_rad + half * step / 6 for step in range(-6, 7)]
    edge = [(pose.x_m + radius * math.cos(a), pose.y_m + radius * math.sin(a)) for a in angles]
    points = _points([(pose.x_m, pose.y_m), *edge], scale)
    return f'<polygon class="reach" points="{points}"/>'


def _places(poses: Sequence[MeasuredPose]) -> Counter[Point]:
    """Where the robot was, to a centimetre, and for how many moments."""
    return Counter((round(pose.x_m, 2), round(pose.y_m, 2)) for pose in poses)


def _stay(place: Point, count: int, scale: float) -> str:
    """A dot that is larger the longer the robot stayed."""
    x, y = _at(*place, scale)
    return f'<circle class="stay" cx="{x:.1f}" cy="{y:.1f}" r="{1.6 + 1.1 * math.sqrt(count):.1f}"/>'


def _arrow(pose: MeasuredPose, scale: float, kind: str) -> str:
    """Where the robot stood and looked."""
    x, y = _at(pose.x_m, pose.y_m, scale)
    cos, sin = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    corners = [(x + a * cos - b * sin, y - a * sin - b * cos) for a, b in _ARROW]
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in corners)
    return f'<polygon class="robot {kind}" points="{points}"/>'
