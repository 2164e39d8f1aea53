"""Real processes that train the debug configuration together, as a launcher would start them."""

import multiprocessing
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import torch._dynamo  # an optimiser imports it, for seconds: forked ranks find it there
from debug import DEBUG

from vhs.cli import main
from vhs.runs.checkpoint import load_checkpoint

PATIENCE_S = 90
"""For what takes seconds on a quiet machine."""
TRAIN = ["train", "--config", str(DEBUG), "--set", "env.num_workers=0", "--set", "env.num_envs=3"]
VHS = ["-m", "vhs"]


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


class Rank:
    """A process that is one of several ranks, forked: so it need not import torch, which takes seconds."""

    def __init__(
        self, rank: int, size: int, port: int, arguments: Sequence[str], prepare: Callable[[], None]
    ) -> None:
        self._out, self._errors = (tempfile.TemporaryFile("w+") for _ in range(2))  # noqa: SIM115
        told = {
            "RANK": str(rank),
            "LOCAL_RANK": str(rank),
            "WORLD_SIZE": str(size),
            "MASTER_ADDR": "127.0.0.1",
            "MASTER_PORT": str(port),
            "GLOO_SOCKET_IFNAME": "lo",  # wherever the host's name leads
            "COLUMNS": "300",
        }
        files = (self._out, self._errors)
        context = multiprocessing.get_context("fork")
        self.process = context.Process(target=_become, args=(told, arguments, prepare, files))
        self.process.start()

    def ended(self) -> tuple[int, str, str]:
        """Wait for its end: status, output and errors."""
        self.process.join(PATIENCE_S)
        if self.process.exitcode is None:
            self.process.kill()
            self.process.join()
        texts = []
        for file in (self._out, self._errors):
            file.seek(0)
            texts.append(file.read())
            file.close()
        assert self.process.exitcode is not None
        return self.process.exitcode, texts[0], texts[1]


def _become(
    told: Mapping[str, str], arguments: Sequence[str], prepare: Callable[[], None], files: Sequence[Any]
) -> None:
    """The command line in this process, as if it had been started by a launcher."""
    for file, number in zip(files, (1, 2), strict=True):
        os.dup2(file.fileno(), number)
    sys.stdout, sys.stderr = (os.fdopen(number, "w", closefd=False) for number in (1, 2))
    os.environ |= told
    prepare()
    sys.exit(main(arguments))


def nothing() -> None:
    """Leave a process as it is."""


def start(*arguments: Sequence[str], prepare: Sequence[Callable[[], None]] = ()) -> list[Rank]:
    """A rank for each list of arguments; each is prepared first."""
    port, size = free_port(), len(arguments)
    first = prepare or [nothing] * size
    return [Rank(rank, size, port, own, first[rank]) for rank, own in enumerate(arguments)]


def together(
    *arguments: Sequence[str], prepare: Sequence[Callable[[], None]] = ()
) -> list[tuple[int, str, str]]:
    """As `start`, until all have ended: status, output and errors of each."""
    return [rank.ended() for rank in start(*arguments, prepare=prepare)]


def torchrun(arguments: Sequence[str], *options: str) -> subprocess.Popen[str]:
    """Two ranks under torch's launcher."""
    launcher = ["-m", "torch.distributed.run", "--nproc-per-node", "2", "--monitor-interval", "0.2"]
    endpoint = f"--rdzv-endpoint=127.0.0.1:{free_port()}"
    command = [sys.executable, *launcher, "--rdzv-backend=c10d", endpoint, "--local-addr=127.0.0.1", *options]
    return subprocess.Popen(
        [*command, *VHS, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"COLUMNS": "300", "GLOO_SOCKET_IFNAME": "lo"},
    )


def launched(arguments: Sequence[str]) -> subprocess.Popen[str]:
    """The command line in a process of its own that is no rank."""
    return subprocess.Popen(
        [sys.executable, *VHS, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"COLUMNS": "300", "GLOO_SOCKET_IFNAME": "lo"},
    )


def wait_for(holds: Callable[[], Any], process: subprocess.Popen[str] | None = None) -> Any:
    """Wait until something holds; what it found."""
    end = time.monotonic() + PATIENCE_S
    while not (found := holds()):
        assert time.monotonic() < end, "it never came"
        if process is not None and process.poll() is not None:
            raise AssertionError(f"the process has ended: {process.communicate()}")
        time.sleep(0.02)
    return found


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def is_alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def newest(run: Path) -> int:
    saved = sorted((run / "checkpoints").glob("episode-*"))
    return int(saved[-1].name.removeprefix("episode-")) if saved else -1


def differences(a: Any, b: Any, where: str = "") -> list[str]:
    """Places where two states differ."""
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        return [found for key in a for found in differences(a[key], b[key], f"{where}/{key}")]
    if isinstance(a, list | tuple) and isinstance(b, list | tuple) and len(a) == len(b):
        pairs = enumerate(zip(a, b, strict=True))
        return [found for i, pair in pairs for found in differences(*pair, f"{where}/{i}")]
    if isinstance(a, torch.Tensor) and isinstance(b, torch.Tensor):
        return [] if a.dtype == b.dtype and torch.equal(a, b) else [where]
    return [] if type(a) is type(b) and a == b else [where]


def state_of(run: Path) -> dict[str, Any]:
    """The newest checkpoint, but for the wall-clock."""
    state, _ = load_checkpoint(run)
    return state | {"progress": state["progress"] | {"seconds": 0}}
