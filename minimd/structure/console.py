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
SIGNALS = [number for name in ("SIGINT", "SIGTERM", "SIGHUP") if (number := getattr(signal, name, None)) is not None]  # Windows has no SIGHUP
OURS = (signal.SIG_DFL, signal.default_int_handler)  # handlers that nobody has set


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
def stop_on_signals(run: Stoppable) -> Iterator[None]:
    """While active, Ctrl-C, SIGTERM and SIGHUP set run.stop_requested; at the end, SIGTERM and SIGHUP raise SystemExit with 128 + their number.

    Handlers that the host has set, and signals that it ignores, are left alone; so is everything outside the main thread. A second signal acts
    as if there were no run, and so does one that comes when the last step has been made.
    """
    run.stop_requested = False
    received: list[int] = []
    before: dict[int, Any] = {}

    def request_stop(number: int, _frame: FrameType | None) -> None:
        run.stop_requested = True
        received.append(number)
        _restore(before)

    if threading.current_thread() is threading.main_thread():
        before.update({number: handler for number in SIGNALS if (handler := signal.getsignal(number)) in OURS})
        for number in before:
            signal.signal(number, request_stop)
    try:
        yield
    except KeyboardInterrupt as stopped:
        _restore(before)
        if received and received[0] != signal.SIGINT:
            raise Terminated(received[0], str(stopped)) from None
        raise
    finally:
        _restore(before)
    if received:
        signal.raise_signal(received[0])


class Terminated(SystemExit):
    """A run was ended by SIGTERM or SIGHUP, after a whole step. The exit code is 128 + the number of the signal, as shells have it."""

    def __init__(self, number: int, words: str) -> None:
        super().__init__(128 + number)
        self.words = f"{words} by {signal.Signals(number).name}"

    def __str__(self) -> str:
        return self.words


def _restore(handlers: dict[int, Any]) -> None:
    for number, handler in handlers.items():
        signal.signal(number, handler)


def outside_minimd() -> int:
    """The stacklevel, for a warning of the calling function, of the first frame outside minimd and contextlib."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in ("minimd", "contextlib"):
        frame, level = frame.f_back, level + 1
    return level
