"""Which seeds the episodes of a run have: training and evaluation never share one.

Owns which episodes of training begin again: those of seeds that were missed (`Seeds`), so that what is rare
and hard is met more often. To begin again where there is more to learn is prioritised level replay (Jiang et
al. 2021), whose score here is whether the seed was missed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from vhs import Outcome

_WINS = 2
"""Times that a seed that was missed has to succeed: once may be luck."""
_MOST_RETRIES = 40
"""Times that a seed is begun again: what is missed so often is left."""
_MOST_MISSED = 300
"""Seeds that wait to be begun again; the oldest leave first, as at the beginning nearly all are missed."""


def episode_seeds(run_seed: int, *, first: int = 0, stride: int = 1, purpose: int = 0) -> Iterator[int]:
    """Independent seeds for the episodes of a run, without end.

    Args:
        run_seed: the one seed that the user gives.
        first: index of the first episode wanted, so that a resumed run goes on where it stopped.
        stride: from one index to the next: each of several ranks takes every so manieth.
        purpose: 0 for training, 1 for evaluation: the same run seed never gives the same episodes to both.
    """
    index = first
    while True:
        yield int(np.random.SeedSequence((run_seed, purpose, index)).generate_state(1)[0])
        index += stride


class Seeds:
    """Seeds in the order in which a rank's episodes of training begin: fresh ones, and some again.

    Nothing is drawn: seeds that were missed take their turns, the oldest first, as often as their share says.
    """

    def __init__(self, fresh: Iterator[int], retry_share: float, max_steps: int) -> None:
        """Begin with no seed missed.

        Args:
            fresh: seeds that were never begun.
            retry_share: share of episodes that begin from a seed that was missed, as long as there are any.
            max_steps: of the task's longest episode; what succeeds later has missed.
        """
        self._fresh, self._share, self._max_steps = fresh, retry_share, max_steps
        self._missed: deque[int] = deque()
        self._tries: dict[int, tuple[int, int]] = {}
        """How often each seed that waits, or runs again, has ended, and how often it succeeded."""
        self._due = 0.0
        """Episodes that should have begun again by now."""
        self.num_fresh = 0
        """Fresh seeds taken."""

    def __iter__(self) -> Iterator[int]:
        """Without end."""
        return self

    def __next__(self) -> int:
        """The seed of an episode that begins."""
        if self._missed:
            self._due += self._share
            if self._due >= 1.0:
                self._due -= 1.0
                return self._missed.popleft()
        self.num_fresh += 1
        return next(self._fresh)

    def ended(self, seed: int, outcome: Outcome, steps: int) -> bool:
        """Take note of an episode that has ended.

        Returns:
            Whether its seed had been missed before.
        """
        tries, wins = self._tries.pop(seed, (0, 0))
        is_won = outcome == Outcome.SUCCESS and steps <= self._max_steps
        is_settled = wins + is_won >= (_WINS if tries else 1)
        if self._share and not is_settled and tries < _MOST_RETRIES:
            self._missed.append(seed)
            self._tries[seed] = tries + 1, wins + is_won
            if len(self._missed) > _MOST_MISSED:
                del self._tries[self._missed.popleft()]
        return tries > 0

    def state_dict(self) -> dict[str, Any]:
        """Which seeds were missed; where the fresh ones stand is not among it."""
        tries = {seed: list(counts) for seed, counts in self._tries.items()}
        return {"missed": list(self._missed), "tries": tries, "due": self._due}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Return to a state that `state_dict` gave."""
        self._missed, self._due = deque(state["missed"]), float(state["due"])
        self._tries = {seed: (tries, wins) for seed, (tries, wins) in state["tries"].items()}


def own_seed(run_seed: int, rank: int, first: int) -> int:
    """The seed of what a rank draws for itself from the episode of index `first` on; rank 0 has the run's."""
    if not rank:
        return run_seed
    return int(np.random.SeedSequence((run_seed, 2, rank, first)).generate_state(1, np.uint64)[0])
