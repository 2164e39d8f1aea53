"""Minari's own functions read what we write, and we read what it has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import vhs

minari = pytest.importorskip("minari", reason="data sets of it")
pytest.importorskip("h5py", reason="its files")

from minari.data_collector import EpisodeBuffer as MinariEpisode  # noqa: E402

from vhs.datasets.minari import from_minari, to_minari  # noqa: E402

from .recorded import KINDS, assert_equal, recorded  # noqa: E402

# Of authors and code that are not named.
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:minari")


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))


@pytest.mark.parametrize("kind", list(KINDS))
def test_episodes_come_back_equal_to_the_byte(kind: str) -> None:
    buffer = recorded(kind)
    to_minari(buffer, "test/recorded-v0", author="nobody")
    again = from_minari("test/recorded-v0")
    assert_equal(buffer, again)
    for name in ("goals", "frame_stack", "stacking", "num_goals", "interactions", "first_action", "fields"):
        assert getattr(again, name) == getattr(buffer, name)


def test_their_loader_reads_frames_once_and_ends_and_rewards() -> None:
    buffer = recorded("labels")
    to_minari(buffer, "test/recorded-v0", ids=buffer.ids[1:].tolist())
    dataset = minari.load_dataset("test/recorded-v0")
    assert (dataset.total_episodes, dataset.total_steps) == (2, 7)
    assert isinstance(dataset.action_space, spaces.Discrete)
    for episode, number in zip(dataset.iterate_episodes(), buffer.ids[1:].tolist(), strict=True):
        batch = buffer.gather([number])
        np.testing.assert_array_equal(episode.observations["image"], batch.observations[:, -1])
        assert dataset.observation_space["image"].contains(episode.observations["image"][0])
        assert set(episode.observations["goal"]) == set(batch.goals.tolist())
        np.testing.assert_array_equal(episode.actions, batch.actions[0])
        np.testing.assert_array_equal(episode.rewards, batch.rewards[0])
        assert episode.terminations.tolist()[-1] == batch.terminated[0] != episode.truncations[-1]
        assert not episode.terminations[:-1].any()
        np.testing.assert_array_equal(episode.infos["value"][1:], batch.values[0])


def test_images_lose_bytes_only_where_they_are_to() -> None:
    buffer = recorded("labels")
    to_minari(buffer, "test/lossy-v0", jpeg=True)
    again = from_minari("test/lossy-v0")
    assert again.gather([0]).observations.shape == buffer.gather([0]).observations.shape
    assert (again.gather([0]).observations != buffer.gather([0]).observations).any()


def written(observations: Any, observation_space: Any, **entries: Any) -> str:
    """A data set that somebody else made: two episodes of 3 steps."""
    made = [
        MinariEpisode(
            observations=observations(number),
            actions=np.arange(3),
            rewards=np.array([0.0, 0.0, float(number)]),
            terminations=np.array([False, False, number == 1]),
            truncations=np.array([False, False, number == 0]),
            **entries,
        )
        for number in range(2)
    ]
    name = "test/others-v0"
    minari.create_dataset_from_buffers(
        name, made, observation_space=observation_space, action_space=spaces.Discrete(4)
    )
    return name


def test_a_goal_conditioned_data_set_of_others_is_read_by_its_spaces() -> None:
    def seen(number: int) -> Any:
        places = np.arange(4.0)[:, None] + 10 * number
        return {"observation": places, "achieved_goal": places, "desired_goal": np.full((4, 1), 3.0)}

    box = spaces.Box(-100, 100, (1,), np.float64)
    name = written(
        seen,
        spaces.Dict(observation=box, achieved_goal=box, desired_goal=box),
        infos={"success": np.array([False, False, False, True])},
    )
    buffer = from_minari(name)
    assert (buffer.goals, buffer.num_actions, buffer.max_episode_steps) == ("vectors", 4, 3)
    batch = buffer.gather([0, 1])
    assert batch.observations[:, 0, 0].tolist() == [0, 1, 2, 3, 10, 11, 12, 13]
    assert batch.terminated.tolist() == [False, True]
    assert batch.outcomes.tolist() == [vhs.Outcome.SUCCESS] * 2
    assert (buffer.sample_transitions(8, "future", probability=1.0).goals < 14).all()


def test_any_other_is_read_by_a_reader_into_a_buffer() -> None:
    name = written(lambda number: np.full((4, 2), number, np.float32), spaces.Box(-1, 1, (2,), np.float32))
    with pytest.raises(vhs.ArgumentError, match="reader"):
        from_minari(name)

    def read(seen: Any) -> vhs.Seen:
        return vhs.Seen(seen, label=int(seen[0]))

    with pytest.raises(vhs.ArgumentError, match="`buffer`: expected one that says how many goals"):
        from_minari(name, reader=read)
    shared: dict[str, Any] = {"num_streams": 1, "max_episode_steps": 3, "capacity_steps": 9, "num_goals": 2}
    buffer = vhs.EpisodeBuffer((2,), dtype="float32", **shared)
    assert from_minari(name, buffer, reader=read) is buffer
    assert buffer.gather([0, 1]).goals.tolist() == [0, 1]
    short = vhs.EpisodeBuffer((2,), dtype="float32", **shared | {"max_episode_steps": 2})
    with pytest.raises(vhs.ProtocolError):
        from_minari(name, short, reader=read)
    assert not short.open.any()


def test_nothing_is_written_of_an_empty_buffer(tmp_path: Path) -> None:
    buffer = vhs.EpisodeBuffer((4,), num_streams=1, max_episode_steps=2, capacity_steps=4)
    with pytest.raises(vhs.ArgumentError, match="expected finished episodes"):
        to_minari(buffer, "test/none-v0")
    assert not list(tmp_path.rglob("*.hdf5"))


def test_a_recorded_room_becomes_a_data_set() -> None:
    from vhs.recorder import HindsightRecorder, make_buffer

    room = gymnasium.make("vhs/InteractiveObjectNav-v0")
    buffer = make_buffer(room, capacity_steps=100, max_episode_steps=20, frame_stack=2, interactions={3: 0})
    recorder = HindsightRecorder(room, buffer)
    recorder.action_space.seed(0)
    for seed in range(2):
        recorder.reset(seed=seed)
        done = False
        while not done:
            _, _, terminated, truncated, _ = recorder.step(recorder.action_space.sample())
            done = terminated or truncated
    to_minari(buffer, "rooms/random-v0", action_space=room.action_space)
    assert_equal(buffer, from_minari("rooms/random-v0"))
