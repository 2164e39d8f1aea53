"""Pictures as a GIF or MP4 file, complete or absent."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
from PIL import GifImagePlugin, Image, ImageChops

from vhs.distribution import pip_install
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
                f"{path}: MP4 needs imageio-ffmpeg: {pip_install('mp4')}; a name in .gif needs nothing"
            ) from error


def write_film(path: Path, frames: Iterable[tuple[Image.Image, bool]], fps: int) -> int:
    """Write a film picture by picture: of all that are shown one is in memory.

    Args:
        path: ends in .gif or .mp4.
        frames: pictures, RGB, all of one size, at least one; whether each is the last of an episode, which is
            shown for `LAST_FRAME_S`.
        fps: pictures a second.

    Returns:
        How many pictures there were.

    Raises:
        OutputError: the file cannot be written; what was there is left as it was.
    """
    kind, count = _WRITERS[path.suffix.lower()], 0
    with new_file(path) as partial, ExitStack() as opened:
        film: _Gif | _Mp4 | None = None
        for picture, is_end in frames:
            with writing(path):
                if film is None:
                    film = opened.enter_context(closing(kind(partial, picture.size, fps)))
                film.add(picture, is_end)
            count += 1
        with writing(path):
            opened.close()
    return count


class _Gif:
    """Frames of 256 colours each, of which those after the first hold what has changed."""

    def __init__(self, path: Path, size: tuple[int, int], fps: int) -> None:
        self._fps = fps
        self._before: Image.Image | None = None
        self._file = path.open("wb")
        # No palette for all, and for ever: GIF89a, sections 18 and 26, and Netscape's extension.
        self._file.write(struct.pack("<6sHHBBB", b"GIF89a", *size, 0x70, 0, 0))
        self._file.write(b"\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00")

    def add(self, picture: Image.Image, is_end: bool) -> None:
        # An octree keeps small saturated objects, which a median cut greys; dithered floors would flicker.
        small = picture.quantize(_COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        whole = (0, 0, *picture.size)
        box = whole if self._before is None else ImageChops.difference(self._before, picture).getbbox()
        box = box or (0, 0, 1, 1)  # a picture like the last one is a moment of its own
        duration = round(1000 * (LAST_FRAME_S if is_end else 1 / self._fps))
        for block in GifImagePlugin.getdata(
            small.crop(box), box[:2], duration=duration, include_color_table=True
        ):
            self._file.write(block)
        self._before = picture

    def close(self) -> None:
        with self._file:
            self._file.write(b";")


class _Mp4:
    def __init__(self, path: Path, size: tuple[int, int], fps: int) -> None:
        import imageio_ffmpeg

        self._fps = fps
        self._writer = imageio_ffmpeg.write_frames(str(path), size, fps=fps, macro_block_size=2, quality=8)
        self._writer.send(None)

    def add(self, picture: Image.Image, is_end: bool) -> None:
        # A film has one rate, so a picture that stays is a picture that repeats.
        for _ in range(round(LAST_FRAME_S * self._fps) if is_end else 1):
            self._writer.send(np.asarray(picture).tobytes())

    def close(self) -> None:
        self._writer.close()


_WRITERS: dict[str, type[_Gif | _Mp4]] = {".gif": _Gif, ".mp4": _Mp4}
