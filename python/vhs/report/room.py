"""A room from above, as a drawing: objects, the way a robot took, a shortest way, its reach at the end."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from xml.sax.saxutils import escape

from vhs.envs.kinematics import Footprint
from vhs.report.svg import svg
from vhs.report.tracks import Track
from vhs.show.moments import Pose, object_title

_SIDE = 300.0
"""Width and height, in drawing units."""
_ARROW = ((12.0, 0.0), (-8.0, 7.5), (-4.0, 0.0), (-8.0, -7.5))
"""Corners of the robot, pointing along x."""

Point = tuple[float, float]


def top_view(track: Track) -> str:
    """Draw an episode; north is up, as in the world's frame."""
    scale = _SIDE / track.room.room_side_m
    poses = [moment.pose for moment in track.moments]
    parts = [f'<rect class="wall" x="1" y="1" width="{_SIDE - 2:g}" height="{_SIDE - 2:g}" rx="3"/>']
    parts += [
        _object(footprint, label, scale, is_goal=label == track.goal)
        for label, footprint in enumerate(track.footprints)
    ]
    if len(track.shortest) > 1:
        parts.append(f'<polyline class="shortest" points="{_points(track.shortest, scale)}"/>')
    parts.append(_reach(poses[-1], track, scale))
    way = [(pose.x_m, pose.y_m) for pose in poses]
    parts.append(f'<polyline class="way" points="{_points(way, scale)}"/>')
    parts += [_stay(place, count, scale) for place, count in _places(poses).items()]
    parts += [_arrow(poses[0], scale, "start"), _arrow(poses[-1], scale, "end")]
    return svg(_SIDE, _SIDE, f"episode {track.number} from above", "".join(parts), kind="room")


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
    name = _name(object_title(label), x, y, radius + (19 if is_goal else 14))
    return f'<g class="object{" goal" if is_goal else ""}" {colour}>{ring}{box}{name}</g>'


def _name(text: str, x: float, y: float, drop: float) -> str:
    """A name below an object, or where the walls leave room for it."""
    anchor = "start" if x < _SIDE / 4 else "end" if x > 3 * _SIDE / 4 else "middle"
    shift = {"start": -12, "end": 12, "middle": 0}[anchor]
    below = y + drop if y + drop < _SIDE - 5 else y - drop + 9
    return f'<text x="{x + shift:.1f}" y="{below:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _reach(pose: Pose, track: Track, scale: float) -> str:
    """The sector in which an object is in reach of a pose."""
    half, radius = math.radians(track.room.reach_half_angle_deg), track.room.reach_m
    angles = [pose.yaw_rad + half * step / 6 for step in range(-6, 7)]
    edge = [(pose.x_m + radius * math.cos(a), pose.y_m + radius * math.sin(a)) for a in angles]
    points = _points([(pose.x_m, pose.y_m), *edge], scale)
    return f'<polygon class="reach" points="{points}"/>'


def _places(poses: Sequence[Pose]) -> Counter[Point]:
    """Where the robot was, to a centimetre, and for how many moments."""
    return Counter((round(pose.x_m, 2), round(pose.y_m, 2)) for pose in poses)


def _stay(place: Point, count: int, scale: float) -> str:
    """A dot that is larger the longer the robot stayed."""
    x, y = _at(*place, scale)
    return f'<circle class="stay" cx="{x:.1f}" cy="{y:.1f}" r="{1.6 + 1.1 * math.sqrt(count):.1f}"/>'


def _arrow(pose: Pose, scale: float, kind: str) -> str:
    """Where the robot stood and looked."""
    x, y = _at(pose.x_m, pose.y_m, scale)
    cos, sin = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    corners = [(x + a * cos - b * sin, y - a * sin - b * cos) for a, b in _ARROW]
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in corners)
    return f'<polygon class="robot {kind}" points="{points}"/>'
