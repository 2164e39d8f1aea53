"""Which interaction an action does is said, never guessed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vhs

FRAME = np.zeros(1, np.uint8)


def make_buffer(**arguments: object) -> vhs.EpisodeBuffer:
    sizes = {"num_streams": 1, "max_episode_steps": 4, "capacity_steps": 40}
    return vhs.EpisodeBuffer((1,), **sizes, **arguments)


def fail(buffer: vhs.EpisodeBuffer, *actions: int, interaction: int = 0) -> int:
    buffer.begin(0, FRAME, 0, interaction)
    for action in actions:
        buffer.append(0, action, 0.0, 0.0, FRAME)
    return buffer.finish(0, "failure")


def relabelled(buffer: vhs.EpisodeBuffer) -> list[int]:
    batch = buffer.gather(buffer.ids)
    return vhs.relabel(batch, probability=1.0, rng=0).interactions.tolist()


def test_an_environment_with_two_moves_and_two_interactions() -> None:
    buffer = make_buffer(num_actions=4, interactions={2: 0, 3: 1})
    assert buffer.num_interactions == 2
    fail(buffer, 0, 2)
    fail(buffer, 1, 3)
    assert relabelled(buffer) == [0, 1]
    steps = buffer.sample_transitions(50, "final", probability=1.0)
    assert steps.interactions.tolist() == steps.ids.tolist()
    sampled = buffer.sample_episodes(50, "final")
    assert sampled.hindsight.interactions.tolist() == sampled.ids.tolist()


def test_interactions_may_come_first_or_share_one() -> None:
    buffer = make_buffer(num_actions=4, interactions={0: 1, 1: 0, 3: 1}, num_interactions=3)
    for action in range(4):
        fail(buffer, 2, action, interaction=2)
    assert relabelled(buffer) == [1, 0, 2, 1]  # action 2 is a move: what was told stays


@pytest.mark.parametrize("num_interactions", [0, 1, None])
def test_where_there_is_one_interaction_or_none_nothing_needs_to_be_said(
    num_interactions: int | None,
) -> None:
    buffer = make_buffer(num_interactions=num_interactions)
    assert (buffer.num_actions, buffer.interactions) == (None, {})
    fail(buffer, 0)
    fail(buffer, 5000)
    assert relabelled(buffer) == [0, 0]


def test_what_was_said_is_saved(tmp_path: Path) -> None:
    buffer = make_buffer(num_actions=7, interactions={5: 1, 2: 0})
    fail(buffer, 5, interaction=0)
    buffer.save(tmp_path / "buffer")
    loaded = vhs.EpisodeBuffer.load(tmp_path / "buffer")
    assert (loaded.num_actions, loaded.num_interactions) == (7, 2)
    assert loaded.interactions == {2: 0, 5: 1}
    assert relabelled(loaded) == [1]


def test_files_of_version_1_say_from_which_action_on_they_are_interactions() -> None:
    path = Path(__file__).parents[1] / "formats" / "episodes-1-labels.vhs"
    buffer = vhs.EpisodeBuffer.load(path)
    assert (buffer.num_actions, buffer.num_interactions) == (6, 3)
    assert buffer.interactions == {3: 0, 4: 1, 5: 2}
