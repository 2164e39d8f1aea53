"""What the terms of a method are made of."""

import numpy as np
import pytest

from vhs import Outcome
from vhs.learning.terms import hindsight_values

from .parts import SUCCESS_REWARD, make_batch


@pytest.mark.parametrize("value_target", ["behaviour", "hindsight_return"])
def test_hindsight_value_targets(value_target: str) -> None:
    batch = make_batch([Outcome.FAILURE])
    targets = hindsight_values(
        batch, batch.lengths, value_target, success_reward=SUCCESS_REWARD, reward_scale=0.1, gamma=0.5
    )
    if value_target == "behaviour":
        np.testing.assert_array_equal(targets, batch.values)
    else:
        rewards = batch.rewards[0].astype(np.float64) * 0.1
        rewards[-1] = SUCCESS_REWARD * 0.1
        expected = [
            rewards[0] + 0.5 * rewards[1] + 0.25 * rewards[2],
            rewards[1] + 0.5 * rewards[2],
            rewards[2],
        ]
        np.testing.assert_allclose(targets[0], expected, rtol=1e-5)
