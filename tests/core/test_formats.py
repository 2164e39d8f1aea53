"""Files of every version that ever wrote one: read to what they held then, or refused by name."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

import vhs

FORMATS = Path(__file__).parents[1] / "formats"
FILES = sorted(FORMATS.glob("*.vhs"))


def load_make() -> ModuleType:
    spec = importlib.util.spec_from_file_location("formats_make", FORMATS / "make.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MAKE = load_make()
DIGESTS = json.loads((FORMATS / "digests.json").read_text(encoding="utf-8"))


def reader_of(name: str) -> Callable[[Path], str]:
    kinds = {"goals": MAKE.of_goals, "priorities": MAKE.of_priorities}
    return next((read for kind, read in kinds.items() if kind in name), MAKE.of_episodes)


def test_every_file_has_a_digest_and_none_is_large() -> None:
    assert sorted(DIGESTS) == [path.name for path in FILES]
    assert set(MAKE.FILES) <= set(DIGESTS)
    assert sum(path.stat().st_size for path in FILES) < 100_000


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_file_reads_as_what_it_held_when_it_was_written(path: Path) -> None:
    assert reader_of(path.name)(path) == DIGESTS[path.name]


@pytest.mark.parametrize("name", MAKE.FILES)
def test_this_version_writes_what_it_says(name: str, tmp_path: Path) -> None:
    make, read = MAKE.FILES[name]
    make(tmp_path / name)
    assert read(tmp_path / name) == DIGESTS[name]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_file_of_a_later_version_is_refused_by_name(path: Path, tmp_path: Path) -> None:
    kind = vhs.GoalStore if path.name.startswith("goals") else vhs.EpisodeBuffer
    kind.verify(path)
    later = bytearray(path.read_bytes())
    later[8] = 99
    (tmp_path / "later").write_bytes(later)
    for read in (kind.load, kind.verify):
        with pytest.raises(vhs.DamagedFileError, match=r"`version`: expected .*, found 99"):
            read(tmp_path / "later")
