"""Episodes that are imitated again: what of the past an update learns from beside what has just ended.

Imitating an episode once, in the update after its end, takes little from it; where steps are short, as on a
grid, that is too little to learn from at all. So episodes that reached something are kept, each as far as it
reached, and some are imitated in every update under what they reached (Oh et al. 2018, "Self-Imitation
Learning", for returns; here for goals in hindsight).
"""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vhs import EpisodeBatch, EpisodeBuffer, Outcome
from vhs.buffer import make_buffer
from vhs.config import Config
from vhs.errors import CheckpointError, OutputError
from vhs.task import TaskSpec

_RETRY_COPIES = 5
"""Of a success whose seed had been missed before: what is rare is imitated more often."""


class Replay:
    """Keeps the newest episodes that reached something, and draws from them."""

    def __init__(self, buffer: EpisodeBuffer, num_episodes: int, outcomes: Collection[Outcome]) -> None:
        """Keep nothing yet.

        Args:
            buffer: empty; keeps the episodes, as many steps of them as it has room for.
            num_episodes: to draw in an update.
            outcomes: of episodes that reached something.
        """
        self._buffer = buffer
        self._num_episodes = num_episodes
        self.outcomes = tuple(outcomes)
        """Of episodes that reached something."""

    def draw(self) -> tuple[EpisodeBuffer, NDArray[np.int64]] | None:
        """Episodes for an update, as `EpisodeBuffer.gather` takes them; None before there are so many."""
        if len(self._buffer) < self._num_episodes:
            return None
        return self._buffer, self._buffer.sample_ids(self._num_episodes)

    def collect(
        self,
        buffer: EpisodeBuffer,
        batch: EpisodeBatch,
        ends: NDArray[np.int64] | None,
        are_retries: NDArray[np.bool_],
    ) -> None:
        """Keep those that reached something of the first B episodes of a batch, which lie in `buffer`.

        Args:
            buffer: where they lie.
            batch: an update's.
            ends: steps until each reached what it reached, int64 [B], 0 where nothing was; None: its last
                observation shows it.
            are_retries: of those that have just ended, whether their seed had been missed before, bool [B].
                Such are hard, and kept several times: as often as that they are drawn.
        """
        count = len(are_retries)
        lengths = batch.lengths[:count] if ends is None else ends
        reaching = [int(outcome) for outcome in self.outcomes]
        is_kept = np.isin(batch.outcomes[:count], reaching) & (lengths > 0)
        times = np.where(are_retries & (batch.outcomes[:count] == Outcome.SUCCESS), _RETRY_COPIES, 1)[is_kept]
        rows = np.flatnonzero(is_kept).repeat(times)
        self._buffer.collect(buffer, batch.ids[rows], steps=lengths[rows])

    def state_dict(self) -> dict[str, Tensor]:
        """The episodes and the generator, as a file of `EpisodeBuffer.save`.

        Raises:
            OutputError: the directory of temporary files cannot hold it.
        """
        with _scratch() as file:
            self._buffer.save(file)
            return {"file": torch.from_numpy(np.fromfile(file, np.uint8))}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Return to a state that `state_dict` gave; it raises the same.

        Raises:
            CheckpointError: the task has longer or shorter episodes now.
        """
        with _scratch() as file:
            state["file"].numpy().tofile(file)
            kept = EpisodeBuffer.load(file)
        longest = self._buffer.max_episode_steps
        if kept.max_episode_steps != longest:
            raise CheckpointError(
                f"expected episodes of up to {kept.max_episode_steps} steps in training, as when the "
                f"checkpoint was made, found {longest}: `max_steps` of the task has changed"
            )
        self._buffer = kept

    def draw_from(self, state: NDArray[np.uint64]) -> None:
        """Draw with a generator that begins at a state of `vhs.Rng`."""
        self._buffer.rng_state = state


def make_replay(config: Config, spec: TaskSpec, num_ranks: int = 1) -> Replay | None:
    """What each of `num_ranks` replays beside its share of an update; None where a method replays nothing.

    Each keeps its share of the steps, so that what all replay is as old as what one would.
    """
    method = config.method
    if "replay" not in method.row.terms or not method.replay_ratio:
        return None
    outcomes = {Outcome.SUCCESS}
    if method.relabel_probability:
        outcomes |= {Outcome[name.upper()] for name in method.relabel_on or ()}
    buffer = make_buffer(
        spec,
        capacity_steps=max(method.replay_capacity // num_ranks, spec.max_episode_steps),
        frame_stack=config.model.frame_stack,
        stacking="channels" if len(spec.frame_shape) == 3 else "frames",
        seed=config.seed,
    )
    share = config.train.episodes_per_update // num_ranks
    return Replay(buffer, method.replay_ratio * share, outcomes)


@contextmanager
def _scratch() -> Iterator[Path]:
    """A file for a moment: buffers are saved to files, and a checkpoint takes tensors."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            yield Path(folder) / "episodes.vhs"
    except OSError as error:
        raise OutputError(
            f"{tempfile.gettempdir()}: expected room for the episodes that are imitated again, found "
            f"{error.strerror or error}; TMPDIR names another directory"
        ) from error
