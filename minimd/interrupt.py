"""Ctrl-C between steps: the first one stops a run at the end of a step, the second one at once."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Protocol


class Stoppable(Protocol):
    """Something that looks at a flag between its steps."""

    stop_requested: bool


@contextmanager
def stop_on_interrupt(run: Stoppable) -> Iterator[None]:
    """While active, Ctrl-C sets run.stop_requested instead of raising; outside the main thread nothing is changed."""
    run.stop_requested = False
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.getsignal(signal.SIGINT)

    def request_stop(_number: int, _frame: FrameType | None) -> None:
        run.stop_requested = True
        signal.signal(signal.SIGINT, previous)

    signal.signal(signal.SIGINT, request_stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
