"""The lists of an abstract scene (`mujoco.MjvScene`) as arrays of bytes.

MuJoCo's Python package gives each geom and light of a scene as an object; reading a hundred of them takes
longer than drawing them. Their memory is one C array, though. Where it starts and how far its records are
apart is what numpy says of a field with several numbers; where the other fields lie is found by writing to a
record and looking. So nothing here depends on a version of MuJoCo, only on integers being little-endian.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vhs._core import UnsupportedError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

GEOM_FIELDS = (
    "type", "dataid", "objtype", "objid", "category", "matid", "segid", "size", "pos", "mat", "rgba",
    "emission", "specular", "shininess", "reflectance", "label", "texid", "texuniform", "texrepeat",
    "castshadow",
)  # fmt: skip
"""Fields of a geom in the order in which `RasterSource` takes their places."""

LIGHT_FIELDS = (
    "pos", "dir", "type", "attenuation", "cutoff", "exponent", "ambient", "diffuse", "specular", "headlight",
    "castshadow", "directional",
)  # fmt: skip
"""Fields of a light likewise."""

_FLOAT = float(np.frombuffer(b"\x8f\x8f\x8f\x3f", np.float32)[0])
"""A number of which no byte is 0."""


class _Memory:
    """Memory that numpy may look at; keeps its owner alive."""

    def __init__(self, owner: Any, address: int, shape: tuple[int, int]) -> None:
        self._owner = owner
        self.__array_interface__ = {
            "version": 3,
            "typestr": "|u1",
            "shape": shape,
            "data": (address, False),
        }


class Layout(NamedTuple):
    """Where a list of records lies in memory, seen from the position field of its first entry."""

    stride: int
    """Bytes from one record to the next."""
    start: int
    """First byte of a record, seen from its own position field."""
    places: list[int | None]
    """First byte of each field in a record; None for one that this MuJoCo lacks."""

    @classmethod
    def of(cls, entries: Sequence[Any], fields: Sequence[str]) -> Layout:
        """Finds out on a list of at least three entries; the contents of the second one are lost.

        Raises:
            UnsupportedError: The list's memory is not one array, or a field is nowhere in it.
        """
        addresses = [_address(entry.pos) for entry in (entries[0], entries[1], entries[-1])]
        stride = addresses[1] - addresses[0]
        if not 0 < stride < 4096 or addresses[2] - addresses[0] != stride * (len(entries) - 1):
            raise UnsupportedError("scene of this MuJoCo: expected its lists one record after the other")
        # The record around the second entry's position lies within the first three entries.
        around = np.asarray(_Memory(entries, addresses[1] - stride, (1, 2 * stride)))[0]
        places = [_place(entries[1], name, around, addresses[1]) for name in (*fields, "type", "id")]
        start = min(place for place in places if place is not None)
        return cls(stride, start, [None if p is None else p - start for p in places[: len(fields)]])

    def records(self, entries: Sequence[Any]) -> NDArray[np.uint8]:
        """The memory of such a list, uint8 [n, bytes]."""
        address = _address(entries[0].pos) + self.start
        return np.asarray(_Memory(entries, address, (len(entries), self.stride)))


@cache
def layouts() -> tuple[Layout, Layout]:
    """Layouts of geoms and of lights in the scenes of this MuJoCo."""
    import mujoco

    scene = mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), 3)
    return Layout.of(scene.geoms, GEOM_FIELDS), Layout.of(scene.lights, LIGHT_FIELDS)


def _address(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])


def _place(entry: Any, name: str, around: NDArray[np.uint8], position: int) -> int | None:
    """First byte of a field, seen from the record's position field in the middle of the memory around it.

    None where there is no such field.
    """
    if not hasattr(type(entry), name):
        return None
    # The memory is as it was found: text in it may be none, so it is not read.
    value = "" if name == "label" else getattr(entry, name)
    if isinstance(value, np.ndarray):
        return _address(value) - position
    quiet, loud = {str: ("", "x"), float: (0.0, _FLOAT)}.get(type(value), (0, 1))
    setattr(entry, name, quiet)
    before = around.copy()
    setattr(entry, name, loud)
    changed = np.flatnonzero(before != around)
    if not len(changed):
        raise UnsupportedError(f"scene of this MuJoCo: found no place for {name} in its records")
    return int(changed[0]) - len(around) // 2
