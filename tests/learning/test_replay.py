"""Episodes that are imitated again: which are kept, as far as what, and what an update makes of them."""

import copy
import tempfile

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from vhs import EpisodeBatch, EpisodeBuffer, Outcome
from vhs.acting.setup import learn_spec, settled, task_of
from vhs.buffer import make_buffer as buffer_of
from vhs.config import load_config
from vhs.errors import ConfigError, OutputError
from vhs.learning.learner import reached_after
from vhs.learning.replay import Replay, make_replay

from .parts import fill_store, goals_for, make_buffer, play, small_learner

REACHING = (Outcome.SUCCESS, Outcome.FAILURE)
OUTCOMES = [Outcome.SUCCESS, Outcome.FAILURE, Outcome.TIMEOUT, Outcome.FAILURE]
LENGTHS = [3, 4, 5, 6]


def played(outcomes: list[Outcome] = OUTCOMES) -> tuple[EpisodeBuffer, EpisodeBatch]:
    buffer = make_buffer()
    return buffer, buffer.gather(play(buffer, outcomes))


def fresh(count: int) -> NDArray[np.bool_]:
    """No seed was missed before."""
    return np.zeros(count, np.bool_)


def kept(replay: Replay) -> EpisodeBatch:
    drawn = replay.draw()
    assert drawn is not None
    return drawn[0].gather(drawn[0].ids)


def test_what_reached_something_is_kept() -> None:
    replay = Replay(make_buffer(), 2, REACHING)
    buffer, batch = played()
    replay.collect(buffer, batch, None, fresh(4))
    assert kept(replay).lengths.tolist() == [3, 4, 6]
    assert kept(replay).outcomes.tolist() == [Outcome.SUCCESS, Outcome.FAILURE, Outcome.FAILURE]


def test_each_is_kept_as_far_as_it_reached_and_the_oldest_leave() -> None:
    replay = Replay(make_buffer(20), 2, tuple(Outcome))
    buffer, batch = played()
    replay.collect(buffer, batch, np.array([3, 2, 4, 0]), fresh(4))
    assert kept(replay).lengths.tolist() == [3, 2, 4]
    assert kept(replay).terminated.tolist() == [True, False, False]
    replay.collect(buffer, batch, None, fresh(4))
    assert kept(replay).lengths.tolist() == [3, 4, 5, 6], "of twenty steps"


def test_a_success_whose_seed_was_missed_before_is_kept_five_times() -> None:
    replay = Replay(make_buffer(60), 2, REACHING)
    buffer, batch = played([Outcome.SUCCESS, Outcome.FAILURE, Outcome.TIMEOUT, Outcome.SUCCESS])
    replay.collect(buffer, batch, None, np.array([False, True, True, True]))
    assert kept(replay).lengths.tolist() == [3, 4, 6, 6, 6, 6, 6]
    small = Replay(make_buffer(20), 2, REACHING)
    small.collect(buffer, batch, None, np.array([True, True, True, True]))
    assert kept(small).lengths.tolist() == [6, 6, 6], "of twenty steps"


def test_only_what_has_just_ended_is_kept_anew() -> None:
    replay = Replay(make_buffer(), 1, REACHING)
    buffer, batch = played()
    replay.collect(buffer, batch, None, fresh(4))
    joined = buffer.gather(batch.ids[:2], also=replay.draw())
    replay.collect(buffer, joined, None, fresh(2))
    assert kept(replay).lengths.tolist() == [3, 4, 6, 3, 4]


def test_nothing_is_drawn_before_there_is_enough_and_then_at_random() -> None:
    replay = Replay(make_buffer(), 3, REACHING)
    assert replay.draw() is None
    buffer, batch = played()
    replay.collect(buffer, batch, None, fresh(2))
    assert replay.draw() is None
    replay.collect(buffer, batch, None, fresh(4))
    draws = [drawn[1].tolist() for drawn in (replay.draw() for _ in range(50)) if drawn is not None]
    assert {len(ids) for ids in draws} == {3}
    assert {id for ids in draws for id in ids} == {0, 1, 2, 3, 4}


def test_a_state_brings_back_episodes_and_draws() -> None:
    replay, other = (Replay(make_buffer(), 2, REACHING) for _ in range(2))
    buffer, batch = played()
    replay.collect(buffer, batch, None, fresh(4))
    replay.draw()
    other.load_state_dict(copy.deepcopy(replay.state_dict()))
    for _ in range(5):
        ours, theirs = replay.draw(), other.draw()
        assert ours is not None
        assert theirs is not None
        assert ours[1].tolist() == theirs[1].tolist()
        here, there = (drawn[0].gather(drawn[1]).observations for drawn in (ours, theirs))
        np.testing.assert_array_equal(here, there)


def test_kept_episodes_are_imitated_under_what_they_reached() -> None:
    """Against a loop over the episodes, and only the policy's part."""
    settings = ("method.relabel_probability=0.0", "method.hindsight_goal=feature", "method.vhs_weight=3.0")
    replay = Replay(make_buffer(), 2, REACHING)
    learner = small_learner(*settings, "method.hindsight_discount=0.5", replay=replay)
    buffer, batch = played()
    replay.collect(buffer, batch, None, fresh(2))  # two episodes, of 3 and 4 steps
    drawn = replay.draw()
    assert drawn is not None
    joined = buffer.gather(batch.ids, also=(drawn[0], np.array([0, 1])))
    agent = copy.deepcopy(learner.agent).train()
    features = agent.extractor(torch.from_numpy(joined.observations))
    expected = 0.0
    for row in (4, 5):
        first, steps = int(joined.offsets[row]), int(joined.lengths[row])
        goal = features[first + steps].detach()[None]
        done = torch.tensor([1])  # action 4, which each ends with, does interaction 1
        policy, *_ = agent(features[first : first + steps][None], goal, done)
        actions = torch.from_numpy(joined.actions[row, :steps])[None]
        taken = agent.head.log_prob(policy, actions)[0]
        weights = 0.5 ** torch.arange(steps - 1, -1, -1.0)
        expected -= float((taken * weights).sum().detach())
    metrics = learner.update(joined, goals_for(batch))
    assert metrics["replay"] == pytest.approx(expected / sum(LENGTHS), rel=1e-4)
    assert (metrics["relabelled"], metrics["imitation_policy"], metrics["imitation_value"]) == (0, 0, 0)


def test_the_rest_of_an_update_does_not_hear_of_kept_episodes() -> None:
    """But by the batch norm, which stands still here."""

    def terms(replay: bool) -> dict[str, float]:
        held = Replay(make_buffer(), 2, REACHING)
        learner = small_learner("method.relabel_probability=1.0", "method.warmup=100", replay=held)
        learner.agent.train = lambda mode=True: learner.agent  # type: ignore[method-assign,assignment]
        learner.agent.eval()
        buffer, batch = played()
        held.collect(buffer, batch, None, fresh(4))
        joined = buffer.gather(batch.ids, also=held.draw()) if replay else batch
        return learner.update(joined, goals_for(batch))

    with_kept, without = terms(True), terms(False)
    assert with_kept["replay"] > 0 == without["replay"]
    for name in without.keys() - {"replay", "grad_norm"}:
        assert with_kept[name] == pytest.approx(without[name], rel=1e-3, abs=1e-4), name


def test_a_learner_saves_what_it_keeps() -> None:
    learner, other = (small_learner(replay=Replay(make_buffer(), 2, REACHING)) for _ in range(2))
    buffer, batch = played()
    assert learner.replay is not None
    learner.replay.collect(buffer, batch, None, fresh(4))
    other.load_state_dict(copy.deepcopy(learner.state_dict()))
    for one in (learner, other):
        fill_store(one.goals)
        assert one.replay is not None
        joined = buffer.gather(batch.ids, also=one.replay.draw())
        one.update(joined, goals_for(batch))
    for name, value in learner.agent.state_dict().items():
        assert torch.equal(value, other.agent.state_dict()[name]), name


@pytest.mark.parametrize("target", ["behaviour", "hindsight_return"])
def test_what_reached_nothing_is_neither_imitated_nor_kept(target: str) -> None:
    settings = ("method.relabel_on=[failure,timeout]", "method.relabel_probability=1.0")
    replay = Replay(make_buffer(), 2, tuple(Outcome))
    learner = small_learner(*settings, f"method.value_target={target}", replay=replay)
    buffer, batch = played()
    touched = np.array([3, 0, 0, 2])
    for _ in range(2):
        joined = buffer.gather(batch.ids, also=replay.draw())
        assert learner.update(joined, goals_for(batch), touched)["relabelled"] == 0.5, "both failures"
        replay.collect(buffer, joined, reached_after(joined, touched), fresh(4))
    assert kept(replay).lengths.tolist() == [3, 4, 2] * 2


def test_a_directory_that_cannot_hold_what_is_kept_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    replay = Replay(make_buffer(), 2, REACHING)
    monkeypatch.setattr(tempfile, "tempdir", "/dev/null/nowhere")
    with pytest.raises(OutputError, match=r"/dev/null/nowhere: expected room .* TMPDIR names another"):
        replay.state_dict()


@pytest.mark.parametrize(
    ("overrides", "kept_outcomes"),
    [
        ([], {Outcome.SUCCESS, Outcome.FAILURE}),
        (["method.relabel_on=[failure,timeout]"], set(Outcome)),
        (["method.relabel_probability=0.0"], {Outcome.SUCCESS}),
        (["method.replay_ratio=0"], None),
        (["method.name=pg"], None),
        (["method.embedding=word", "method.relabel_probability=0.0"], None),
    ],
)
def test_the_method_says_what_is_kept(overrides: list[str], kept_outcomes: set[Outcome] | None) -> None:
    config = load_config([], ["env.num_workers=0", *overrides])
    spec = learn_spec(config, task_of(config))
    replay = make_replay(settled(config, spec), spec)
    if kept_outcomes is None:
        assert replay is None
    else:
        assert replay is not None
        assert set(replay.outcomes) == kept_outcomes


@pytest.mark.parametrize(("num_ranks", "steps", "episodes"), [(1, 5_000, 8), (2, 2_500, 4), (4, 1_250, 2)])
def test_ranks_share_what_is_kept_and_what_is_drawn(num_ranks: int, steps: int, episodes: int) -> None:
    config = load_config([], ["env.num_workers=0"])
    spec = learn_spec(config, task_of(config))
    replay = make_replay(settled(config, spec), spec, num_ranks)
    assert replay is not None
    buffer = buffer_of(spec, capacity_steps=spec.max_episode_steps, frame_stack=2, stacking="channels")
    frame = np.zeros(spec.frame_shape, np.uint8)
    buffer.begin(0, frame, 0)
    for _ in range(20):
        buffer.append(0, 0, 0.0, 0.0, frame)
    batch = buffer.gather([buffer.finish(0, Outcome.SUCCESS)])
    for _ in range(300):
        replay.collect(buffer, batch, None, fresh(1))
    drawn = replay.draw()
    assert drawn is not None
    assert len(drawn[1]) == episodes
    assert len(drawn[0]) == steps // 20


def test_words_cannot_name_what_was_reached_by_mistake() -> None:
    with pytest.raises(ConfigError, match=r"method\.replay_ratio: expected 0 with method\.embedding = word"):
        load_config([], ["method.embedding=word", "method.relabel_probability=0.0", "method.replay_ratio=1"])
