"""Settings out of range, or of another type, are refused by a sentence before anything is made."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from rollout_envs import Ledger, open_descriptors

from vhs import ArgumentError, DtypeError
from vhs.rollout import RolloutPool

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("num_workers", 1.5, "`num_workers`: expected an integer, got 1.5"),
        ("num_workers", True, "`num_workers`: expected an integer, got True"),
        ("envs_per_worker", "2", "`envs_per_worker`: expected an integer, got '2'"),
        ("seed", 1.7, "`seed`: expected an integer, got 1.7"),
        ("seed", "7", "`seed`: expected an integer, got '7'"),
        ("seed", 1 << 64, r"seed: expected an integer in 0\.\.2\*\*64"),
        ("deadline_s", math.nan, "`deadline_s`: expected a finite time of more than 0 s, got nan"),
        ("deadline_s", 0, "`deadline_s`: expected a finite time of more than 0 s, got 0"),
        ("deadline_s", -1.0, "`deadline_s`: expected a finite time of more than 0 s, got -1.0"),
        ("deadline_s", "60", "`deadline_s`: expected seconds, got '60'"),
        ("start_limit_s", math.inf, "`start_limit_s`: expected a finite time of more than 0 s, got inf"),
        ("start_limit_s", None, "`start_limit_s`: expected seconds, got None"),
        ("close_limit_s", -0.1, "`close_limit_s`: expected a finite time of at least 0 s, got -0.1"),
        ("info_bytes", 0, r"`info_bytes`: expected a number in 4096\.\.=4294967295, got 0"),
        ("pin", "x", r"pin: expected one of \(None, True, False\), got 'x'"),
        ("pin", 1, r"pin: expected one of \(None, True, False\), got 1"),
        (
            "observation_mode",
            "alike",
            r"observation_mode: expected one of \('same', 'different'\), got 'alike'",
        ),
    ],
)
def test_a_setting_is_checked(name: str, value: Any, message: str) -> None:
    descriptors = open_descriptors()
    with pytest.raises((ArgumentError, DtypeError), match=message):
        RolloutPool(**{"env_fn": Ledger, "num_workers": 1, name: value})
    assert open_descriptors() == descriptors


def test_numpys_numbers_will_do() -> None:
    with RolloutPool(Ledger, np.int64(1), np.uint8(2), seed=np.uint64(5), deadline_s=np.float32(60)) as pool:
        pool.reset(seeds=[np.int32(3), None])
        assert pool.recv().seeds[0] == 3


@pytest.mark.parametrize("seed", [1.0, "3", -1, True])
def test_seeds_of_episodes_are_checked_and_a_refused_reset_changes_nothing(seed: Any) -> None:
    with RolloutPool(Ledger, 1, 2, seed=0) as pool:
        with pytest.raises((ArgumentError, DtypeError), match="seed"):
            pool.reset(seeds=[7, seed])
        pool.reset([0])
        with pytest.raises(RuntimeError, match="`send` on stream 0"):
            pool.reset(seeds=[11, 12])
        pool.reset([1])
        with RolloutPool(Ledger, 1, 2, seed=0) as other:
            other.reset()
            assert pool.recv().seeds.tolist() == other.recv().seeds.tolist()


def test_a_timeout_that_is_no_number_is_refused_and_one_in_the_past_is_over() -> None:
    with RolloutPool(Ledger, 1, seed=0) as pool:
        pool.reset()
        with pytest.raises(ArgumentError, match="timeout"):
            pool.recv(timeout=math.nan)
        assert len(pool.recv(timeout=math.inf)) == 1
        pool.send([0])
        while True:
            try:
                assert pool.recv(timeout=-1.0).steps.tolist() == [1]
                break
            except TimeoutError:
                continue


class Legacy(gym.Env):
    """Seeds a generator that takes 32 bits."""

    observation_space, action_space = gym.spaces.Box(0, 1, (1,), np.float32), gym.spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return np.random.RandomState(seed).rand(1).astype(np.float32), {}


def test_seeds_of_the_pools_own_have_31_bits() -> None:
    with RolloutPool(Legacy, 1, 64, seed=5) as pool:
        pool.reset()
        seeds = pool.recv().seeds
    assert seeds.max() < 1 << 31
    assert seeds.max() > 1 << 30
    assert len(set(seeds.tolist())) == 64
