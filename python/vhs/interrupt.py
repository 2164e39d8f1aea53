"""Stopping between two steps instead of in the middle of one."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

_HANG_UP = getattr(signal, "SIGHUP", None)
"""A terminal or connection that is gone; Windows has none."""
_KINDS = [kind for kind in (signal.SIGINT, signal.SIGTERM, _HANG_UP) if kind is not None]


@dataclass(slots=True)
class StopRequest:
    """Whether someone asked the run to stop, and by which signal."""

    signal_name: str = ""

    @property
    def is_set(self) -> bool:
        """Whether the run should save and end."""
        return bool(self.signal_name)


@contextmanager
def stop_on_signal() -> Iterator[StopRequest]:
    """Turn the first Ctrl-C, SIGTERM or SIGHUP into a request; the second one acts as it always does.

    A hang-up that is ignored, as under ``nohup``, stays ignored. Outside the main thread Python delivers no
    signals, so there the request is never set.
    """
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    before = {kind: signal.getsignal(kind) for kind in _KINDS}
    if before.get(_HANG_UP) == signal.SIG_IGN:
        del before[_HANG_UP]

    def ask(number: int, frame: FrameType | None) -> None:
        request.signal_name = signal.Signals(number).name
        signal.signal(number, before[signal.Signals(number)])

    for kind in before:
        signal.signal(kind, ask)
    try:
        yield request
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
