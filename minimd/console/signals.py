"""Signals during a run: Ctrl-C, SIGTERM and SIGHUP stop it between two steps."""

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, Protocol

# Windows has no SIGHUP
SIGNALS = [number for name in ("SIGINT", "SIGTERM", "SIGHUP") if (number := getattr(signal, name, None)) is not None]
# handlers that nobody has set; the command `minimd` adds its own
DEFAULT_HANDLERS: list[Any] = [signal.SIG_DFL, signal.default_int_handler]


class Stoppable(Protocol):
    """Something that checks a flag between its steps."""

    stop_requested: bool


@contextmanager
def stop_on_signals(run: Stoppable) -> Iterator[None]:
    """While active, Ctrl-C, SIGTERM and SIGHUP set run.stop_requested; at the end, SIGTERM and SIGHUP raise Terminated,
    and Ctrl-C KeyboardInterrupt.

    Handlers that the host has set, and signals that it ignores, are left alone. Outside the main thread, where no
    handlers can be set, only stop_runs_of_threads stops a run.

    A second Ctrl-C does not wait for the end of the step. A run inside another one, in an observer, stops first; its
    exception ends the outer one. Python says nothing as it ends by Terminated: a sentence on standard error does,
    unless a caller tells it, see endings_are_told.
    """
    requests = StopRequests(run)
    try:
        with _stopping(requests):
            yield
    except Terminated as ended:
        if requests.is_outermost:
            tell_ending(ended)
        raise


@contextmanager
def _stopping(requests: "StopRequests") -> Iterator[None]:
    """The handlers of stop_on_signals, and its exceptions."""
    try:
        requests.begin()
        yield
    except KeyboardInterrupt as stopped:
        if requests.received and requests.received[0] != signal.SIGINT:
            raise Terminated(requests.received[0], str(stopped), getattr(stopped, "kept", ())) from None
        raise
    finally:
        requests.end()
    if requests.received:
        words = "stopped after the last step"
        raise (
            KeyboardInterrupt(words)
            if requests.received[0] == signal.SIGINT
            else Terminated(requests.received[0], words)
        )


def tell_ending(ended: "Terminated") -> None:
    """Tell on standard error how runs were ended by a signal, unless a caller does."""
    if not _callers and sys.stderr is not None:
        kept = ", ".join(str(file) for file in ended.kept if file.exists())
        print(f"minimd: {ended}{f'; what was written is kept in {kept}' if kept else ''}", file=sys.stderr, flush=True)


@contextmanager
def endings_are_told() -> Iterator[None]:
    """Context of a caller that tells itself how runs were ended by a signal, or has nobody to tell."""
    _callers.append(None)
    try:
        yield
    finally:
        _callers.pop()


_callers: list[None] = []  # those within endings_are_told


def stop_runs_of_threads() -> None:
    """Set stop_requested of all runs outside the main thread: each ends after a whole step with KeyboardInterrupt."""
    for run in list(RUNS_OF_THREADS.values()):
        run.stop_requested = True


@contextmanager
def raising_on_signals() -> Iterator[None]:
    """While active, Ctrl-C raises KeyboardInterrupt, and SIGTERM and SIGHUP raise Terminated, at once;
    a run inside stops after a whole step.

    For the main thread of a process whose workers do the work. Handlers that the host has set,
    and signals that it ignores, are left alone.
    """
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: handler for number in SIGNALS if (handler := signal.getsignal(number)) in DEFAULT_HANDLERS}
    for number in before:
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else raise_terminated)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


RUNS_OF_THREADS: dict[int, Stoppable] = {}  # by id


class StopRequests:
    """The handler of signals during a run; it replaces the default handlers, and the handler of an enclosing run.

    received : numbers of the signals that came, in order.  is_outermost : whether it is that of a run in no other run.
    """

    def __init__(self, run: Stoppable) -> None:
        self._run, self._before = run, dict[int, Any]()
        self.is_outermost = True
        self.received: list[int] = []

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        """Python calls this between two instructions of the main thread."""
        self._run.stop_requested = True
        self.received.append(number)
        if number == signal.SIGINT:
            self._give_back(number)

    def begin(self) -> None:
        """Set the handler; outside the main thread, where none can be set,
        register the run for stop_runs_of_threads."""
        self._run.stop_requested = False
        if threading.current_thread() is not threading.main_thread():
            RUNS_OF_THREADS[id(self._run)] = self._run
        else:
            for number in SIGNALS:
                handler = signal.getsignal(number)
                self.is_outermost = self.is_outermost and not isinstance(handler, StopRequests)
                if isinstance(handler, StopRequests) or handler in DEFAULT_HANDLERS:
                    self._before[number] = handler
                    signal.signal(number, self)

    def end(self) -> None:
        """Restore the handlers from before, that of Ctrl-C last: it may raise."""
        self._run.stop_requested = False
        RUNS_OF_THREADS.pop(id(self._run), None)
        for number in reversed(self._before):
            self._give_back(number)

    def _give_back(self, number: int) -> None:
        before = self._before[number]
        if signal.getsignal(number) is self:  # the host may have set its own meanwhile
            signal.signal(number, before)


class Terminated(SystemExit):
    """A run was ended by SIGTERM or SIGHUP, after a whole step.

    The exit code is 128 + the number of the signal, as in shells.

    kept : files of the run.
    """

    def __init__(self, number: int, words: str, kept: Sequence[Path] = ()) -> None:
        super().__init__(128 + number)
        self.kept = kept
        self.words = f"{words} by {signal.Signals(number).name}"

    def __str__(self) -> str:
        return self.words


def raise_terminated(number: int, _frame: FrameType | None) -> NoReturn:
    """Handler of SIGTERM and SIGHUP."""
    raise Terminated(number, "stopped")


DEFAULT_HANDLERS.append(raise_terminated)
