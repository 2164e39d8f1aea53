"""``vhs train --processes N``: the ranks of one machine, started and ended by torch's own launcher."""

from __future__ import annotations

import logging
import signal
import sys
from collections.abc import Sequence

from torch.distributed.elastic.multiprocessing import SignalException
from torch.distributed.elastic.multiprocessing.errors import ChildFailedError
from torch.distributed.launcher.api import LaunchConfig, elastic_launch

from vhs.errors import PeerError, ToldError

STOPPED = 130
"""Exit status of a training that a signal has stopped and that was saved."""


def one_machine(processes: int) -> LaunchConfig:
    """How so many ranks of one machine find each other; nobody starts one anew."""
    return LaunchConfig(
        min_nodes=1,
        max_nodes=1,
        nproc_per_node=processes,
        run_id="vhs",
        rdzv_backend="c10d",
        rdzv_endpoint="localhost:0",
        max_restarts=0,
        monitor_interval=0.1,
    )


def launch(processes: int, arguments: Sequence[str]) -> int:
    """Run ``vhs ARGUMENTS`` as so many ranks, until all have ended.

    Args:
        processes: how many.
        arguments: of the command line; each rank knows from its environment that it is one.

    Returns:
        The exit status: 0, or 130 where a signal stopped them.

    Raises:
        PeerError: a rank was killed.
        ToldError: a rank failed, and has said why.
    """
    # What torch's agent would say of its work is for whoever wrote it; what happened is said below.
    logging.getLogger("torch.distributed.elastic").setLevel(logging.CRITICAL)
    ranks = ["-m", "vhs", *arguments]
    try:
        elastic_launch(one_machine(processes), sys.executable)(*ranks)
    except SignalException:
        return STOPPED
    except ChildFailedError as error:
        rank, failure = error.get_first_failure()
        if failure.exitcode == STOPPED:
            return STOPPED
        if failure.exitcode < 0:
            name = signal.Signals(-failure.exitcode).name
            raise PeerError(f"rank {rank} was ended by {name}; the same command resumes") from None
        raise ToldError(f"rank {rank} failed") from None
    return 0
