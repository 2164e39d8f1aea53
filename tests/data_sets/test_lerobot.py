"""LeRobot's own loader reads what we write, and we read what it has; skipped where it is not installed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vhs

pytest.importorskip("lerobot", reason="data sets of it; too heavy for the extra `dev`")

from lerobot.datasets.lerobot_dataset import LeRobotDataset

from vhs.datasets.lerobot import from_lerobot, to_lerobot

from .recorded import KINDS, assert_equal, recorded

pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture(autouse=True)
def _offline(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")


@pytest.mark.parametrize("kind", list(KINDS))
def test_episodes_come_back_equal_to_the_byte(kind: str, tmp_path: Path) -> None:
    buffer = recorded(kind)
    to_lerobot(buffer, "test/recorded", tmp_path / "set", fps=10)
    again = from_lerobot(LeRobotDataset("test/recorded", root=tmp_path / "set"))
    assert_equal(buffer, again)
    for name in ("goals", "frame_stack", "stacking", "num_goals", "interactions", "first_action", "fields"):
        assert getattr(again, name) == getattr(buffer, name)


def test_frames_that_are_no_pictures_come_back_too(tmp_path: Path) -> None:
    buffer = recorded("vectors", (5,))
    dataset = to_lerobot(buffer, "test/recorded", tmp_path / "set", fps=10)
    assert dataset[0]["observation.state"].shape == (5,)
    assert_equal(buffer, from_lerobot(dataset))


def test_their_loader_reads_rows_with_pictures_actions_and_tasks(tmp_path: Path) -> None:
    buffer = recorded("labels")
    to_lerobot(
        buffer, "test/recorded", tmp_path / "set", fps=10, task=lambda episode: f"reach {episode.label}"
    )
    dataset = LeRobotDataset("test/recorded", root=tmp_path / "set")
    assert (dataset.num_episodes, dataset.num_frames, dataset.fps) == (3, 8, 10)
    batch = buffer.gather(buffer.ids)
    row = 0
    for episode in range(3):
        for t in range(int(batch.lengths[episode])):
            shown = dataset[row]
            wanted = batch.observations[batch.offsets[episode] + t, -1]
            assert shown["observation.image"].shape == (3, 32, 36)
            np.testing.assert_allclose(
                shown["observation.image"].numpy() * 255, wanted.transpose(2, 0, 1), atol=1e-3
            )
            assert int(shown["action"]) == batch.actions[episode, t]
            assert float(shown["next.reward"]) == batch.rewards[episode, t]
            assert bool(shown["next.done"]) == (t == batch.lengths[episode] - 1)
            assert shown["task"] == f"reach {batch.goals[episode]}"
            row += 1


def test_a_data_set_of_ours_that_was_changed_is_not_taken_for_what_it_was(tmp_path: Path) -> None:
    root = tmp_path / "set"
    to_lerobot(recorded("labels"), "test/recorded", root, fps=10)
    to_lerobot(recorded("labels", seed=1), "test/other", tmp_path / "other", fps=10, ids=[0, 2])
    for name in ("vhs.npz", "vhs.json"):
        (root / "meta" / name).write_bytes((tmp_path / "other" / "meta" / name).read_bytes())
    dataset = LeRobotDataset("test/recorded", root=root)
    with pytest.raises(vhs.ArgumentError, match=r"\[1, 3\] steps, .* found \[1, 4, 3\]: it was changed"):
        from_lerobot(dataset)
    (root / "meta" / "vhs.json").unlink()
    assert len(from_lerobot(dataset)) == 3


def test_a_data_set_of_others_is_read_by_its_features(tmp_path: Path) -> None:
    features = {
        "observation.images.top": {
            "dtype": "image",
            "shape": (32, 32, 3),
            "names": ["height", "width", "channels"],
        },
        "observation.state": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
        "action": {"dtype": "float32", "shape": (2,), "names": ["dx", "dy"]},
        "next.success": {"dtype": "bool", "shape": (1,), "names": None},
    }
    theirs = LeRobotDataset.create("test/others", 10, features, root=tmp_path / "set", use_videos=False)
    rng = np.random.default_rng(0)
    pictures = rng.integers(0, 256, (2, 3, 32, 32, 3)).astype(np.uint8)
    for number, task in enumerate(["push", "pull"]):
        for t in range(3):
            row: dict[str, Any] = {
                "observation.images.top": pictures[number, t],
                "observation.state": np.array([number, t], np.float32),
                "action": np.array([t, -t], np.float32),
                "next.success": np.array([number == 1 and t == 2]),
                "task": task,
            }
            theirs.add_frame(row)
        theirs.save_episode()
    theirs.finalize()
    dataset = LeRobotDataset("test/others", root=tmp_path / "set")
    buffer = from_lerobot(dataset)
    batch = buffer.gather([0, 1])
    np.testing.assert_array_equal(batch.observations[[0, 1, 2, 4, 5, 6], 0], pictures.reshape(6, 32, 32, 3))
    np.testing.assert_array_equal(batch.observations[3], batch.observations[2])
    assert batch.fields["state"][:, 1].tolist() == [0, 1, 2, 2, 0, 1, 2, 2]
    assert batch.actions[0].tolist() == [[0, 0], [1, -1], [2, -2]]
    assert batch.outcomes.tolist() == [vhs.Outcome.TIMEOUT, vhs.Outcome.SUCCESS]
    assert batch.terminated.tolist() == [False, True]
    assert batch.goals.tolist() == [0, 1]
    assert not batch.rewards.any()
    one = from_lerobot(
        LeRobotDataset("test/others", root=tmp_path / "set", episodes=[1]), image="observation.images.top"
    )
    np.testing.assert_array_equal(one.gather([0]).observations, batch.observations[4:])
    with pytest.raises(vhs.ArgumentError, match=r"`image`: expected one of observation.images.top"):
        from_lerobot(dataset, image="observation.images.wrist")


def test_nothing_is_written_of_an_empty_buffer(tmp_path: Path) -> None:
    buffer = vhs.EpisodeBuffer((4,), num_streams=1, max_episode_steps=2, capacity_steps=4)
    with pytest.raises(vhs.ArgumentError, match="expected finished episodes"):
        to_lerobot(buffer, "test/none", tmp_path / "set", fps=10)
    assert not (tmp_path / "set").exists()
