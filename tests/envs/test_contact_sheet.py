from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from vhs.envs import contact_sheet

pytestmark = pytest.mark.usefixtures("opengl")


def test_the_sheet_shows_each_object_in_its_row() -> None:
    sheet = contact_sheet.contact_sheet()
    assert sheet.dtype == np.uint8
    rows = sheet[:, -6 * 168 :].reshape(5, 168, 6, 168, 3)
    # Rows differ from each other in every column only where the object is: little, but always something.
    for column in range(6):
        for one in range(5):
            for other in range(one):
                differs = (rows[one, :, column] != rows[other, :, column]).any(axis=-1).mean()
                assert 0.0 < differs < 0.2


def test_the_command_writes_the_same_file_each_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = [tmp_path / "a" / "sheet.png", tmp_path / "b" / "sheet.png"]
    for path in paths:
        monkeypatch.setattr(sys, "argv", ["contact_sheet", str(path)])
        contact_sheet.main()
    assert paths[0].read_bytes() == paths[1].read_bytes()
