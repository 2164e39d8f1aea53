"""Pictures as a GIF or MP4 file, complete or absent."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from vhs.errors import OutputError
from vhs.runs.files import check_writable, new_file, writing

LAST_FRAME_S = 1.5
"""The outcome stays to be read."""
_COLOURS = 256


def check_film_path(path: Path) -> None:
    """Refuse a film that cannot be made, before anything is played.

    Raises:
        OutputError: another suffix than .gif or .mp4, no such folder, or no encoder.
    """
    if path.suffix.lower() not in _WRITERS:
        raise OutputError(f"{path}: expected a name that ends in .gif or .mp4, found {path.suffix or 'none'}")
    check_writable(path)
    if path.suffix.lower() == ".mp4":
        try:
            import imageio_ffmpeg  # noqa: F401
        except ImportError as error:
            raise OutputError(
                f"{path}: MP4 needs imageio-ffmpeg: pip install -e '.[mp4]'; a name in .gif needs nothing"
            ) from error


def write_film(path: Path, pictures: Sequence[Image.Image], ends: Sequence[bool], fps: int) -> None:
    """Write a film.

    Args:
        path: ends in .gif or .mp4.
        pictures: RGB, all of one size, at least one.
        ends: whether a picture is the last of an episode, one a picture; it is shown for `LAST_FRAME_S`.
        fps: pictures a second.

    Raises:
        OutputError: the file cannot be written; what was there is left as it was.
    """
    with new_file(path) as partial, writing(path):
        _WRITERS[path.suffix.lower()](partial, pictures, ends, fps)


def _write_gif(path: Path, pictures: Sequence[Image.Image], ends: Sequence[bool], fps: int) -> None:
    durations = [round(1000 * (LAST_FRAME_S if is_end else 1 / fps)) for is_end in ends]
    # An octree keeps the small saturated objects, which a median cut greys; dithered floors would flicker.
    small = [
        picture.quantize(_COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        for picture in pictures
    ]
    small[0].save(path, format="GIF", save_all=True, append_images=small[1:], duration=durations, loop=0)


def _write_mp4(path: Path, pictures: Sequence[Image.Image], ends: Sequence[bool], fps: int) -> None:
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(str(path), pictures[0].size, fps=fps, macro_block_size=2, quality=8)
    writer.send(None)
    try:
        for picture, is_end in zip(pictures, ends, strict=True):
            # A film has one rate, so a picture that stays is a picture that repeats.
            for _ in range(round(LAST_FRAME_S * fps) if is_end else 1):
                writer.send(np.asarray(picture).tobytes())
    finally:
        writer.close()


_WRITERS: dict[str, Callable[[Path, Sequence[Image.Image], Sequence[bool], int], None]] = {
    ".gif": _write_gif,
    ".mp4": _write_mp4,
}
