"""Sections about evaluation: who was reached instead of whom, and ways through the room beside what was seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from xml.sax.saxutils import escape

from vhs.envs import OBJECT_NAMES
from vhs.envs.kinematics import Footprint
from vhs.play.episode import Pose, object_title
from vhs.report.page import Section, card, figure, missing
from vhs.report.svg import svg
from vhs.report.tracks import Track, confusion, pick

_SIDE = 300.0
"""Width and height of a room from above, in drawing units."""


def confusion_section(tracks: Sequence[Track], why: str) -> Section:
    """A table of asked against reached object."""
    title = "Asked and reached"
    if not tracks:
        return Section("confusion", title, missing(why))
    counts = confusion(tracks)
    names = [*(object_title(label) for label in range(len(OBJECT_NAMES))), "none"]
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    body = "".join(f"<tr><th>{escape(names[row])}</th>{_cells(counts[row].tolist())}</tr>" for row in range(len(counts)))
    matrix = (
        f'<div class="scroll"><table class="matrix"><thead><tr><th>asked \\ reached</th>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )
    wrong = sum(t.moments[-1].reached == t.goal and t.outcome.name == "FAILURE" for t in tracks)
    note = f"{len(tracks)} episodes, actions sampled. None: the time ran out."
    if wrong:
        note += f" In {wrong} the right object got the wrong interaction."
    body = f'<div class="grid">{card("Episodes by object", matrix, note)}</div>'
    return Section("confusion", title, body, "Rooms that training never saw. The agent itself never learns what it reached.")


def episode_section(tracks: Sequence[Track], why: str) -> Section:
    """Episodes from above beside their film strips."""
    title = "Episodes"
    if not tracks:
        return Section("episodes", title, missing(why))
    lead = (
        "The first two of each outcome. Solid: the way the robot took, an arrow a pose; dashed: a shortest way; wedge: its "
        "reach at the end; ring: the goal. Beside it what the robot saw, and what it then did with what value."
    )
    return Section("episodes", title, "".join(_episode(track) for track in pick(tracks)), lead)


def top_view(track: Track) -> str:
    """The room from above: objects, way, shortest way, reach at the end."""
    scale = _SIDE / track.room.room_side_m
    parts = [f'<rect x="1" y="1" width="{_SIDE - 2}" height="{_SIDE - 2}" rx="3" style="fill:var(--ground);stroke:var(--mark)"/>']
    parts += [_object(footprint, label, label == track.goal, scale) for label, footprint in enumerate(track.footprints)]
    if len(track.shortest) > 1:
        points = " ".join("{:.1f},{:.1f}".format(*_at(x, y, scale)) for x, y in track.shortest)
        parts.append(f'<polyline points="{points}" style="fill:none;stroke:var(--mark);stroke-width:1.6;stroke-dasharray:5 4"/>')
    poses = [moment.pose for moment in track.moments]
    parts.append(_reach(poses[-1], track, scale))
    points = " ".join("{:.1f},{:.1f}".format(*_at(pose.x_m, pose.y_m, scale)) for pose in poses)
    parts.append(f'<polyline points="{points}" style="fill:none;stroke:var(--ink);stroke-width:2;stroke-linejoin:round"/>')
    parts += [_arrow(pose, scale, index, len(poses)) for index, pose in enumerate(poses)]
    return svg(_SIDE, _SIDE, f"episode {track.number} from above", "".join(parts), kind="room")


def _episode(track: Track) -> str:
    end = track.moments[-1]
    outcome = track.outcome.name.lower()
    reached = "" if end.reached < 0 or end.reached == track.goal else f", {object_title(end.reached)} reached"
    best = "" if track.optimal_steps is None else f", shortest {track.optimal_steps}"
    steps = f"{track.steps} step{'' if track.steps == 1 else 's'}{best}"
    title = (
        f'<h3>“{escape(end.instruction)}” — <span class="badge">{outcome}</span>{escape(reached)} '
        f'<span class="note">· episode {track.number}, {steps}</span></h3>'
    )
    strip = "".join(
        figure(moment.view, f"{moment.action} {moment.value:+.2f}") if moment.action is not None
        else figure(moment.view, outcome, "end")
        for moment in track.moments
    )  # fmt: skip
    return (
        f'<div class="card" style="--here:var(--{outcome});margin-top:14px">{title}<div class="episode">'
        f'<div>{top_view(track)}</div><div class="row">{strip}</div></div></div>'
    )


def _cells(counts: Sequence[int]) -> str:
    """A row of the table, darker where more of its episodes ended."""
    total = max(sum(counts), 1)
    return "".join(
        f'<td style="background:rgba(var(--cell),{0.75 * count / total:.2f})">{count if count else "·"}</td>'
        for count in counts
    )


def _at(x_m: float, y_m: float, scale: float) -> tuple[float, float]:
    """World to drawing: y ahead is up."""
    return _SIDE / 2 + x_m * scale, _SIDE / 2 - y_m * scale


def _object(footprint: Footprint, label: int, is_goal: bool, scale: float) -> str:
    x, y = _at(footprint.x_m, footprint.y_m, scale)
    width, height = 2 * footprint.half_length_m * scale, 2 * footprint.half_width_m * scale
    ring = ""
    if is_goal:
        ring = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{footprint.radius_m * scale + 6:.1f}" style="fill:none;stroke:var(--o{label});stroke-width:2.5"/>'
    # Names go to the side where there is room for them.
    anchor = "start" if x < _SIDE / 4 else "end" if x > 3 * _SIDE / 4 else "middle"
    shift = {"start": -12, "end": 12, "middle": 0}[anchor]
    drop = footprint.radius_m * scale + (19 if is_goal else 14)
    below = y + drop if y + drop < _SIDE - 5 else y - drop + 9
    weight = ";font-weight:700" if is_goal else ""
    return (
        f'{ring}<rect x="{x - width / 2:.1f}" y="{y - height / 2:.1f}" width="{width:.1f}" height="{height:.1f}" rx="3" '
        f'transform="rotate({-math.degrees(footprint.yaw_rad):.1f} {x:.1f} {y:.1f})" style="fill:var(--o{label})"/>'
        f'<text x="{x + shift:.1f}" y="{below:.1f}" text-anchor="{anchor}" style="font-size:12px;fill:var(--o{label}){weight}">'
        f"{escape(object_title(label))}</text>"
    )


def _reach(pose: Pose, track: Track, scale: float) -> str:
    """The sector in which an object is in reach of the last pose."""
    half, radius = math.radians(track.room.reach_half_angle_deg), track.room.reach_m
    x, y = _at(pose.x_m, pose.y_m, scale)
    angles = [pose.yaw_rad + half * step / 6 for step in range(-6, 7)]
    edge = [_at(pose.x_m + radius * math.cos(a), pose.y_m + radius * math.sin(a), scale) for a in angles]
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in [(x, y), *edge])
    colour = f"var(--{track.outcome.name.lower()})"
    return f'<polygon points="{points}" style="fill:{colour};fill-opacity:.22;stroke:{colour};stroke-opacity:.6"/>'


def _arrow(pose: Pose, scale: float, index: int, count: int) -> str:
    """Where the robot looked; the first pose is open, the last one filled and larger."""
    x, y = _at(pose.x_m, pose.y_m, scale)
    size = 9.0 if index in (0, count - 1) else 5.5
    corners = [(size, 0.0), (-0.7 * size, 0.62 * size), (-0.35 * size, 0.0), (-0.7 * size, -0.62 * size)]
    cos, sin = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    points = " ".join(f"{x + a * cos - b * sin:.1f},{y - a * sin - b * cos:.1f}" for a, b in corners)
    fill = "var(--paper)" if index == 0 else "var(--ink)"
    return f'<polygon points="{points}" style="fill:{fill};stroke:var(--ink);stroke-width:1.2"/>'
