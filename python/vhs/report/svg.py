"""Charts as SVG text: axes, lines with bands, shares that add up, scatter.

Colours are names of CSS variables of the page, so that one chart is legible on light and on dark paper. Texts
grow on narrow screens by the page's style sheet; margins leave room for that. Curves and marks carry their
numbers and words as attributes, which `hover.js` shows under the pointer. Every function returns well-formed
XML.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LETTER_PX = 9.6
"""Width of a letter at the largest size that the style sheet gives; to leave room for labels."""
_TICK_PX = 8.0
"""Width of a letter of a tick."""
_LINE_PX = 17


@dataclass(frozen=True, slots=True)
class Line:
    """One curve; all arrays have the shape [points]."""

    label: str
    colour: str
    """CSS, such as "var(--c0)"."""
    x: FloatArray
    y: FloatArray
    low: FloatArray | None = None
    """Lower edge of the band; with `high`."""
    high: FloatArray | None = None
    raw: FloatArray | None = None
    """Values before smoothing, drawn thin."""
    is_dashed: bool = False


@dataclass(frozen=True, slots=True)
class Axes:
    """What a chart says around its data."""

    title: str
    """For those who cannot see the chart."""
    x_label: str = "episodes"
    """Below the axis; where it is empty there is no room for it."""
    hovered: str = ""
    """What x is under the pointer, where `x_label` does not say it."""
    is_share: bool = False
    """Values are shares: the axis goes from 0 to 100 %."""
    width: int = 460
    height: int = 300
    has_labels: bool = True
    """Curves are named at their right end; a legend does it otherwise."""
    marks: tuple[tuple[str, float], ...] = ()
    """Horizontal reference lines: text and value."""


class Frame:
    """From data to pixels, and the axes around."""

    def __init__(self, axes: Axes, lines: Sequence[Line]) -> None:
        """Fit the data; at least one line has a point."""
        self.axes = axes
        self.named = lines if axes.has_labels and len(lines) > 1 else ()
        names = [line.label for line in self.named] + [text for text, _ in axes.marks]
        self.top = 12
        self.bottom = axes.height - (46 if axes.x_label else 26)
        self.right = axes.width - max([22.0, *(14 + LETTER_PX * len(name) for name in names)])
        self.x_max = max(float(line.x.max()) for line in lines)
        low, high = _range(axes, lines)
        self.ticks = nice_ticks(low, high)
        widest = max(len(self._tick(tick)) for tick in self.ticks)
        self.left = max(50.0, 10 + _TICK_PX * widest)
        self.low, self.high = (
            (0.0, 1.0) if axes.is_share else (min(low, self.ticks[0]), max(high, self.ticks[-1]))
        )

    def x(self, value: float) -> float:
        """Pixels from the left."""
        return self.left + (self.right - self.left) * value / max(self.x_max, 1e-9)

    def y(self, value: float) -> float:
        """Pixels from the top."""
        share = (value - self.low) / max(self.high - self.low, 1e-12)
        return self.bottom - (self.bottom - self.top) * share

    def grid(self) -> str:
        """Grid lines, tick labels and the name of the x axis."""
        parts = []
        for tick in self.ticks:
            y = self.y(tick)
            text = self._tick(tick)
            parts.append(
                f'<line class="grid" x1="{self.left}" x2="{self.right:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>'
            )
            parts.append(
                f'<text class="tick" x="{self.left - 7}" y="{y + 4:.1f}" text-anchor="end">{text}</text>'
            )
        for tick in nice_ticks(0, self.x_max, 4):
            x = self.x(tick)
            place = f'x="{x:.1f}" y="{self.bottom + 19}" text-anchor="middle"'
            parts.append(f'<text class="tick" {place}>{compact(tick)}</text>')
        if self.axes.x_label:
            place = f'x="{(self.left + self.right) / 2:.1f}" y="{self.bottom + 40}" text-anchor="middle"'
            parts.append(f'<text class="axis" {place}>{escape(self.axes.x_label)}</text>')
        return "".join(parts)

    def _tick(self, value: float) -> str:
        return f"{value:.0%}" if self.axes.is_share else compact(value)

    def chart(self, parts: Sequence[str]) -> str:
        """The drawing, with what `hover.js` needs to know of it."""
        axes = self.axes
        inside = f'data-inside="{self.top} {self.bottom}" data-x={quoteattr(axes.hovered or axes.x_label)}'
        return svg(axes.width, axes.height, axes.title, "".join(parts), about=inside)


def line_chart(axes: Axes, lines: Sequence[Line]) -> str:
    """Curves with bands, named at their right end."""
    frame = Frame(axes, lines)
    parts = [frame.grid()]
    for _, value in axes.marks:
        y = frame.y(value)
        parts.append(
            f'<line class="mark" x1="{frame.left}" x2="{frame.right:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>'
        )
    parts += [_band(frame, line) for line in lines]
    parts += [_curve(frame, line) for line in lines]
    parts.append(_end_labels(frame))
    return frame.chart(parts)


def stacked_chart(axes: Axes, lines: Sequence[Line]) -> str:
    """Shares that add up to 1, on top of each other; all lines have the same x."""
    frame = Frame(axes, lines)
    parts = []
    below = np.zeros_like(lines[0].y)
    for line in lines:
        above = below + line.y
        edge, back = _path(frame, line.x, above), _path(frame, line.x[::-1], below[::-1])
        style = f'style="--ink-of:{line.colour};fill:{line.colour}"'
        parts.append(f'<polygon class="area" {style} {_numbers(frame, line)} points="{edge} {back}"/>')
        below = above
    return frame.chart([*parts, frame.grid()])


def svg(width: float, height: float, title: str, content: str, kind: str = "chart", about: str = "") -> str:
    """A drawing that scales with the page; `about` are further attributes."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="{kind}" viewBox="0 0 {width:g} {height:g}" '
        f'role="img" aria-label={quoteattr(title)} {about}>{content}</svg>'
    )


def nice_ticks(low: float, high: float, count: int = 5) -> list[float]:
    """About `count` round numbers that cover low..high."""
    span = max(high - low, 1e-9)
    raw = span / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= raw * 0.999)
    first = math.floor(low / step + 1e-9)
    last = math.floor(high / step + 1e-9)
    return [round(step * index, 12) for index in range(first, last + 1)]


def compact(value: float) -> str:
    """A number for a tick: 120000 as 120k."""
    if value != 0 and abs(value) >= 1e6:
        return f"{value / 1e6:g}M"
    if abs(value) >= 1e4:
        return f"{value / 1e3:g}k"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _range(axes: Axes, lines: Sequence[Line]) -> tuple[float, float]:
    """Least and greatest value of anything drawn; 0 is part of it unless all is far from 0."""
    if axes.is_share:
        return 0.0, 1.0
    drawn = [a for line in lines for a in (line.y, line.low, line.high) if a is not None]
    low, high = float(min(a.min() for a in drawn)), float(max(a.max() for a in drawn))
    low = min(low, 0.0) if low > 0 and low < 0.7 * high else low
    return (low - 0.5, high + 0.5) if low == high else (low, high)


def _path(frame: Frame, x: FloatArray, y: FloatArray) -> str:
    y = np.clip(y, frame.low, frame.high)
    return " ".join(f"{frame.x(a):.1f},{frame.y(b):.1f}" for a, b in zip(x, y, strict=True))


def _band(frame: Frame, line: Line) -> str:
    if line.low is None or line.high is None:
        return ""
    there, back = _path(frame, line.x, line.high), _path(frame, line.x[::-1], line.low[::-1])
    return f'<polygon class="band" style="fill:{line.colour}" points="{there} {back}"/>'


def _curve(frame: Frame, line: Line) -> str:
    style = f'style="--ink-of:{line.colour};stroke:{line.colour}"'
    kind = "line dashed" if line.is_dashed else "line"
    thin = ""
    if line.raw is not None:
        thin = f'<polyline class="raw" {style} points="{_path(frame, line.x, line.raw)}"/>'
    path = _path(frame, line.x, line.y)
    return f'{thin}<polyline class="{kind}" {style} {_numbers(frame, line)} points="{path}"/>'


def _numbers(frame: Frame, line: Line) -> str:
    """The values of a line, for `hover.js`; its first points are where they are drawn."""
    xs, ys = (" ".join(f"{value:.6g}" for value in values) for values in (line.x, line.y))
    kind = "share" if frame.axes.is_share else "number"
    return f'data-label={quoteattr(line.label)} data-kind="{kind}" data-x="{xs}" data-y="{ys}"'


def _end_labels(frame: Frame) -> str:
    """Names beside the ends of curves and marks, moved apart where they would overlap."""
    named = [(frame.y(value), text, "mark-label", "") for text, value in frame.axes.marks]
    for line in frame.named:
        end = float(np.clip(line.y[-1], frame.low, frame.high))
        named.append((frame.y(end), line.label, "label", line.colour))
    named.sort()
    places = spread([place for place, *_ in named], _LINE_PX, frame.bottom)
    left = f"{frame.right + 8:.1f}"
    return "".join(
        f'<text class="{kind}" style="fill:{colour}" x="{left}" y="{y + 4:.1f}">{escape(text)}</text>'
        for y, (_, text, kind, colour) in zip(places, named, strict=True)
    )


def spread(places: Sequence[float], gap: float, limit: float) -> list[float]:
    """Move ascending places apart to at least `gap`, none beyond `limit`."""
    moved: list[float] = []
    for place in places:
        moved.append(place if not moved else max(place, moved[-1] + gap))
    for index in range(len(moved) - 1, -1, -1):
        limit_here = limit if index == len(moved) - 1 else moved[index + 1] - gap
        moved[index] = min(moved[index], limit_here)
    return moved
