"""Frames that are compressed one by one are what they were, and take less memory."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vhs

SHAPE = (12, 10, 3)


def filled(backing: str | Path, flat: bool = True, **given: Any) -> vhs.EpisodeBuffer:
    """Twelve episodes of which six fit; frames are nearly flat, or noise."""
    sizes: dict[str, Any] = {"num_streams": 1, "max_episode_steps": 4, "capacity_steps": 24, "seed": 2}
    buffer = vhs.EpisodeBuffer(SHAPE, backing=backing, **(sizes | given))
    rng = np.random.default_rng(0)

    def frame() -> np.ndarray:
        noise = rng.integers(0, 256, SHAPE, np.uint8)
        return np.where(noise < 5, noise, 90).astype(np.uint8) if flat else noise

    for number in range(12):
        told = {"desired_goal": np.stack([frame(), frame()])} if buffer.goals == "observations" else {}
        buffer.begin(0, frame(), **told)
        for step in range(4):
            buffer.append(0, step, -1.0, None, frame())
        buffer.finish(0, "success" if number % 2 else "failure")
    return buffer


def arrays_of(buffer: vhs.EpisodeBuffer) -> list[np.ndarray | None]:
    steps = buffer.sample_transitions(30, "future", ratio=1)
    parts = buffer.sample_windows(9, 3, 2, "final")
    whole = buffer.sample_episodes(5, "final", padded=True)
    buffer.begin(0, np.full(SHAPE, 3, np.uint8), **told(buffer))
    buffer.append(0, 0, 0.0, None, np.full(SHAPE, 4, np.uint8))
    seen = buffer.observe()
    buffer.abort(0)
    return [
        *(steps.observations, steps.next_observations, steps.goals, steps.rewards, steps.terminated),
        *(parts.observations, parts.goals, parts.rewards, whole.observations, whole.desired_goals),
        *(buffer.gather(buffer.ids).observations, seen),
    ]


def told(buffer: vhs.EpisodeBuffer) -> dict[str, Any]:
    return {"desired_goal": np.zeros((2, *SHAPE), np.uint8)} if buffer.goals == "observations" else {}


@pytest.mark.parametrize("flat", [True, False])
@pytest.mark.parametrize(
    "kind", [{}, {"stacking": "channels"}, {"goals": "observations"}, {"frame_stack": 1}]
)
def test_compressed_frames_are_what_they_were(flat: bool, kind: dict[str, Any], tmp_path: Path) -> None:
    plain, packed = filled("memory", flat, **kind), filled("lz4", flat, **kind)
    packed.save(tmp_path / "packed")
    plain.save(tmp_path / "plain")
    assert (tmp_path / "packed").read_bytes() == (tmp_path / "plain").read_bytes()
    loaded = vhs.EpisodeBuffer.load(tmp_path / "plain", backing="lz4")
    expected = arrays_of(plain)
    for buffer in (packed, loaded):
        for one, two in zip(arrays_of(buffer), expected, strict=True):
            np.testing.assert_array_equal(one, two)


def test_flat_frames_take_less_and_noise_hardly_more() -> None:
    frames = 12 * 10 * 3 * 30
    assert filled("lz4").nbytes < 0.4 * frames
    assert filled("lz4", flat=False).nbytes < 1.2 * frames


def test_what_cannot_be_compressed_says_so(tmp_path: Path) -> None:
    with pytest.raises(vhs.ArgumentError, match="`backing`: expected a folder where persistent is true"):
        filled("lz4", persistent=True)
    filled("memory").save(tmp_path / "saved")
    with pytest.raises(vhs.ArgumentError, match='`backing`: expected "memory" where mmap is true'):
        vhs.EpisodeBuffer.load(tmp_path / "saved", mmap=True, backing="lz4")


@pytest.mark.parametrize("word", ["zstd", "LZ4", "Memory", ""])
def test_a_bare_word_is_no_scratch_file(word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    filled("memory").save(tmp_path / "saved")
    monkeypatch.chdir(tmp_path)
    expected = re.escape(f'"memory", "lz4" or the path of a scratch file, such as "./scratch", got "{word}"')
    for make in (filled, lambda backing: vhs.EpisodeBuffer.load("saved", backing=backing)):
        with pytest.raises(vhs.ArgumentError, match=f"`backing`: expected {expected}"):
            make(word)
    assert [file.name for file in tmp_path.iterdir()] == ["saved"], "nothing was made"
    filled(Path("zstd"))
    filled("zstd", persistent=True)
