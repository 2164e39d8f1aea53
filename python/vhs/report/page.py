"""The page: its sections, its style, and the small pieces of HTML that sections are made of.

Invariants: one file that refers to nothing outside itself; well-formed XML, so that a test can read it; whole
without its script, which only tells values under the pointer.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from vhs.png import png_bytes


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page."""

    anchor: str
    title: str
    body: str
    """HTML."""
    lead: str = ""
    """A sentence or two below the title, plain text."""


def page(
    title: str, subtitle: str, tiles: Sequence[tuple[str, str]], sections: Sequence[Section], foot: str
) -> str:
    """The whole document.

    Args:
        title: plain text.
        subtitle: plain text.
        tiles: numbers at the top: what they say, and what of.
        sections: in the order of the page.
        foot: plain text.
    """
    # Not escaped: HTML reads no entities in a style sheet, and this one holds neither < nor &.
    style, script = (
        files("vhs.report").joinpath(name).read_text(encoding="utf-8") for name in ("style.css", "hover.js")
    )
    links = "".join(f'<a href="#{s.anchor}">{escape(s.title)}</a>' for s in sections)
    shown = "".join(f'<div class="tile"><b>{escape(b)}</b><span>{escape(t)}</span></div>' for b, t in tiles)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8"/>
<meta name="viewport" content="width=device-width, initial-scale=1"/>
<meta name="color-scheme" content="light dark"/>
<link rel="icon" href="data:,"/>
<title>{escape(title)}</title>
<style>
{style}</style>
</head>
<body>
<header><div>
<h1>{escape(title)}</h1>
<p class="lead">{escape(subtitle)}</p>
<nav>{links}</nav>
</div></header>
<main>
<div class="tiles">{shown}</div>
{"".join(_section(section) for section in sections)}
<footer>{escape(foot)}</footer>
</main>
<script>//<![CDATA[
{script}//]]></script>
</body>
</html>
"""


def card(title: str, content: str, note: str) -> str:
    """A framed picture with a title and a note, both plain text."""
    below = f'<p class="note">{escape(note)}</p>' if note else ""
    return f'<div class="card"><h3>{escape(title)}</h3>{content}{below}</div>'


def missing(why: str) -> str:
    """In place of a part that cannot be shown."""
    return f'<p class="missing">Not shown: {escape(why)}.</p>'


def legend(names: Sequence[tuple[str, str]]) -> str:
    """Names with the colours they are drawn in."""
    items = "".join(
        f'<span><i style="background:{colour}"></i>{escape(name)}</span>' for name, colour in names
    )
    return f'<div class="legend">{items}</div>'


def table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers_from: int) -> str:
    """A table of plain texts; columns from `numbers_from` on are aligned as numbers."""

    def cells(tag: str, texts: Sequence[str]) -> str:
        kinds = ["" if column < numbers_from else ' class="num"' for column in range(len(texts))]
        return "".join(
            f"<{tag}{kind}>{escape(text)}</{tag}>" for kind, text in zip(kinds, texts, strict=True)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return (
        f'<div class="scroll"><table class="results"><thead><tr>{cells("th", head)}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def shaded(text: str, share: float, says: str = "") -> str:
    """A table cell that is darker the greater `share` is, in 0..1; `says` stands under the pointer."""
    told = f" title={quoteattr(says)}" if says else ""
    return f'<td style="background:rgba(var(--cell),{0.75 * share:.2f})"{told}>{escape(text)}</td>'


def image(picture: NDArray[np.uint8], alt: str) -> str:
    """A picture, uint8 [H, W, 3], inside the page."""
    data = base64.b64encode(png_bytes(picture)).decode("ascii")
    return (
        f'<img class="pixels" alt={quoteattr(alt)} width="{picture.shape[1]}" '
        f'height="{picture.shape[0]}" src="data:image/png;base64,{data}"/>'
    )


def figure(picture: NDArray[np.uint8], caption: str, kind: str = "") -> str:
    """A picture with a plain caption."""
    return (
        f'<figure class="{kind}">{image(picture, caption)}<figcaption>{escape(caption)}</figcaption></figure>'
    )


def _section(section: Section) -> str:
    lead = f'<p class="lead">{escape(section.lead)}</p>' if section.lead else ""
    return f'<section id="{section.anchor}"><h2>{escape(section.title)}</h2>{lead}{section.body}</section>\n'
