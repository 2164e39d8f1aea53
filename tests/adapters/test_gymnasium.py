"""`gymnasium.make_vec` makes pools."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import vhs
import vhs.envs
from vhs.adapters.gymnasium import pooled
from vhs.rollout import RolloutVectorEnv

pytestmark = pytest.mark.slow  # they start processes


@pytest.mark.parametrize("how", [{}, {"vectorization_mode": "vector_entry_point", "num_workers": 2}])
def test_make_vec_makes_a_pool_that_steps_as_its_own_vector(how: dict[str, Any]) -> None:
    ours = gymnasium.make_vec(pooled("CartPole-v1"), 4, max_episode_steps=7, **how)
    theirs = gymnasium.make_vec("CartPole-v1", 4, vectorization_mode="sync", max_episode_steps=7)
    try:
        assert isinstance(ours, RolloutVectorEnv)
        assert ours.spec is not None
        assert ours.spec.id == "CartPole-v1"
        rng = np.random.default_rng(0)
        np.testing.assert_array_equal(ours.reset(seed=1)[0], theirs.reset(seed=1)[0])
        for _ in range(20):
            actions = rng.integers(0, 2, 4)
            for mine, other in zip(ours.step(actions)[:4], theirs.step(actions)[:4], strict=True):
                np.testing.assert_array_equal(mine, other)
    finally:
        ours.close()
        theirs.close()


def test_arguments_reach_the_environment_and_the_pool() -> None:
    spec = pooled("vhs/ObjectNav-v0")
    how = {"autoreset_mode": "SameStep", "pool_kwargs": {"on_error": "restart", "seed": 3}}
    with gymnasium.make_vec(spec, 2, num_workers=1, max_episode_steps=5, **how) as envs:  # type: ignore[arg-type]
        assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
        envs.reset()
        for _ in range(5):
            *_, truncated, _ = envs.step(np.full(2, 1))
        assert truncated.all()


def test_workers_share_environments_equally() -> None:
    with pytest.raises(vhs.ArgumentError, match="expected a divisor of 4 environments, got 3"):
        gymnasium.make_vec(pooled("CartPole-v1"), 4, num_workers=3)
    with pytest.raises(gymnasium.error.Error):
        pooled("Nothing-v9")
