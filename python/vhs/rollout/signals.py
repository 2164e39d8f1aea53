"""Work that no signal handler interrupts."""

from __future__ import annotations

import _thread
import threading
from collections.abc import Callable


def undisturbed(work: Callable[[], None]) -> None:
    """Do work that must be done as a whole, such as to replace a process.

    Handlers of signals run in the main thread alone and may raise between any two calls there, as Ctrl-C
    does. So the work is done in a thread of its own, and what a handler raised meanwhile is raised once the
    work is done.

    Raises:
        BaseException: what the work raised, or else what a handler raised.
    """
    if threading.current_thread() is not threading.main_thread():
        work()
        return
    turns: list[None] = [None]
    is_done = threading.Event()
    raised: list[BaseException] = []

    def run() -> None:
        try:
            turns.pop()
        except IndexError:
            return  # the thread was started twice: whether the first start had come to pass could not be seen
        try:
            work()
        except BaseException as error:
            raised.append(error)
        is_done.set()

    interrupt: BaseException | None = None
    while not is_done.is_set():
        try:
            if turns:
                _thread.start_new_thread(run, ())
            is_done.wait()
        except BaseException as error:
            interrupt = error
    if raised:
        raise raised[0]
    if interrupt is not None:
        raise interrupt
