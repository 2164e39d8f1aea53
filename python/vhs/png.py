"""Frames as pictures for people, and a PNG writer: pictures need no library and no asset file."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


def as_picture(frame: NDArray[Any]) -> NDArray[np.uint8]:
    """A frame of any kind as people see it.

    Args:
        frame: pictures, [..., H, W, channels]: of another number of channels than three the first is shown in
            grey; or a vector, [n], a row of greys. Other types than uint8 are spread over its range.

    Returns:
        uint8 [..., H, W, 3], or [1, n, 3].
    """
    shown = frame[None, :, None] if frame.ndim == 1 else frame
    if shown.dtype != np.uint8:
        low, span = shown.min(), max(float(np.ptp(shown)), 1e-9)
        shown = (255 * (shown - low) / span).astype(np.uint8)
    return shown if shown.shape[-1] == 3 else np.repeat(shown[..., :1], 3, axis=-1)


def png_bytes(picture: NDArray[np.uint8]) -> bytes:
    """Encode uint8 [H, W, 3], or grey [H, W, 1], as a PNG file; the same picture gives the same bytes.

    Raises:
        ValueError: For another type or shape.
    """
    kinds = {1: 0, 3: 2}
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] not in kinds:
        raise ValueError(f"picture: expected uint8 [H, W, 3], found {picture.dtype} {list(picture.shape)}")
    height, width, channels = picture.shape
    # Filter type 0 (none) starts each row.
    rows = np.concatenate([np.zeros((height, 1), np.uint8), picture.reshape(height, -1)], axis=1)
    header = struct.pack(">IIBBBBB", width, height, 8, kinds[channels], 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 9)), (b"IEND", b""))
    body = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + body
