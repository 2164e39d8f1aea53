"""What the ranks of a training tell each other: what an update brought, what was reached, how they stand."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import vhs
from vhs import EpisodeBatch, EpisodeBuffer, Outcome
from vhs.acting.episodes import EndedEpisode
from vhs.acting.setup import convolution_dtype
from vhs.config import Config
from vhs.config.task import file_of
from vhs.errors import ConfigError
from vhs.learning.goals import Goals
from vhs.runs.checkpoint import newest_checkpoint
from vhs.runs.directory import META_NAME, fixed_settings
from vhs.runs.state import decode_state, encode_state
from vhs.runs.window import EpisodeResult
from vhs.task import TaskSpec
from vhs.world import World
from vhs.world.world import table

_NUMBERS = 4
"""That are told of an episode."""
_SEEN_WITHIN_S = 10.0
"""How long a shared file system may take to show a rank what another one wrote."""


class News:
    """What every rank says with an update; readable once `table` has been summed over the ranks."""

    def __init__(
        self,
        world: World,
        episodes: Sequence[EndedEpisode],
        are_retries: Sequence[bool],
        *,
        cut: int,
        stop: bool,
        save: bool,
    ) -> None:
        """Say what there is of this rank.

        Args:
            world: the ranks.
            episodes: that it learns from, as many as every other rank.
            are_retries: whether the seed of each had been missed before.
            cut: episodes that it has lost with their workers so far.
            stop: whether it was asked to stop.
            save: whether it wants a checkpoint.
        """
        results = [
            number
            for e, is_retry in zip(episodes, are_retries, strict=True)
            for number in (int(e.outcome), e.steps, e.episode_return, is_retry)
        ]
        self.table = table(world, [cut, stop, save, *results])

    @property
    def cut(self) -> int:
        """Episodes that were lost with their workers, of all ranks."""
        return int(self.table[:, 0].sum())

    @property
    def stop(self) -> bool:
        """Whether any rank was asked to stop."""
        return bool(self.table[:, 1].any())

    @property
    def save(self) -> bool:
        """Whether any rank wants a checkpoint."""
        return bool(self.table[:, 2].any())

    @property
    def results(self) -> list[EpisodeResult]:
        """The episodes of the update, by rank."""
        rows = self.table[:, 3:].reshape(-1, _NUMBERS).tolist()
        return [
            EpisodeResult(Outcome(int(outcome)), int(steps), value, bool(is_retry))
            for outcome, steps, value, is_retry in rows
        ]

    @property
    def successes(self) -> list[int]:
        """Successes of each rank."""
        outcomes = self.table[:, 3:].reshape(len(self.table), -1, _NUMBERS)[:, :, 0]
        found: list[int] = (outcomes == int(Outcome.SUCCESS)).sum(dim=1).tolist()
        return found


def collect(
    world: World,
    goals: Goals,
    buffer: EpisodeBuffer,
    ids: NDArray[np.int64],
    batch: EpisodeBatch,
    successes: Sequence[int],
) -> None:
    """Keep what the successes of an update reached, of every rank on every rank, in the same order.

    Args:
        world: the ranks.
        goals: whose store takes the images.
        buffer: has this rank's episodes.
        ids: of them.
        batch: the same episodes, and any number behind them.
        successes: of each rank.
    """
    if world.size == 1:
        goals.collect(buffer, ids)
    elif buffer.dtype == np.uint8 and any(successes):
        rows = np.flatnonzero(batch.outcomes[: len(ids)] == Outcome.SUCCESS)
        images = batch.observations[batch.offsets[rows] + batch.lengths[rows]]
        labels = batch.goals[rows].astype(np.int64)
        most = max(successes) * (labels.itemsize + images[:0].itemsize * int(np.prod(images.shape[1:])))
        messages = world.share(labels.tobytes() + images.tobytes(), most)
        for message, count in zip(messages, successes, strict=True):
            told = np.frombuffer(message, np.int64, count)
            reached = np.frombuffer(message, np.uint8, offset=told.nbytes).reshape(count, *images.shape[1:])
            for image, label in zip(reached, told.tolist(), strict=True):
                goals.store.push(image, label)


def packed(state: dict[str, Any]) -> bytes:
    """A state, as `vhs.runs.state` takes them, as one message."""
    tree, tensors = encode_state(state)
    return len(tree).to_bytes(8, "little") + tree + tensors


def unpacked(message: bytes) -> dict[str, Any]:
    """The state that `packed` was given."""
    end = 8 + int.from_bytes(message[:8], "little")
    found: dict[str, Any] = decode_state(message[8:end], message[end:])
    return found


def check_share(config: Config, world: World) -> None:
    """Check that an update's episodes can be shared out.

    Raises:
        ConfigError: they cannot.
    """
    if config.train.episodes_per_update % world.size:
        raise ConfigError(
            f"train.episodes_per_update: expected a multiple of {world.size}, as each of the {world.size} "
            f"processes learns from an equal share, found {config.train.episodes_per_update}"
        )


def facts(config: Config, spec: TaskSpec, run: Path) -> dict[str, Any]:
    """What must be the same on every rank: versions, configuration, task, the checkpoint to go on from."""
    place = file_of(config.task) if isinstance(config.task, str) else None
    return {
        "version of vhs": vhs.__version__,
        "version of numpy": np.__version__,
        **fixed_settings(config),
        "train.episodes": config.train.episodes,
        "precision of the convolutions": str(convolution_dtype(config)),
        "spaces and goals of the task": repr(spec),
        "file of the task": None if place is None else sha256(Path(place[0]).read_bytes()).hexdigest()[:12],
        "newest checkpoint": newest_checkpoint(run),
    }


def check_sees(world: World, run: Path) -> None:
    """Check that every rank sees the directory that rank 0 has just written to.

    Raises:
        PeerError: one does not.
    """
    if world.size == 1:
        return
    path = run / META_NAME
    (expected, *_) = world.share(_digest(path).encode())
    end = time.monotonic() + _SEEN_WITHIN_S
    while (found := _digest(path)) != expected.decode() and time.monotonic() < end:
        time.sleep(0.1)
    is_seen = found == expected.decode()
    world.expect_equal({f"{run}, which all hosts must share": "there" if is_seen else "another one, or none"})


def _digest(path: Path) -> str:
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        return json.dumps(error.strerror)
