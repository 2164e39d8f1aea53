"""A moment as a picture for people: both views side by side, and words below them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from vhs import Outcome
from vhs.show.moments import Moment

SIDE_PX = 480
"""Height and width of each of the two views."""
GAP_PX = 8
CAPTION_PX = 88
TOLD_PX = CAPTION_PX - 2 * GAP_PX
"""Height and width of a goal that is a picture."""
WIDTH_PX, HEIGHT_PX = 2 * SIDE_PX + GAP_PX, SIDE_PX + CAPTION_PX
"""Size of the picture; both even, as video codecs want them."""

BACKGROUND = (24, 26, 30)
INK, FAINT = (240, 240, 240), (160, 166, 174)
# The Okabe-Ito palette, told apart by the colour-blind; grey for what did not happen.
COLOURS = {Outcome.SUCCESS: (0, 178, 130), Outcome.FAILURE: (240, 114, 36), Outcome.TIMEOUT: (170, 174, 180)}


def draw(moment: Moment) -> Image.Image:
    """Draw a moment.

    Returns:
        RGB, `WIDTH_PX` x `HEIGHT_PX`.
    """
    picture = Image.new("RGB", (WIDTH_PX, HEIGHT_PX), BACKGROUND)
    picture.paste(_enlarged(moment.view, Image.Resampling.NEAREST), (0, 0))
    if moment.onlooker is not None:
        picture.paste(_enlarged(moment.onlooker, Image.Resampling.LANCZOS), (SIDE_PX + GAP_PX, 0))
    canvas = ImageDraw.Draw(picture)
    small, large = _font(17), _font(27)
    columns = (("goal", 16, moment.instruction), ("step", 396, str(moment.step)), *_doing(moment))
    for title, left, text in columns:
        canvas.text((left, SIDE_PX + 12), title, FAINT, small)
        canvas.text((left, SIDE_PX + 36), text, INK, large)
    if moment.told is not None:
        picture.paste(_enlarged(moment.told, Image.Resampling.NEAREST, TOLD_PX), (200, SIDE_PX + GAP_PX))
    if moment.outcome is not None:
        _frame_outcome(canvas, moment, large)
    return picture


def _doing(moment: Moment) -> tuple[tuple[str, int, str], ...]:
    """What is said of a moment in the right half: title, place, text."""
    if moment.outcome is not None:
        return ()
    columns: tuple[tuple[str, int, str], ...] = ()
    if moment.action is not None:
        columns += (("action", SIDE_PX + GAP_PX + 16, moment.action),)
    if moment.value is not None:
        columns += (("value", SIDE_PX + GAP_PX + 300, f"{moment.value:+.2f}"),)
    return columns


def _frame_outcome(canvas: ImageDraw.ImageDraw, moment: Moment, font: ImageFont.FreeTypeFont) -> None:
    """Name the outcome and put a frame of its colour around the views."""
    assert moment.outcome is not None
    colour = COLOURS[moment.outcome]
    canvas.rectangle((0, 0, WIDTH_PX - 1, SIDE_PX - 1), outline=colour, width=6)
    canvas.text((SIDE_PX + GAP_PX + 16, SIDE_PX + 12), "outcome", FAINT, _font(17))
    canvas.text((SIDE_PX + GAP_PX + 16, SIDE_PX + 36), moment.ending or "", colour, font)


def _enlarged(view: NDArray[np.uint8], how: Image.Resampling, side_px: int = SIDE_PX) -> Image.Image:
    """A view in the middle of a square; the agent's pixels stay visible as pixels."""
    picture = Image.fromarray(view)
    scale = side_px / max(picture.size)
    large = picture.resize((round(scale * picture.width), round(scale * picture.height)), how)
    square = Image.new("RGB", (side_px, side_px), BACKGROUND)
    square.paste(large, ((side_px - large.width) // 2, (side_px - large.height) // 2))
    return square


def _font(size_px: int) -> ImageFont.FreeTypeFont:
    """Pillow's own font, the same on every machine."""
    font = ImageFont.load_default(size_px)
    assert isinstance(font, ImageFont.FreeTypeFont), "Pillow was built without FreeType"
    return font
