"""Where a run meets its user: the progress bar, Ctrl-C between steps, the line that a warning points to."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Protocol

from minimd.structure.checks import checked_flag

TENTHS = 10


@contextmanager
def progress_of(n_steps: int, label: str, show: bool | None = None) -> Iterator[Callable[[int], Any]]:
    """Show on standard error how much of n_steps is done; yields a function to be called with the number of steps made.

    show : True for a bar on a terminal and ten lines elsewhere; False for nothing; None for a bar on a terminal only. Raises ValueError for
        anything else.
    """
    if show is not None:
        checked_flag("progress", show)
    is_terminal, told = sys.stderr is not None and sys.stderr.isatty(), 0

    def tell_tenths(done: int) -> None:
        nonlocal told
        if show and done * TENTHS // n_steps > told:
            told = done * TENTHS // n_steps
            print(f"{label}: step {done} of {n_steps}", file=sys.stderr, flush=True)

    if show is False or not is_terminal:
        yield tell_tenths
        return
    from tqdm import tqdm

    with tqdm(total=n_steps, desc=label, unit="step", unit_scale=True, file=sys.stderr) as bar:
        yield lambda done: bar.update(done - bar.n)


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


def outside_minimd() -> int:
    """The stacklevel, for a warning of the calling function, of the first frame outside minimd and contextlib."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in ("minimd", "contextlib"):
        frame, level = frame.f_back, level + 1
    return level
