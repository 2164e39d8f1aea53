"""Ranks of torch.distributed, as `torchrun` starts them: gloo between CPUs, NCCL between GPUs.

What the launcher says is in the environment: RANK, WORLD_SIZE, LOCAL_RANK, MASTER_ADDR and MASTER_PORT. Texts
and states pass as bytes that nobody unpickles.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor
from torch.distributed.distributed_c10d import PrefixStore, Store
from torch.distributed.rendezvous import rendezvous

from vhs.errors import ConfigError, DivergenceError, PeerError, ToldError, VhsError
from vhs.world.world import ALONE, World

JOIN_S = 300.0
"""How long ranks wait for each other to join."""
_HEAD = 8
"""Bytes that say how long a message is."""


def is_rank() -> bool:
    """Whether a launcher has made this process one of several ranks."""
    return "RANK" in os.environ and int(os.environ.get("WORLD_SIZE", "1")) > 1


@contextmanager
def joined() -> Iterator[World]:
    """The world that the launcher of this process has made it a rank of; alone where there is none.

    Raises:
        PeerError: the others did not come, or one of them is gone.
    """
    if not is_rank():
        yield ALONE
        return
    rank = int(os.environ["RANK"])
    _join(rank)
    try:
        yield Ranks()
    except VhsError as error:
        if rank == 0 or isinstance(error, ToldError):
            raise
        if isinstance(error, PeerError | DivergenceError):  # the same everywhere
            raise ToldError(str(error)) from error
        raise PeerError(f"rank {rank} ({socket.gethostname()}): {error}") from error
    finally:
        dist.destroy_process_group()


class Ranks(World):
    """The ranks of the default process group."""

    def __init__(self) -> None:
        """Join them; they have been initialised."""
        self.rank, self.size = dist.get_rank(), dist.get_world_size()
        self._group: Any = None
        self._patience_s = JOIN_S
        self._launcher = os.getppid() if "TORCHELASTIC_RUN_ID" in os.environ else None
        self._share_cores()

    @property
    def is_orphan(self) -> bool:
        """Whether `torchrun` was killed, and so could not end this process."""
        return self._launcher not in (None, os.getppid())

    def set_patience(self, seconds: float) -> None:
        """How long a rank is waited for in any later meeting."""
        with self._meeting():
            self._group = dist.new_group(timeout=timedelta(seconds=seconds))
        self._patience_s = seconds

    def device(self, name: str) -> str:
        """The GPU of the local rank, where a GPU is meant and none is named."""
        if name not in ("auto", "cuda") or not torch.cuda.is_available():
            return name
        local, there = int(os.environ.get("LOCAL_RANK", self.rank)), torch.cuda.device_count()
        if local >= there:
            here = os.environ.get("LOCAL_WORLD_SIZE", local + 1)
            raise ConfigError(
                f"train.device: expected a GPU for each of the {here} processes of this host, found {there}; "
                "start fewer, or --set train.device=cpu"
            )
        torch.cuda.set_device(local)
        return f"cuda:{local}"

    def average(
        self,
        tensors: Sequence[Tensor],
        along: Sequence[Tensor] = (),
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        """One flat sum; the first tensors are then divided by the number of ranks."""
        device, every = tensors[0].device, [*tensors, *along]
        flat = torch.cat([one.detach().to(device, torch.float32).reshape(-1) for one in every])
        with self._meeting():
            sum_under_way = dist.all_reduce(flat, group=self._group, async_op=True)
        meanwhile()
        with self._meeting():
            sum_under_way.wait()
        flat[: sum(one.numel() for one in tensors)].div_(self.size)
        with torch.no_grad():
            for one, part in zip(every, torch.split(flat, [one.numel() for one in every]), strict=True):
                one.copy_(part.view(one.shape))

    def share(self, data: bytes, most: int | None = None) -> list[bytes]:
        """Every rank's bytes, padded to those of the longest."""
        mine = self._padded(data, most)
        found = [torch.empty_like(mine) for _ in range(self.size)]
        with self._meeting():
            dist.all_gather(found, mine, group=self._group)
        return [_unpadded(one) for one in found]

    def gather(self, data: bytes) -> list[bytes]:
        """Every rank's bytes at rank 0, padded to those of the longest."""
        mine = self._padded(data)
        found = [torch.empty_like(mine) for _ in range(self.size)] if not self.rank else []
        with self._meeting():
            dist.gather(mine, found or None, dst=0, group=self._group)
        return [_unpadded(one) for one in found]

    @contextmanager
    def together(self) -> Iterator[None]:
        """Exchange who failed once all are through."""
        failure: VhsError | None = None
        try:
            yield
        except VhsError as error:
            failure = error
        told = json.dumps([socket.gethostname(), None if failure is None else str(failure)])
        found = [json.loads(one) for one in self.share(told.encode())]
        if all(said is None for _, said in found):
            return
        if self.rank:
            raise ToldError("another rank failed") from failure
        if failure is not None:
            raise failure
        raise PeerError(next(f"rank {r} ({host}): {said}" for r, (host, said) in enumerate(found) if said))

    def expect_equal(self, facts: Mapping[str, Any]) -> None:
        """Exchange the facts as JSON."""
        said = json.dumps([socket.gethostname(), dict(facts)], default=str)
        (_, expected), *others = (json.loads(one) for one in self.share(said.encode()))
        for rank, (host, found) in enumerate(others, 1):
            keys = sorted(
                key for key in expected.keys() | found.keys() if expected.get(key) != found.get(key)
            )
            if keys:
                differ = "; ".join(
                    f"{key}: expected {expected.get(key)} as rank 0 has it, found {found.get(key)}"
                    for key in keys
                )
                raise PeerError(f"rank {rank} ({host}): {differ}")

    def _padded(self, data: bytes, most: int | None = None) -> Tensor:
        """A message as long as the longest of all ranks."""
        if most is None:
            longest = torch.tensor([len(data)])
            with self._meeting():
                dist.all_reduce(longest, dist.ReduceOp.MAX, group=self._group)
            most = int(longest.item())
        whole = (len(data).to_bytes(_HEAD, "little") + data).ljust(_HEAD + most, b"\0")
        return torch.frombuffer(bytearray(whole), dtype=torch.uint8)

    @contextmanager
    def _meeting(self) -> Iterator[None]:
        """Say of a meeting that failed what it means."""
        try:
            yield
        except RuntimeError as error:
            raise PeerError(
                f"another process of this training is gone, or has not answered for {self._patience_s:g} s; "
                f"start all of them again, they go on from the newest checkpoint ({_reason(error)})"
            ) from error

    def _share_cores(self) -> None:
        """Keep to this rank's share of the cores that several ranks of a host were given alike."""
        if not hasattr(os, "sched_getaffinity"):
            return
        cores = sorted(os.sched_getaffinity(0))
        mine = json.dumps([socket.gethostname(), cores]).encode()
        alike = [rank for rank, one in enumerate(self.share(mine)) if one == mine]
        each = len(cores) // len(alike)
        if each:
            first = each * alike.index(self.rank)
            os.sched_setaffinity(0, cores[first : first + each])


def _join(rank: int) -> None:
    """Meet the others.

    Raises:
        PeerError: they did not come in time.
    """
    backend = "cpu:gloo,cuda:nccl" if torch.cuda.is_available() and dist.is_nccl_available() else "gloo"
    limit, size = timedelta(seconds=JOIN_S), int(os.environ["WORLD_SIZE"])
    try:
        store, *_ = next(rendezvous("env://", timeout=limit))
        store.set_timeout(limit)
        ours = PrefixStore(_agree_on_name(store, rank, size), store)
        dist.init_process_group(backend, store=ours, rank=rank, world_size=size, timeout=limit)
    except (RuntimeError, TimeoutError, ValueError) as error:
        where = ":".join(os.environ.get(name, "?") for name in ("MASTER_ADDR", "MASTER_PORT"))
        raise PeerError(
            f"rank {rank}: expected {size} processes at {where} within {JOIN_S:g} s, found fewer "
            f"({_reason(error)})"
        ) from error


def _agree_on_name(store: Store, rank: int, size: int) -> str:
    """A name of this start of the ranks, which rank 0 chooses and each of the others asks for.

    The store of `torchrun` outlives its ranks: after a restart it still has the addresses of those before,
    which torch would take for the new ones (https://github.com/pytorch/pytorch/issues/135712). An answer to
    the question of a process that has ended is read by nobody.
    """
    name = secrets.token_hex(8)
    if rank:
        store.set(f"vhs/asks/{rank}", name)
        answer: str = store.get(f"vhs/answer/{name}").decode()
        store.set(f"vhs/heard/{answer}/{rank}", "")
        return answer
    answered: dict[int, bytes] = dict.fromkeys(range(1, size), b"")
    end = time.monotonic() + JOIN_S
    while answered:
        for other in list(answered):
            asks = f"vhs/asks/{other}"
            if store.check([asks]) and (question := store.get(asks)) != answered[other]:
                store.set(f"vhs/answer/{question.decode()}", name)
                answered[other] = question
            if store.check([f"vhs/heard/{name}/{other}"]):
                del answered[other]
        if time.monotonic() > end:
            raise TimeoutError(f"nothing was heard of ranks {', '.join(map(str, answered))}")
        time.sleep(0.02)
    return name


def _unpadded(message: Tensor) -> bytes:
    data = message.numpy().tobytes()
    return data[_HEAD : _HEAD + int.from_bytes(data[:_HEAD], "little")]


def _reason(error: BaseException) -> str:
    """The first sentence of what torch says, without the place in its source."""
    return re.sub(r"\[\S*\.cc:\d+\] ", "", str(error)).splitlines()[0].partition(". ")[0]
