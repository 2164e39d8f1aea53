"""Which seeds episodes of training begin with: fresh ones, and those that were missed again."""

import copy
import itertools
import random

import pytest

from vhs import Outcome
from vhs.acting.seeds import _MOST_MISSED, _MOST_RETRIES, _WINS, Seeds

MAX_STEPS = 20


def make(share: float = 0.25) -> Seeds:
    return Seeds(itertools.count(), share, MAX_STEPS)


def test_without_a_share_all_are_fresh() -> None:
    seeds = make(0.0)
    for expected in range(50):
        assert next(seeds) == expected
        assert not seeds.ended(expected, Outcome.TIMEOUT, MAX_STEPS)


@pytest.mark.parametrize(
    ("outcome", "steps", "is_missed"),
    [
        (Outcome.SUCCESS, MAX_STEPS, False),
        (Outcome.SUCCESS, MAX_STEPS + 1, True),
        (Outcome.TIMEOUT, MAX_STEPS, True),
        (Outcome.FAILURE, 2, True),
    ],
)
def test_what_did_not_succeed_in_time_comes_again(outcome: Outcome, steps: int, is_missed: bool) -> None:
    seeds = make(0.5)
    assert not seeds.ended(next(seeds), outcome, steps)
    assert (0 in itertools.islice(seeds, 5)) is is_missed


@pytest.mark.parametrize("share", [0.1, 0.25, 0.5, 0.9])
def test_a_share_of_episodes_are_retries(share: float) -> None:
    seeds, retries = make(share), 0
    for _ in range(1000):
        retries += seeds.ended(next(seeds), Outcome.TIMEOUT, MAX_STEPS)
    assert retries == pytest.approx(1000 * share, abs=12)
    assert seeds.num_fresh == 1000 - retries


def test_a_seed_is_left_once_it_succeeds_twice_or_was_tried_often_enough() -> None:
    seeds = make(0.5)
    tries = dict.fromkeys(range(3), 0)
    for _ in range(300):
        seed = next(seeds)
        if seed in tries:
            tries[seed] += 1
        is_won = seed > 2 or (seed == 0 and tries[0] in (3, 6)) or (seed == 1 and tries[1] > 1)
        seeds.ended(seed, Outcome.SUCCESS if is_won else Outcome.TIMEOUT, 5)
    assert tries == {0: 6, 1: 1 + _WINS, 2: 1 + _MOST_RETRIES}
    assert seeds.state_dict()["missed"] == []
    assert seeds.state_dict()["tries"] == {}


def test_the_oldest_are_forgotten_where_too_many_wait() -> None:
    seeds = make(0.01)
    for seed in range(_MOST_MISSED + 50):
        seeds.ended(seed, Outcome.FAILURE, 3)
    state = seeds.state_dict()
    assert state["missed"] == list(range(50, _MOST_MISSED + 50))
    assert sorted(state["tries"]) == state["missed"]


def test_no_seed_is_tried_by_two_episodes_at_once_and_its_state_says_all() -> None:
    """Against a plain account of who has which seed, with many episodes under way, saved and loaded."""
    rng = random.Random(0)
    seeds, under_way, missed_before = make(0.4), [], set()
    for step in range(3000):
        if len(under_way) < 16:
            seed = next(seeds)
            assert seed not in under_way
            under_way.append(seed)
        else:
            seed = under_way.pop(rng.randrange(16))
            outcome = rng.choice(list(Outcome))
            assert seeds.ended(seed, outcome, 5) is (seed in missed_before)
            if outcome != Outcome.SUCCESS:
                missed_before.add(seed)
        if step % 100 == 0:
            state = copy.deepcopy(seeds.state_dict())
            again = Seeds(itertools.count(seeds.num_fresh), 0.4, MAX_STEPS)
            again.load_state_dict(state)
            assert again.state_dict() == state
            again.num_fresh = seeds.num_fresh
            seeds = again
