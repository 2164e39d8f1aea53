"""The least that any scheduler pays: shared memory, a byte a worker, `sched_yield`, and nothing else.

No sleeping, no deaths, no seeds, no infos; pure waiting by yielding. It is what `bench_rollout.py` measures
against, and what collapses once somebody else wants the cores.
"""

from __future__ import annotations

import mmap
import multiprocessing
import os
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

IDLE, ASKED, DONE, LEAVE = range(4)


class RawLoop:
    """Environments in worker processes that yield until their byte says that there is something to do."""

    def __init__(
        self, env_fn: Callable[[], gymnasium.Env[Any, Any]], workers: int, each: int, shape: tuple[int, ...]
    ) -> None:
        """Start the workers; `shape` is that of one uint8 observation."""
        size = int(np.prod(shape))
        self._flags = np.frombuffer(mmap.mmap(-1, 4096), np.uint8)
        self._slots = np.frombuffer(mmap.mmap(-1, workers * each * size), np.uint8).reshape(
            workers, each, *shape
        )
        self._batch = np.zeros((workers, each, *shape), np.uint8)
        self._workers, self._each = workers, each
        context = multiprocessing.get_context("fork")
        self._processes = [
            context.Process(target=self._work, args=(env_fn, worker), daemon=True)
            for worker in range(workers)
        ]
        for process in self._processes:
            process.start()
        self._flags[:workers] = ASKED

    def _work(self, env_fn: Callable[[], gymnasium.Env[Any, Any]], worker: int) -> None:
        os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[worker % os.cpu_count()]})  # type: ignore[operator]
        envs = [env_fn() for _ in range(self._each)]
        flags, slots = self._flags, self._slots[worker]
        while True:
            while flags[worker] != ASKED:
                if flags[worker] == LEAVE:
                    return
                os.sched_yield()
            for slot, env in zip(slots, envs, strict=True):
                np.copyto(slot, env.step(0)[0])
            flags[worker] = DONE

    def run(self, steps: int) -> int:
        """Take at least `steps` steps and return how many it were."""
        flags, done = self._flags, 0
        while done < steps:
            found = False
            for worker in range(self._workers):
                if flags[worker] == DONE:
                    found = True
                    np.copyto(self._batch[worker], self._slots[worker])
                    flags[worker] = ASKED
                    done += self._each
            if not found:
                os.sched_yield()
        return done

    def close(self) -> None:
        """End the workers."""
        self._flags[: self._workers] = LEAVE
        for process in self._processes:
            # One that was in a step overwrites the byte with DONE.
            while process.is_alive():
                self._flags[: self._workers] = LEAVE
                process.join(0.01)
