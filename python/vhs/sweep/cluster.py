"""A Ray cluster as the place of a sweep: every job is a task, a process on the node that Ray chooses."""

from __future__ import annotations

import logging
import os
import socket
import uuid
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vhs.distribution import pip_install
from vhs.errors import ConfigError
from vhs.sweep.node import Site, work

_CONNECT_S = 10.0
_CHECK_S = 120.0
"""For a node to start a first worker, which imports the package from a disk of the network."""
_KILL_S = 10.0


class RayPlace:
    """The cores of a cluster; Ray decides which node has a job."""

    def __init__(self, address: str, jobs: int | None) -> None:
        """Connect to a cluster.

        Args:
            address: as `ray.init` takes it: ``auto``, ``host:port``; ``local`` makes one of this machine.
            jobs: runs side by side, each on an equal share of the cores that there are now; None takes a core
                a run, and as many runs as there are cores at any time.

        Raises:
            ConfigError: no Ray, no cluster, or one without cores.
        """
        self._ray = _connect(address)
        self._address = address
        self._limit = jobs
        sizes = [size for _, size in self._nodes()]
        if not sizes:
            self.leave()
            raise ConfigError(f"--ray {address}: expected a cluster with cores, found none")
        self._cores_per_run = 1 if jobs is None else max(1, min(max(sizes), sum(sizes) // jobs))
        # A task that dies is a failed run, as a process that dies is here: the same command goes on with it.
        self._work = self._ray.remote(num_cpus=self._cores_per_run, max_retries=0)(work)
        self._jobs: list[_RayJob] = []
        self._site = Site(Path(), Path(), "")

    @property
    def cores_per_run(self) -> int:
        """Cores that Ray keeps for a run, all on one node."""
        return self._cores_per_run

    @property
    def has_room(self) -> bool:
        """Whether there are cores, or a number of runs side by side was given: Ray lets more of them wait."""
        self._jobs = [job for job in self._jobs if not job.is_over]
        limit = self._limit
        if limit is None:
            limit = sum(size // self._cores_per_run for _, size in self._nodes())
        return len(self._jobs) < limit

    def settle(self, directory: Path, lock: int) -> None:
        """Check that every node sees the sweep; one that joins later is checked by its first job.

        Raises:
            ConfigError: one does not.
        """
        from ray.exceptions import GetTimeoutError, RayError, TaskUnschedulableError
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        self._site = _mark(directory, lock)
        checks = []
        for node, size in self._nodes():
            if size >= self._cores_per_run:
                there = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
                check = self._ray.remote(num_cpus=0, scheduling_strategy=there)(Site.what_is_missing)
                checks.append((node["NodeManagerHostname"], check.remote(self._site)))
        for name, check in checks:
            try:
                missing = self._ray.get(check, timeout=_CHECK_S)
            except GetTimeoutError:
                missing = f"node {name}: expected an answer within {_CHECK_S:.0f} s, found none"
            except TaskUnschedulableError:
                continue  # it has left meanwhile
            except RayError as error:
                missing = f"node {name}: cannot run vhs: {_in_short(error)}"
            if missing:
                raise ConfigError(f"--ray {self._address}: {missing}")

    def start(self, arguments: Sequence[str], log: Path) -> _RayJob:
        """Hand a job to Ray."""
        log.open("ab").close()  # what cannot be written here cannot be there
        reference = self._work.remote(self._site, list(arguments), log.absolute())
        self._jobs.append(_RayJob(self._ray, reference))
        return self._jobs[-1]

    def leave(self) -> None:
        """Disconnect; a cluster that was started here ends."""
        self._ray.shutdown()

    def _nodes(self) -> list[tuple[dict[str, Any], int]]:
        """The nodes that have cores, with how many."""
        nodes = [node for node in self._ray.nodes() if node["Alive"]]
        sizes = [int(node["Resources"].get("CPU", 0)) for node in nodes]
        return [(node, size) for node, size in zip(nodes, sizes, strict=True) if size > 0]


@dataclass(slots=True)
class _RayJob:
    """A task of the cluster."""

    ray: Any
    reference: Any
    is_over: bool = False
    """Whether whoever polls has seen its end."""

    def poll(self) -> str | None:
        from ray.exceptions import RayError, TaskCancelledError

        if not self._is_ready(0.0):
            return None
        self.is_over = True
        try:
            return str(self.ray.get(self.reference))
        except TaskCancelledError:
            return "stopped before it began"
        except RayError as error:
            return f"its Ray task died: {_in_short(error)}"

    def stop(self) -> None:
        self.ray.cancel(self.reference)

    def kill(self) -> None:
        if not self._is_ready(0.0):
            self.ray.cancel(self.reference, force=True)
            self._is_ready(_KILL_S)

    def _is_ready(self, timeout_s: float) -> bool:
        return bool(self.ray.wait([self.reference], timeout=timeout_s)[0])


def _connect(address: str) -> Any:
    """Ray, connected.

    Raises:
        ConfigError: it is not installed, or there is no such cluster.
    """
    try:
        import ray
    except ModuleNotFoundError:
        raise ConfigError(f"--ray: ray is not installed; {pip_install('ray')}") from None
    where = f"--ray {address}: expected auto, local or the address of a Ray cluster"
    host, _, port = address.rpartition(":")
    if host and port.isdecimal() and "/" not in host:
        # Ray itself tries for minutes, and then ends the process.
        try:
            socket.create_connection((host, int(port)), timeout=_CONNECT_S).close()
        except (OSError, OverflowError) as error:
            raise ConfigError(f"{where}, found nobody there: {error}") from None
    dashboard = False if address == "local" else None
    try:
        ray.init(address, log_to_driver=False, logging_level=logging.ERROR, include_dashboard=dashboard)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise ConfigError(f"{where}, found {_in_short(error)}") from None
    return ray


def _mark(directory: Path, lock: int) -> Site:
    """Write into the lock file, which is held, who holds it."""
    from vhs.runs.directory import LOCK_NAME

    token = uuid.uuid4().hex
    os.ftruncate(lock, 0)
    os.pwrite(lock, token.encode(), 0)
    os.fsync(lock)
    return Site(Path.cwd(), directory.absolute() / LOCK_NAME, token)


def _in_short(error: BaseException) -> str:
    """What an error of Ray says in one line; of one that a task raised, that is its last."""
    cause = getattr(error, "cause", None)
    with suppress(IndexError):
        return str(cause or error).strip().splitlines()[0]
    return type(error).__name__
