"""Where a run meets its user: the progress bar, Ctrl-C between steps, the line that a warning points to."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Protocol

TENTHS = 10


class Progress:
    """Shows how much of n_steps is done, on standard error.

    show : True for a bar on a terminal and ten lines elsewhere; False for nothing; None for a bar on a terminal only.
    """

    def __init__(self, n_steps: int, label: str, show: bool | None = None) -> None:
        terminal = sys.stderr is not None and sys.stderr.isatty()
        self._n_steps, self._label = n_steps, label
        self._lines = bool(show) and not terminal
        self._done = 0
        self._bar = None
        if terminal and show is not False:
            from tqdm import tqdm

            self._bar = tqdm(total=n_steps, desc=label, unit="step", unit_scale=True, file=sys.stderr)

    def advance_to(self, done: int) -> None:
        """The run has made so many steps."""
        if self._bar is not None:
            self._bar.update(done - self._done)
        elif self._lines and done * TENTHS // self._n_steps > self._done * TENTHS // self._n_steps:
            print(f"{self._label}: step {done} of {self._n_steps}", file=sys.stderr, flush=True)
        self._done = done

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.close()


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
