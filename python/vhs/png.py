"""A PNG writer, so that pictures need no library and no asset file."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray


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
