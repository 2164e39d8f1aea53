"""Every method learns a room with one object in it, from its own rewards or from its own failures."""

import pytest

from vhs.methods import METHODS

from .toy import play_toy, toy_config

AT_RANDOM = 0.0952
"""Success of uniform actions, exactly: summed over the 5^6 courses of an episode."""


@pytest.mark.parametrize("name", METHODS)
def test_a_thousand_episodes_beat_acting_at_random(name: str) -> None:
    # Three standard deviations of 250 episodes at random; the methods reach 0.20 to 0.30.
    assert play_toy(toy_config(name), 1000) > AT_RANDOM + 3 * 0.0186
