"""What a row of the log sums up: the episodes and updates since the last one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from vhs import Outcome
from vhs.acting.episodes import EndedEpisode


class EpisodeResult(NamedTuple):
    """What a row sums up of an episode."""

    outcome: Outcome
    steps: int
    episode_return: float
    is_retry: bool = False
    """Whether its seed had been missed before (`vhs.acting.seeds`)."""


class Window:
    """Sums over the episodes and updates since the last whole row."""

    def __init__(self, max_steps: int) -> None:
        """Start empty.

        Args:
            max_steps: of the task's longest episode; those of training may last longer.
        """
        self._max_steps = max_steps
        self.episodes: list[EpisodeResult] = []
        self._sums: dict[str, float] = {}
        self._counts: dict[str, int] = {}

    def state_dict(self) -> dict[str, Any]:
        """Everything, as plain values."""
        episodes = [(int(e.outcome), e.steps, e.episode_return, e.is_retry) for e in self.episodes]
        return {"episodes": episodes, "sums": dict(self._sums), "counts": dict(self._counts)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Return to a state that `state_dict` gave."""
        self.episodes = [EpisodeResult(Outcome(outcome), *rest) for outcome, *rest in state["episodes"]]
        self._sums, self._counts = dict(state["sums"]), dict(state["counts"])

    def add_episodes(self, episodes: Iterable[EpisodeResult]) -> None:
        """Take episodes that have been learned from."""
        self.episodes += episodes

    def add_update(self, metrics: Mapping[str, float]) -> None:
        """Take the losses of one update; a term is averaged over the updates that had it."""
        for name, value in metrics.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
            self._counts[name] = self._counts.get(name, 0) + 1

    def rates(self) -> dict[str, float]:
        """Shares of the three outcomes within the task's steps, mean steps and mean undiscounted return.

        They are of fresh seeds; beside them stands the success of those that had been missed before, if there
        are any.
        """
        again = [episode for episode in self.episodes if episode.is_retry]
        fresh = [episode for episode in self.episodes if not episode.is_retry]
        rates = summarise(fresh or again, self._max_steps)
        if again:
            rates["retry_success"] = summarise(again, self._max_steps)["success"]
        return rates

    def losses(self) -> dict[str, float]:
        """Mean of every loss term."""
        return {name: total / self._counts[name] for name, total in self._sums.items()}


def summarise(
    episodes: Sequence[EndedEpisode | EpisodeResult], max_steps: int | None = None
) -> dict[str, float]:
    """Success, failure and timeout rate, mean steps and mean undiscounted return of some episodes.

    Args:
        episodes: one at least.
        max_steps: what ended after so many steps counts as a timeout then, its return as it was; None: none
            did.
    """
    count = len(episodes)
    outcomes = [e.outcome if max_steps is None or e.steps <= max_steps else Outcome.TIMEOUT for e in episodes]
    row = {outcome.name.lower(): outcomes.count(outcome) / count for outcome in Outcome}
    row["steps"] = sum(min(e.steps, max_steps or e.steps) for e in episodes) / count
    row["return"] = sum(e.episode_return for e in episodes) / count
    return row
