"""Procedural textures, so that the room needs no asset files.

Owns the pictures on objects, floor and walls. Pictures are uint8 [H, W, 3], row 0 at the top; the same call
always gives the same bytes.

Colour rule: objects are saturated (or white), floor and walls are muted and of middle brightness, so that
nothing of the room can be taken for an object even where an object covers only a few pixels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

_SIDE = 64


def label_wrap(
    bands: Sequence[tuple[float, Colour]], stripe: tuple[float, float, Colour], patch: Colour | None = None
) -> Picture:
    """Wrap-around label: horizontal bands, one stripe, and a disc on each of four sides.

    Args:
        bands: (upper end as share of the height, colour), from bottom to top.
        stripe: (lower end, upper end, colour), drawn over the bands.
        patch: colour of the discs centred on the stripe; none are drawn without.
    """
    level = 1.0 - (np.arange(_SIDE) + 0.5) / _SIDE
    picture = np.zeros((_SIDE, _SIDE, 3), np.uint8)
    for upper, colour in reversed(bands):
        picture[level <= upper] = colour
    low, high, colour = stripe
    picture[(level >= low) & (level <= high)] = colour
    if patch is not None:
        # Four discs around: their centres lie at u = 1/8, 3/8, ..., the middle of a carton's sides.
        around = ((np.arange(_SIDE) + 0.5) / _SIDE * 4) % 1.0 - 0.5
        up = (level - (low + high) / 2) * 2.2
        picture[up[:, None] ** 2 + around[None, :] ** 2 < 0.28**2] = patch
    return picture


def tiles(colour: Colour, other: Colour, seed: int, tiles_a_side: int = 6) -> Picture:
    """Two-tone floor tiles with joints and grain, so that every stride and turn moves something in view."""
    side = 32 * tiles_a_side
    index = np.arange(side) // 32
    odd = (index[:, None] + index[None, :]) % 2 == 1
    picture = np.where(odd[..., None], np.array(other, float), np.array(colour, float))
    joint = np.arange(side) % 32 < 1
    picture[joint[:, None] | joint[None, :]] *= 0.75
    return _grained(picture, seed)


def planks(colour: Colour, other: Colour, seed: int, planks_a_side: int, upright: bool) -> Picture:
    """Two-tone planks, upright or lying, for a wall."""
    side = 128
    index = np.arange(side) * planks_a_side // side % 2 == 1
    odd = np.broadcast_to(index[None, :] if upright else index[:, None], (side, side))
    picture = np.where(odd[..., None], np.array(other, float), np.array(colour, float))
    # A dark skirting board marks where the wall meets the floor.
    picture[int(side * 0.94) :] *= 0.6
    return _grained(picture, seed)


def _grained(picture: NDArray[np.float64], seed: int) -> Picture:
    """Add faint grain of a fixed seed and round to bytes."""
    grain = np.random.default_rng(seed).normal(0.0, 4.0, picture.shape[:2])
    return np.clip(picture + grain[..., None], 0, 255).astype(np.uint8)
