"""Films are written picture by picture: none is held, and what is read back is what was shown."""

import weakref
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from vhs.errors import OutputError
from vhs.play.film import LAST_FRAME_S, write_film

SIZE = (96, 64)


def picture(number: int) -> Image.Image:
    """A few plain colours, of which a part changes from one picture to the next."""
    pixels = np.full((SIZE[1], SIZE[0], 3), 40, dtype=np.uint8)
    pixels[8:24, 8 + 4 * number : 24 + 4 * number] = (200, 20 * number, 60)
    return Image.fromarray(pixels)


def frames(count: int) -> Iterator[tuple[Image.Image, bool]]:
    for number in range(count):
        yield picture(number), number == count - 1


@pytest.mark.parametrize("name", ["film.gif", "film.mp4"])
def test_no_picture_outlives_the_one_after_it(name: str, tmp_path: Path) -> None:
    if name.endswith("mp4"):
        pytest.importorskip("imageio_ffmpeg")
    seen: list[weakref.ref[Image.Image]] = []
    most = 0

    def counted() -> Iterator[tuple[Image.Image, bool]]:
        nonlocal most
        for shown, is_end in frames(12):
            seen.append(weakref.ref(shown))
            most = max(most, sum(reference() is not None for reference in seen))
            yield shown, is_end

    assert write_film(tmp_path / name, counted(), 3) == 12
    assert most <= 3
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_gif_reads_back_as_what_was_shown(tmp_path: Path) -> None:
    write_film(tmp_path / "film.gif", frames(8), 4)
    with Image.open(tmp_path / "film.gif") as film:
        assert (film.n_frames, film.size, film.info["loop"]) == (8, SIZE, 0)
        for number in range(8):
            film.seek(number)
            assert film.info["duration"] == (250 if number < 7 else 1000 * LAST_FRAME_S)
            shown = np.asarray(film.convert("RGB"), dtype=int)
            assert np.abs(shown - np.asarray(picture(number), dtype=int)).max() <= 16, number


def test_a_picture_like_the_last_one_is_a_frame_of_its_own(tmp_path: Path) -> None:
    write_film(tmp_path / "film.gif", [(picture(1), False), (picture(1), False), (picture(2), True)], 4)
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == 3


def test_an_error_of_what_is_shown_is_not_called_one_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "film.gif").write_text("old")

    def broken() -> Iterator[tuple[Image.Image, bool]]:
        yield picture(0), False
        raise OSError(5, "of the environment")

    with pytest.raises(OSError, match="of the environment") as caught:
        write_film(tmp_path / "film.gif", broken(), 3)
    assert not isinstance(caught.value, OutputError)
    assert (tmp_path / "film.gif").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["film.gif"]
