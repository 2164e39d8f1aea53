"""Charts of how evaluation episodes ended that need nothing of a task but its goals."""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from vhs import Outcome
from vhs.report.page import legend
from vhs.report.svg import LETTER_PX, Axes, Frame, Line, svg
from vhs.report.tracks import Track

_WIDTH = 460
_ROW_PX = 28
_MOST_ROWS = 24
"""Goals that are shown of a task with many: those that succeed least."""
_BINS = 20


def colour_of(outcome: Outcome) -> str:
    """Of the style sheet."""
    return f"var(--{outcome.name.lower()})"


def outcome_legend() -> str:
    """The colours of the three outcomes."""
    return legend([(outcome.name.lower(), colour_of(outcome)) for outcome in Outcome])


def outcomes_by_goal(tracks: Sequence[Track], names: Sequence[str]) -> str:
    """A bar a goal class that was asked for, as wide as its shares of success, failure and timeout."""
    rows = [(name, [t.outcome for t in tracks if t.goal == label]) for label, name in enumerate(names)]
    asked = [(name, ends) for name, ends in rows if ends]
    asked.sort(key=lambda row: row[1].count(Outcome.SUCCESS) / len(row[1]))
    shown = asked[:_MOST_ROWS]
    longest = max(len(name) for name, _ in shown)
    left, right = min(24 + LETTER_PX * longest, _WIDTH / 2), _WIDTH - 62.0
    parts = []
    for row, (name, ends) in enumerate(shown):
        y, x = 6.0 + _ROW_PX * row, left
        parts.append(f'<text x="{left - 10:.1f}" y="{y + 15:g}" text-anchor="end">{escape(name)}</text>')
        for outcome in Outcome:
            count = ends.count(outcome)
            width = (right - left) * count / len(ends)
            tip = quoteattr(f"{name}: {count} of {len(ends)} {outcome.name.lower()}")
            place = f'x="{x:.1f}" y="{y:g}" width="{width:.1f}" height="{_ROW_PX - 8}"'
            parts.append(f'<rect class="bar" {place} style="fill:{colour_of(outcome)}" data-tip={tip}/>')
            x += width
        share = ends.count(Outcome.SUCCESS) / len(ends)
        parts.append(f'<text class="tick" x="{right + 8:.1f}" y="{y + 15:g}">{share:.0%}</text>')
    more = len(asked) - len(shown)
    note = f'<p class="note">{more} more goals succeed more often.</p>' if more else ""
    height = 12.0 + _ROW_PX * len(shown)
    return outcome_legend() + svg(_WIDTH, height, "outcomes by goal", "".join(parts)) + note


def step_counts(tracks: Sequence[Track]) -> str:
    """How many episodes took how many steps, by outcome."""
    steps = np.array([track.steps for track in tracks])
    width = max(1, -(-int(steps.max()) // _BINS))
    edges = np.arange(1, int(steps.max()) + width + 1, width)
    counts = {
        outcome: np.histogram(steps[[t.outcome is outcome for t in tracks]], edges)[0] for outcome in Outcome
    }
    tallest = float(np.sum(list(counts.values()), axis=0).max())
    end = float(edges[-1])
    axes = Axes("episodes by the steps they took", x_label="steps; upwards: episodes")
    frame = Frame(axes, [Line("", "", np.array([0.0, end]), np.array([0.0, tallest]))])
    parts = [frame.grid()]
    for column, first in enumerate(edges[:-1].tolist()):
        below = 0.0
        said = f"{first} steps" if width == 1 else f"{first} to {first + width - 1} steps"
        for outcome in Outcome:
            count = int(counts[outcome][column])
            if not count:
                continue
            x, y = frame.x(first), frame.y(below + count)
            size = f'width="{frame.x(first + width) - x - 1:.1f}" height="{frame.y(below) - y:.1f}"'
            tip = quoteattr(f"{said}: {count} {outcome.name.lower()}")
            parts.append(
                f'<rect class="bar" x="{x:.1f}" y="{y:.1f}" {size} style="fill:{colour_of(outcome)}" '
                f"data-tip={tip}/>"
            )
            below += count
    return outcome_legend() + svg(axes.width, axes.height, axes.title, "".join(parts))
