"""Batches as tensors, drawn ahead of the learner by a thread; for a `DataLoader` or a plain loop."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch.utils.data import IterableDataset, get_worker_info

from vhs._core import ArgumentError
from vhs.adapters.batches import arrays_of

__all__ = ["Batches", "tensors_of"]

Tensors = Any
"""A tensor, or a dictionary of tensors and such dictionaries."""


def tensors_of(batch: Any) -> Tensors:
    """A batch as tensors that share its memory.

    Args:
        batch: As for `vhs.adapters.batches.arrays_of`, such as `buffer.sample_transitions(256)`, which
            becomes {"observations": uint8 [256, ...], "actions": int64 [256], ...}.
    """
    return _mapped(torch.from_numpy, arrays_of(batch))


class Batches(IterableDataset[Tensors]):
    """Batches without end, each drawn while the learner still learns from the one before.

        for batch in Batches(lambda: buffer.sample_transitions(256, "future"), device="cuda"):
            ...

    Every iteration has a thread of its own, which ends with it. It draws `ahead` batches more than are taken,
    in the order of the calls: what is recorded meanwhile is seen that much later, and how much depends on the
    machine; a run that is to repeat bit by bit draws itself. Where a `DataLoader` forks workers
    (`DataLoader(Batches(...), batch_size=None, num_workers=2)`), each draws from its copy of the buffer as it
    was when the loader's iteration began, and no two the same.
    """

    def __init__(
        self,
        draw: Callable[[], Any],
        *,
        count: int | None = None,
        ahead: int = 2,
        device: torch.device | str | None = None,
        pin_memory: bool | None = None,
    ) -> None:
        """A data set.

        Args:
            draw: Returns a batch, as `tensors_of` takes it; called by the thread.
            count: Batches of an iteration, which the workers of a loader share; None: without end.
            ahead: Batches drawn before they are asked for, at least 1.
            device: Where tensors go, from pinned memory where that is a GPU and while the learner computes;
                None: they stay. Not in workers.
            pin_memory: Whether they are put into pinned memory; None: where `device` is a GPU.

        Raises:
            ArgumentError: For a number out of range.
        """
        if ahead < 1:
            raise ArgumentError(f"`ahead`: expected at least 1, got {ahead}")
        if count is not None and count < 0:
            raise ArgumentError(f"`count`: expected at least 0, got {count}")
        self.draw = draw
        self.count = count
        self.ahead = ahead
        self.device = None if device is None else torch.device(device)
        is_gpu = self.device is not None and self.device.type == "cuda"
        self.pin_memory = is_gpu if pin_memory is None else pin_memory

    def __iter__(self) -> Iterator[Tensors]:
        """Draw.

        Raises:
            ArgumentError: For a device in a worker of a loader.
            Exception: What `draw` raised, in its turn.
        """
        worker, count = get_worker_info(), self.count
        if worker is not None:
            if self.device is not None and self.device.type != "cpu":
                raise ArgumentError(
                    f"`device`: expected None in a worker of a loader, got {self.device}: a worker has no "
                    "GPU; use the loader's pin_memory=True and move its batches"
                )
            if count is not None:
                count = len(range(worker.id, count, worker.num_workers))
        return _Ahead(self, count).batches()

    def ready(self) -> Tensors:
        """One batch, drawn now, where `device` wants it."""
        tensors = tensors_of(self.draw())
        if self.pin_memory:
            tensors = _mapped(torch.Tensor.pin_memory, tensors)
        if self.device is None:
            return tensors
        return _mapped(lambda tensor: tensor.to(self.device, non_blocking=True), tensors)


class _Ahead:
    """One iteration: a thread that draws, and who takes what it drew."""

    def __init__(self, data: Batches, count: int | None) -> None:
        self._data = data
        self._count = count
        self._drawn: queue.Queue[tuple[Any, BaseException | None, Any]] = queue.Queue()
        # The batch that the thread holds is not in the queue yet: so many are drawn beyond those taken.
        self._room = threading.Semaphore(data.ahead)
        self._is_over = False
        is_gpu = data.device is not None and data.device.type == "cuda"
        self._stream = torch.cuda.Stream(data.device) if is_gpu else None  # type: ignore[no-untyped-call]

    def batches(self) -> Iterator[Tensors]:
        thread = threading.Thread(target=self._run, name="vhs-batches", daemon=True)
        thread.start()
        try:
            taken = 0
            while self._count is None or taken < self._count:
                tensors, error, copied = self._drawn.get()
                self._room.release()
                if error is not None:
                    raise error
                self._hand_over(tensors, copied)
                taken += 1
                yield tensors
        finally:
            self._is_over = True
            self._room.release()
            thread.join()

    def _run(self) -> None:
        drawn = 0
        while self._count is None or drawn < self._count:
            self._room.acquire()
            if self._is_over:
                return
            try:
                self._drawn.put(self._draw())
            except BaseException as error:  # it is raised where the batch would have been taken
                self._drawn.put((None, error, None))
                return
            drawn += 1

    def _draw(self) -> tuple[Any, None, Any]:
        if self._stream is None:
            return self._data.ready(), None, None
        with torch.cuda.stream(self._stream):
            return self._data.ready(), None, self._stream.record_event()

    def _hand_over(self, tensors: Tensors, copied: Any) -> None:
        """Let the learner's stream wait for the copy, and the memory wait for the learner."""
        if copied is None:
            return
        stream = torch.cuda.current_stream(self._data.device)
        stream.wait_event(copied)
        _mapped(lambda tensor: tensor.record_stream(stream), tensors)


def _mapped(function: Callable[[Any], Any], value: Any) -> Any:
    """A function of every leaf of nested dictionaries."""
    if isinstance(value, dict):
        return {name: _mapped(function, part) for name, part in value.items()}
    return function(value)
