"""The hindsight rule, on batches of real buffers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import vhs

from .naive import INTERACTIONS, FrameSource
from .test_episodes import add_episode, make_buffer

episodes = st.lists(
    st.fixed_dictionaries(
        {
            "stream": st.integers(0, 2),
            "length": st.integers(1, 4),
            "interaction": st.integers(0, 2),
            "action": st.integers(0, 5),
            "outcome": st.sampled_from(vhs.Outcome),
        }
    ),
    min_size=1,
    max_size=20,
)


@given(
    episodes,
    st.floats(0, 1),
    st.lists(st.sampled_from(["success", "failure", "timeout"]), max_size=3),
    st.integers(0, 2**64 - 1),
)
def test_goals_are_the_final_observation_of_the_same_episode(
    episodes: list[dict[str, int]], probability: float, on: list[str], seed: int
) -> None:
    buffer, frames = make_buffer(), FrameSource()
    finals: dict[int, bytes] = {}
    for said in episodes:
        stream = said["stream"]
        buffer.begin(stream, frames.next(), 0, said["interaction"])
        for _ in range(said["length"]):
            buffer.append(stream, said["action"], 0.0, 0.0, frames.next())
        final = buffer.observe([stream])[0].tobytes()
        finals[buffer.finish(stream, said["outcome"])] = final
    batch = buffer.gather(buffer.ids)
    hindsight = vhs.relabel(batch, rng=seed, on=on, probability=probability)
    for place, episode in enumerate(batch.ids.tolist()):
        said, selected = episodes[episode], hindsight.selected[place]
        goal = batch.observations[hindsight.goal_rows[place]]
        assert goal.tobytes() == finals[episode]
        assert not selected or said["outcome"].name.lower() in on
        done = INTERACTIONS.get(said["action"]) if selected else None
        expected = said["interaction"] if done is None else done
        assert hindsight.interactions[place] == expected
    np.testing.assert_array_equal(hindsight.goal_rows, batch.offsets + batch.lengths)
    if probability == 1:
        names = [vhs.Outcome(code).name.lower() for code in batch.outcomes]
        assert hindsight.selected.tolist() == [name in on for name in names]


def failures(count: int) -> vhs.EpisodeBatch:
    buffer, frames = make_buffer(capacity_steps=2 * count + 20), FrameSource()
    ids = [add_episode(buffer, frames, action=4) for _ in range(count)]
    return buffer.gather(ids)


def test_the_measured_rate_is_the_probability() -> None:
    batch, rng, draws = failures(500), vhs.Rng(7), 40
    for probability in [0.1, 0.4, 0.8]:
        count = sum(
            int(vhs.relabel(batch, rng=rng, probability=probability).selected.sum()) for _ in range(draws)
        )
        total = 500 * draws
        # Five standard deviations of a binomial.
        bound = 5 * (total * probability * (1 - probability)) ** 0.5
        assert abs(count - total * probability) < bound


def test_failures_alone_are_relabelled_by_default() -> None:
    buffer, frames = make_buffer(capacity_steps=60), FrameSource()
    ids = [add_episode(buffer, frames, outcome=outcome) for outcome in vhs.Outcome]
    selected = vhs.relabel(buffer.gather(ids), rng=0, probability=1.0).selected
    assert selected.tolist() == [False, True, False]
    sampled = buffer.sample_episodes(30, relabel="final")
    np.testing.assert_array_equal(sampled.hindsight.selected, sampled.outcomes == vhs.Outcome.FAILURE)
    both = buffer.sample_episodes(30, "final", 1.0, (vhs.Outcome.FAILURE, "timeout"))
    np.testing.assert_array_equal(both.hindsight.selected, both.outcomes != vhs.Outcome.SUCCESS)


def test_a_generator_moves_on_and_a_seed_does_not() -> None:
    batch, rng = failures(100), vhs.Rng(3)
    first = vhs.relabel(batch, rng=rng).selected
    state = rng.state
    second = vhs.relabel(batch, rng=rng).selected
    assert (first != second).any()
    np.testing.assert_array_equal(vhs.relabel(batch, rng=3).selected, first)
    np.testing.assert_array_equal(vhs.relabel(batch, rng=vhs.Rng.from_state(state)).selected, second)


def test_writing_to_a_batch_does_not_lead_relabelling_astray() -> None:
    batch = failures(3)
    expected = vhs.relabel(batch, rng=0).goal_rows
    batch.lengths[:] = 2**40
    batch.offsets[:] = -1
    np.testing.assert_array_equal(vhs.relabel(batch, rng=0).goal_rows, expected)


def test_the_batch_is_left_as_it_was() -> None:
    batch = failures(20)
    names = [name for name in dir(batch) if isinstance(getattr(batch, name), np.ndarray)]
    before = {name: getattr(batch, name).copy() for name in names}
    vhs.relabel(batch, rng=0, probability=1.0)
    assert len(names) == 12
    for name in names:
        np.testing.assert_array_equal(getattr(batch, name), before[name])


@pytest.mark.parametrize("name", ["success", "failure", "timeout"])
def test_outcomes_have_the_same_names_on_both_sides(name: str) -> None:
    buffer = make_buffer()
    add_episode(buffer, FrameSource(), outcome=name)
    assert buffer.gather([0]).outcomes.tolist() == [vhs.Outcome.from_name(name)]


@given(
    st.lists(st.tuples(st.integers(1, 4), st.integers(0, 2), st.integers(0, 5)), min_size=1, max_size=12),
    st.data(),
)
def test_episodes_are_cut_where_they_last_reached_something(
    said: list[tuple[int, int, int]], data: st.DataObject
) -> None:
    buffer, frames = make_buffer(), FrameSource()
    seen: list[list[bytes]] = []
    for length, interaction, action in said:
        buffer.begin(0, frames.next(), 0, interaction)
        observations = [buffer.observe([0])[0].tobytes()]
        for step in range(length):
            buffer.append(0, (action + step) % 6, 0.0, 0.0, frames.next())
            observations.append(buffer.observe([0])[0].tobytes())
        buffer.finish(0, "timeout")
        seen.append(observations)
    batch = buffer.gather(buffer.ids)
    ends = [data.draw(st.integers(0, length)) for length in batch.lengths.tolist()]
    hindsight = vhs.relabel(batch, rng=0, on=("timeout",), probability=1.0, ends=ends)
    for place, (id, end) in enumerate(zip(batch.ids.tolist(), ends, strict=True)):
        _, interaction, action = said[id]
        assert hindsight.selected[place] == (end > 0)
        assert hindsight.lengths[place] == end
        assert batch.observations[hindsight.goal_rows[place]].tobytes() == seen[id][end]
        done = INTERACTIONS.get((action + end - 1) % 6) if end else None
        assert hindsight.interactions[place] == (interaction if done is None else done)
    whole = vhs.relabel(batch, rng=0, on=("timeout",), probability=1.0, ends=batch.lengths)
    without = vhs.relabel(batch, rng=0, on=("timeout",), probability=1.0)
    for name in ("selected", "goal_rows", "interactions", "lengths"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(without, name))


@pytest.mark.parametrize(
    ("ends", "error", "words"),
    [
        ([1], vhs.ShapeError, "ends"),
        ([1, 4], vhs.ArgumentError, r"`ends`: expected steps of an episode, in 0\.\.=3, got 4"),
        ([-1, 1], vhs.ArgumentError, r"`ends`: .* got -1"),
        ([0.5, 1.0], vhs.DtypeError, "ends"),
    ],
)
def test_ends_lie_in_their_episodes(ends: list[float], error: type[Exception], words: str) -> None:
    buffer, frames = make_buffer(), FrameSource()
    for _ in range(2):
        add_episode(buffer, frames, length=3)
    rng = vhs.Rng(0)
    before = rng.state
    with pytest.raises(error, match=words):
        vhs.relabel(buffer.gather(buffer.ids), rng=rng, ends=ends)
    np.testing.assert_array_equal(rng.state, before)
