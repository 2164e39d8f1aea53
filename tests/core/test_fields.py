"""Further arrays of observations and steps: declared once, given with each, returned by every sampler."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vhs

FIELDS = {
    "compass": vhs.Field((2,)),
    "joints": vhs.Field((3,), "float64", stacked=True),
    "log_prob": vhs.Field(per="step"),
    "skill": vhs.Field(dtype="int64", per="step"),
    "mask": vhs.Field((2,), bool),
}
FRAME = np.zeros((2, 2), np.uint8)


def new_buffer(**given: Any) -> vhs.EpisodeBuffer:
    sizes: dict[str, Any] = {"num_streams": 2, "max_episode_steps": 4, "capacity_steps": 16, "fields": FIELDS}
    return vhs.EpisodeBuffer((2, 2), **(sizes | given))


def observed(t: int) -> dict[str, Any]:
    return {
        "compass": np.array([t, -t], np.float32),
        "joints": np.full(3, t / 10),
        "mask": np.array([t % 2 == 0, True]),
    }


def given(t: int) -> dict[str, Any]:
    return {**observed(t), "log_prob": -t / 8, "skill": 100 + t}


def recorded(length: int = 3) -> vhs.EpisodeBuffer:
    buffer = new_buffer()
    buffer.begin(0, FRAME, fields=observed(0))
    for t in range(1, length + 1):
        buffer.append(0, 0, 0.0, None, FRAME, fields=given(t))
    buffer.finish(0, "failure")
    return buffer


def test_whole_episodes_have_the_fields(tmp_path: Path) -> None:
    buffer = recorded()
    buffer.save(tmp_path / "buffer")
    for each in (buffer, vhs.EpisodeBuffer.load(tmp_path / "buffer")):
        assert each.fields == FIELDS
        batch = each.gather([0, 0])
        compass = [[t, -t] for t in range(4)]
        assert batch.fields["compass"].tolist() == compass * 2
        assert batch.fields["joints"].shape == (8, 2, 3)
        assert batch.fields["joints"][:4, :, 0].tolist() == [[0, 0], [0, 0.1], [0.1, 0.2], [0.2, 0.3]]
        assert batch.fields["log_prob"].tolist() == [[-1 / 8, -2 / 8, -3 / 8]] * 2
        assert batch.fields["skill"].tolist() == [[101, 102, 103]] * 2
        assert batch.fields["mask"].dtype == np.bool_
        padded = each.sample_episodes(1, padded=True)
        assert padded.fields["compass"].tolist() == [compass]


def test_transitions_have_those_of_both_observations() -> None:
    batch = recorded().sample_transitions(40, "future", ratio=1)
    t = batch.steps.astype(np.float32)
    assert batch.fields["compass"].tolist() == np.stack([t, -t], 1).tolist()
    assert batch.next_fields["compass"].tolist() == np.stack([t + 1, -t - 1], 1).tolist()
    assert batch.fields["skill"].tolist() == (101 + batch.steps).tolist()
    assert set(batch.next_fields) == {"compass", "joints", "mask"}
    assert batch.fields["joints"].shape == batch.next_fields["joints"].shape == (40, 2, 3)


def test_windows_have_them_padded() -> None:
    batch = recorded().sample_windows(30, 3, burn_in=1)
    for row, (first, length) in enumerate(zip(batch.steps, batch.lengths, strict=True)):
        seen = [float(t) for t in range(first, first + length + 1)]
        assert batch.fields["compass"][row, :, 0].tolist() == seen + [0.0] * (5 - len(seen))
        skills = [101 + t for t in range(first, first + length)]
        assert batch.fields["skill"][row].tolist() == skills + [0] * (4 - len(skills))


def test_many_are_appended_at_once_and_the_newest_observed() -> None:
    buffer = new_buffer(stacking="channels")
    for stream in (0, 1):
        buffer.begin(stream, FRAME, fields=observed(stream))
    many = {name: np.stack([np.asarray(given(t)[name]) for t in (5, 6)]) for name in FIELDS}
    many["log_prob"] = many["log_prob"].astype(np.float32)
    buffer.append_batch([1, 0], [0, 0], [0.0, 0.0], None, np.stack([FRAME, FRAME]), fields=many)
    seen = buffer.observe_fields()
    assert set(seen) == {"compass", "joints", "mask"}
    assert seen["compass"].tolist() == [[6, -6], [5, -5]]
    assert seen["joints"].tolist() == [[0, 0, 0, 0.6, 0.6, 0.6], [0.1, 0.1, 0.1, 0.5, 0.5, 0.5]]
    assert buffer.observe_fields([1])["mask"].tolist() == [[False, True]]


def test_a_buffer_without_fields_has_empty_ones() -> None:
    buffer = new_buffer(fields=None)
    buffer.begin(0, FRAME)
    buffer.append(0, 0, 0.0, None, FRAME, fields={})
    assert (buffer.fields, buffer.observe_fields([0])) == ({}, {})
    buffer.finish(0, "failure")
    batch = buffer.sample_transitions(2)
    assert (batch.fields, batch.next_fields, buffer.gather([0]).fields) == ({}, {}, {})


def test_their_bytes_are_counted() -> None:
    plain, image = (new_buffer(fields=fields) for fields in (None, {"image": vhs.Field((64, 64), "uint8")}))
    plain.begin(0, FRAME)
    image.begin(0, FRAME, fields={"image": np.zeros((64, 64), np.uint8)})
    assert image.nbytes - plain.nbytes >= 64 * 64


@pytest.mark.parametrize(
    ("fields", "error", "told"),
    [
        (None, vhs.ArgumentError, r"`fields`: expected an array of shape \[2\] for \"compass\", got none"),
        ({}, vhs.ArgumentError, r"`fields`: expected an array of shape \[2\] for \"compass\", got none"),
        ({"other": 1}, vhs.ArgumentError, r'expected "compass", .*, "mask" alone, got "other"'),
        (
            {"compass": np.zeros(3, np.float32)},
            vhs.ShapeError,
            r'`fields\["compass"\]`: expected shape \[2\], ',
        ),
        ({"compass": np.zeros(2)}, vhs.DtypeError, r'`fields\["compass"\]`: expected float32, got float64'),
        ({"compass": 1.0}, vhs.ShapeError, r"expected shape \[2\], got \[\]"),
        ({"skill": 0.5}, vhs.DtypeError, r'`fields\["skill"\]`: expected int64, got float64'),
        ({"skill": 2**63}, vhs.DtypeError, r'`fields\["skill"\]`: expected int64, got uint64'),
        ([1], vhs.DtypeError, r"`fields`: expected a mapping of names to arrays, got list"),
    ],
)
def test_what_does_not_fit_is_refused_and_nothing_changes(fields: Any, error: type, told: str) -> None:
    buffer = new_buffer()
    buffer.begin(0, FRAME, fields=observed(0))
    fields = {**given(1), **fields} if isinstance(fields, dict) and fields else fields
    with pytest.raises(error, match=told):
        buffer.append(0, 0, 0.0, None, FRAME, fields=fields)
    assert buffer.num_steps == 0
    buffer.append(0, 0, 0.0, None, FRAME, fields=given(1))


def test_an_episode_begins_without_what_comes_with_steps() -> None:
    buffer = new_buffer()
    with pytest.raises(vhs.ArgumentError, match='expected "compass", "joints", "mask" alone, got "log_prob"'):
        buffer.begin(0, FRAME, fields=given(0))
    assert not buffer.open.any()


@pytest.mark.parametrize(
    ("fields", "error", "told"),
    [
        ({"a": vhs.Field((0,))}, vhs.ArgumentError, r"sizes of at least 1 for `a`, got \[0\]"),
        ({"": vhs.Field()}, vhs.ArgumentError, "`bytes of a field's name`: expected a number in 1..=1024"),
        ({"a": vhs.Field(per="step", stacked=True)}, vhs.ArgumentError, "no stack of what comes with steps"),
        ({"a": "float32"}, vhs.DtypeError, "a mapping of names to vhs.Field, .* got str: str"),
        (vhs.Field(), vhs.DtypeError, "a mapping of names to vhs.Field"),
        ({"a": vhs.Field((2**62,))}, vhs.ArgumentError, "`fields`: expected a total of at most"),
    ],
)
def test_a_wrong_schema_is_refused(fields: Any, error: type, told: str) -> None:
    with pytest.raises(error, match=told):
        new_buffer(fields=fields)


def test_a_field_is_a_value() -> None:
    field = vhs.Field((2, 3), "uint16", stacked=True)
    assert pickle.loads(pickle.dumps(field)) == field
    assert (field.shape, field.dtype, field.per, field.stacked) == (
        (2, 3),
        np.dtype("uint16"),
        "observation",
        True,
    )
    assert repr(field) == "Field((2, 3), 'uint16', per='observation', stacked=True)"
    assert eval(repr(field), {"Field": vhs.Field}) == field
    assert len({field, vhs.Field(), vhs.Field(), vhs.Field(per="step")}) == 3
    with pytest.raises(vhs.ArgumentError, match='`per`: expected "observation", "step", got "frame"'):
        vhs.Field(per="frame")  # type: ignore[arg-type]
    with pytest.raises(vhs.DtypeError, match="`dtype`: expected one of"):
        vhs.Field(dtype="complex64")
