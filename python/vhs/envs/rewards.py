"""Rewards as a pure function of how a step ended (paper: experiments section).

Owns `Outcome` and the reward table. A reward is the sum of named terms, so that a test can table it and a
learner that relabels an episode can recompute it.
"""

from __future__ import annotations

from enum import StrEnum

from vhs.envs.config import RoomConfig


class Outcome(StrEnum):
    """How an episode ended; the value is what `info["outcome"]` holds."""

    SUCCESS = "success"
    FAILURE = "failure"
    TIMEOUT = "timeout"


def reward_terms(outcome: Outcome | None, config: RoomConfig) -> dict[str, float]:
    """Name every part of one step's reward.

    Args:
        outcome: how the step ended the episode, or None when the episode goes on.
        config: the reward sizes.

    Returns:
        Term name -> value; `step` is always there, the outcome's own term only at the end.
    """
    terms = {"step": config.reward_step}
    if outcome is not None:
        terms[outcome.value] = {
            Outcome.SUCCESS: config.reward_success,
            Outcome.FAILURE: config.reward_failure,
            Outcome.TIMEOUT: config.reward_timeout,
        }[outcome]
    return terms


def compute_reward(outcome: Outcome | None, config: RoomConfig) -> float:
    """Sum of `reward_terms`: the reward that the environment returns for such a step."""
    return sum(reward_terms(outcome, config).values())
