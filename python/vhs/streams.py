"""What the recorders of one buffer share: whose a stream is, and the infos of the steps that were recorded.

A buffer keeps no infos: they are Python's dictionaries, of any content. Where an environment's
`compute_reward` reads them, they are kept here beside the buffer, as long as it stores their episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, overload
from weakref import WeakKeyDictionary, ref

import numpy as np
from numpy.typing import NDArray

from vhs._core import EpisodeBuffer, EpisodeError

if TYPE_CHECKING:
    from vhs.recorder import HindsightRecorder

__all__ = ["EnvReward", "Infos", "Streams", "reads_infos", "streams_of"]

Info = dict[str, Any]


class Streams:
    """Owners of the streams of a buffer, and infos by episode."""

    def __init__(self) -> None:
        """Nobody's streams."""
        self._owners: dict[int, ref[HindsightRecorder]] = {}
        self.infos: dict[int, list[Info]] = {}

    def claim(self, stream: int, recorder: HindsightRecorder) -> None:
        """From now on the stream is this recorder's."""
        self._owners[stream] = ref(recorder)

    def is_of_another(self, stream: int, recorder: HindsightRecorder) -> bool:
        """Whether another recorder has claimed the stream since this one did."""
        owner = self._owners.get(stream)
        return owner is not None and owner() is not recorder

    def keep(self, episode: int, infos: list[Info], oldest: int) -> None:
        """Keep an episode's infos, and forget those of episodes before `oldest`."""
        self.infos[episode] = infos
        for evicted in [number for number in self.infos if number < oldest]:
            del self.infos[evicted]


_STREAMS: WeakKeyDictionary[EpisodeBuffer, Streams] = WeakKeyDictionary()


def streams_of(buffer: EpisodeBuffer) -> Streams:
    """What the recorders of this buffer share."""
    return _STREAMS.setdefault(buffer, Streams())


def copied(info: Info) -> Info:
    """An info as it is now, whatever the environment does to its dictionary and arrays later."""
    return {key: part.copy() if isinstance(part, np.ndarray) else part for key, part in info.items()}


class Infos(Sequence[Info]):
    """The infos of a batch's steps: a sequence of dictionaries; `infos["key"]` is the array of an entry."""

    def __init__(self, kept: dict[int, list[Info]], ids: NDArray[np.int64], steps: NDArray[np.int64]) -> None:
        """Of step `steps[i]` of episode `ids[i]`, each; what is before the first step is the first."""
        self._kept = kept
        self._places = list(zip(ids.tolist(), np.maximum(steps, 0).tolist(), strict=True))

    def __len__(self) -> int:
        """Steps."""
        return len(self._places)

    @overload
    def __getitem__(self, which: int) -> Info: ...
    @overload
    def __getitem__(self, which: slice) -> list[Info]: ...
    @overload
    def __getitem__(self, which: str) -> NDArray[Any]: ...
    def __getitem__(self, which: int | slice | str) -> Any:
        """One info, several, or an entry of all as an array.

        Raises:
            EpisodeError: For a step whose info nobody kept.
        """
        if isinstance(which, str):
            return np.array([info[which] for info in self])
        if isinstance(which, slice):
            return [self._info(*place) for place in self._places[which]]
        return self._info(*self._places[which])

    def __iter__(self) -> Iterator[Info]:
        """One after the other."""
        return (self._info(*place) for place in self._places)

    def get(self, key: str, default: Any = None) -> NDArray[Any]:
        """An entry of all, as an array, with `default` where an info has none."""
        return np.array([info.get(key, default) for info in self])

    def _info(self, episode: int, step: int) -> Info:
        if episode not in self._kept:
            raise EpisodeError(
                f"episode {episode}: expected the infos that compute_reward reads, found none: "
                "a buffer stores none; a recorder keeps them beside it where it is made with infos=True"
            )
        return self._kept[episode][step]


class EnvReward:
    """An environment's `compute_reward`, as `sample_transitions(reward=...)` takes it."""

    by_step = True
    """Samplers hand ids and steps over too."""

    def __init__(self, compute: Callable[..., Any], buffer: EpisodeBuffer) -> None:
        """Of an environment whose steps the buffer holds."""
        self._compute = compute
        self._kept = streams_of(buffer).infos

    def __call__(
        self,
        achieved: NDArray[Any],
        goals: NDArray[Any],
        ids: NDArray[np.int64] | None = None,
        steps: NDArray[np.int64] | None = None,
    ) -> NDArray[Any]:
        """Rewards of steps, in one call of the environment's function.

        Args:
            achieved: What each step reached, [n, *goal], or [n, W, *goal] of windows.
            goals: The goals, of the same shape.
            ids: Episode of each step, int64 [n] or [n, W]; None: no infos are to be read.
            steps: Number of each step, of the same shape; -1 beyond the end of a window.

        Raises:
            EpisodeError: Where the function reads an info that nobody kept.
        """
        if ids is None or steps is None:
            ids = steps = np.full(len(achieved), -1)
        flat = ids.size, *achieved.shape[ids.ndim :]
        infos = Infos(self._kept, ids.ravel(), steps.ravel())
        rewards = self._compute(achieved.reshape(flat), goals.reshape(flat), infos)
        return np.asarray(rewards).reshape(ids.shape) if np.size(rewards) == ids.size else rewards


class _WasReadError(Exception):
    """Says of an info that it was read."""


class _Spy(Infos):
    """An info that says when it is read."""

    def __init__(self) -> None:
        """Of one step."""
        super().__init__({}, np.zeros(1, np.int64), np.zeros(1, np.int64))

    def _info(self, episode: int, step: int) -> Info:
        raise _WasReadError


def reads_infos(compute: Callable[..., Any], achieved: NDArray[Any], goal: NDArray[Any]) -> bool:
    """Whether `compute_reward` reads the info of a step, seen by asking it about one."""
    try:
        compute(achieved[None], goal[None], _Spy())
    except _WasReadError:
        return True
    except Exception:  # whatever it is, a batch will say so where it can be told
        return False
    return False
