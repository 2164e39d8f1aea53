"""Sections about evaluation episodes: what was reached instead of what, how many steps, and a few in full."""

from __future__ import annotations

import math
from collections.abc import Sequence
from xml.sax.saxutils import escape

import numpy as np

from vhs import Outcome
from vhs.report.outcomes import colour_of, outcome_legend, outcomes_by_goal, step_counts
from vhs.report.page import Section, card, figure, missing, shaded
from vhs.report.room import top_view
from vhs.report.svg import Axes, Frame, Line, svg
from vhs.report.tracks import Track, confusion, pick
from vhs.show.moments import Moment

_LEAD = "The first two of each outcome: what the agent saw, what it then did, and the value it expected."
_ROOM_LEAD = (
    "The first two of each outcome. From above: the way the robot took, from the open to the filled arrow, "
    "larger dots where it stayed longer; dashed, a shortest way; the wedge, its reach at the end; the ring, "
    "its goal. Beside it: what it saw, what it then did, and the value it expected."
)


def confusion_section(tracks: Sequence[Track], names: Sequence[str], why: str) -> Section:
    """How episodes ended by the goal that was asked for; what else the task says of them."""
    title = "Asked and reached"
    if not tracks:
        return Section("confusion", title, missing(why))
    note = f"{len(tracks)} episodes, actions sampled."
    cards = card("Outcomes by goal", outcomes_by_goal(tracks, names), note) if names else ""
    if any(track.moments[-1].reached is not None for track in tracks):
        wrong = sum(t.moments[-1].reached == t.goal and t.outcome is Outcome.FAILURE for t in tracks)
        reached_note = "A row a goal that was asked for. None: the time ran out."
        if wrong:
            reached_note += f" In {wrong} the right goal got the wrong interaction."
        cards += card("Reached instead", _matrix(tracks, names), reached_note)
    if any(track.optimal_steps is not None for track in tracks):
        steps_note = "One dot an episode; on the dotted line no way is shorter."
        cards += card("Steps taken and steps needed", _steps(tracks), steps_note)
    else:
        cards += card("Steps that episodes took", step_counts(tracks), "" if names else note)
    lead = "Episodes that training never saw."
    if any(track.moments[-1].reached is not None for track in tracks):
        lead += " The agent itself never learns what it reached."
    return Section("confusion", title, f'<div class="grid">{cards}</div>', lead)


def episode_section(tracks: Sequence[Track], names: Sequence[str], why: str) -> Section:
    """Episodes from above beside their film strips."""
    if not tracks:
        return Section("episodes", "Episodes", missing(why))
    absent = [o.name.lower() for o in Outcome if all(track.outcome is not o for track in tracks)]
    none = f" None of {len(tracks)} episodes ended in {' or '.join(absent)}." if absent else ""
    body = "".join(_episode(track, names) for track in pick(tracks))
    lead = _LEAD if all(track.way is None for track in tracks) else _ROOM_LEAD
    return Section("episodes", "Episodes", body, lead + none)


def _matrix(tracks: Sequence[Track], names: Sequence[str]) -> str:
    """Counts, each row darker where more of its episodes ended."""
    counts = confusion(tracks, len(names))
    head = "".join(f"<th>{escape(name)}</th>" for name in [*names, "none"])
    rows = []
    for name, row in zip(names, counts.tolist(), strict=True):
        total, ends = max(sum(row), 1), zip([*names, "nothing"], row, strict=True)
        cells = "".join(
            shaded(
                str(count) if count else "·",
                count / total,
                f"asked {name}, reached {end}: {count} of {total}",
            )
            for end, count in ends
        )
        rows.append(f"<tr><th>{escape(name)}</th>{cells}</tr>")
    corner = "<th>asked \\ reached</th>"
    return (
        f'<div class="scroll"><table class="matrix"><thead><tr>{corner}{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _steps(tracks: Sequence[Track]) -> str:
    """Steps of each episode over the length of its shortest way."""
    points = [(t.optimal_steps, t.steps, t.outcome) for t in tracks if t.optimal_steps is not None]
    end = max(x for x, *_ in points) + 1
    corner = np.array([0.0, end])
    axes = Axes("steps taken over the shortest way", x_label="steps of a shortest way; upwards: steps taken")
    top = np.array([0.0, max(y for _, y, _ in points)])
    frame = Frame(axes, [Line("", "", corner, corner), Line("", "", corner, top)])
    line = " ".join(f"{frame.x(value):.1f},{frame.y(value):.1f}" for value in (0, end))
    parts = [frame.grid(), f'<polyline class="mark" points="{line}"/>']
    for row, (x, y, outcome) in enumerate(points):
        # Equal pairs would hide each other: they are moved apart, in the same way on every run.
        radius, angle = 6.5 * math.sqrt((row * 0.618) % 1.0), 2.4 * row
        a, b = frame.x(x) + radius * math.cos(angle), frame.y(y) + radius * math.sin(angle)
        parts.append(
            f'<circle class="dot" cx="{a:.1f}" cy="{b:.1f}" r="3.2" style="fill:{colour_of(outcome)}" '
            f'data-tip="{outcome.name.lower()}: {y} steps, shortest {x}"/>'
        )
    return outcome_legend() + svg(axes.width, axes.height, axes.title, "".join(parts))


def _episode(track: Track, names: Sequence[str]) -> str:
    end, outcome = track.moments[-1], track.outcome.name.lower()
    other = None if end.reached in (-1, track.goal) else end.reached  # None where the task does not say
    reached = "" if other is None else f", {names[other]} reached"
    best = "" if track.optimal_steps is None else f", shortest {track.optimal_steps}"
    told = f"episode {track.number}, {track.steps} step{'' if track.steps == 1 else 's'}{best}"
    title = (
        f'<h3>“{escape(end.instruction)}” — <span class="badge">{outcome}</span>{escape(reached)} '
        f'<span class="note">· {told}</span></h3>'
    )
    name = f"episode {track.number} from above"
    above = "" if track.way is None else f"<div>{top_view(track.way, name)}</div>"
    kind = "episode" if above else "strip"
    strip = "" if end.told is None else figure(end.told, "goal")
    strip += "".join(_frame(moment, outcome) for moment in track.moments)
    return (
        f'<div class="card" style="--here:{colour_of(track.outcome)};margin-top:14px">{title}'
        f'<div class="{kind}">{above}<div class="row">{strip}</div></div></div>'
    )


def _frame(moment: Moment, outcome: str) -> str:
    if moment.action is None or moment.value is None:
        return figure(moment.view, outcome, "end")
    return figure(moment.view, f"{moment.action} {moment.value:+.2f}")
