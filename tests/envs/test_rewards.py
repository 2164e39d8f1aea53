from __future__ import annotations

import pytest

from vhs import Outcome
from vhs.envs import RoomConfig, compute_reward, reward_terms


@pytest.mark.parametrize(
    ("outcome", "terms", "reward"),
    [
        (None, {"step": -0.01}, -0.01),
        (Outcome.SUCCESS, {"step": -0.01, "success": 10.0}, 9.99),
        (Outcome.FAILURE, {"step": -0.01, "failure": -1.0}, -1.01),
        (Outcome.TIMEOUT, {"step": -0.01, "timeout": -0.1}, -0.11),
    ],
)
def test_reward_is_the_sum_of_its_named_terms(
    outcome: Outcome | None, terms: dict[str, float], reward: float
) -> None:
    assert reward_terms(outcome, RoomConfig()) == terms
    assert compute_reward(outcome, RoomConfig()) == pytest.approx(reward, abs=1e-12)


def test_reward_sizes_come_from_the_config() -> None:
    config = RoomConfig(reward_success=3.0, reward_step=-0.5)
    assert compute_reward(Outcome.SUCCESS, config) == 2.5
    assert compute_reward(None, config) == -0.5
