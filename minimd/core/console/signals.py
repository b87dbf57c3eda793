"""Signals during a run: Ctrl-C, SIGTERM and SIGHUP stop it between two steps."""

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import inf
from pathlib import Path
from time import monotonic
from types import FrameType
from typing import Any, NoReturn, Protocol

from minimd.core.compiled.terminal import tell

# Windows has no SIGHUP
NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
SIGNALS = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
# handlers that nobody has set; the command `minimd` adds its own
DEFAULT_HANDLERS: list[Any] = [signal.SIG_DFL, signal.default_int_handler]


class Stoppable(Protocol):
    """Something that checks a flag between its steps."""

    stop_requested: bool


@contextmanager
def stop_on_signals(run: Stoppable, seconds: float = inf) -> Iterator[None]:
    """While active, Ctrl-C, SIGTERM and SIGHUP set run.stop_requested; at the end, SIGTERM and SIGHUP raise Terminated,
    and Ctrl-C KeyboardInterrupt.

    seconds : of wall time, after which run.stop_requested is set, too. The KeyboardInterrupt with which the run then
    ends goes no further: a sentence on standard error tells it, or a caller, see endings_are_told.

    Handlers that the host has set, and signals that it ignores, are left alone. Outside the main thread, where no
    handlers can be set, only stop_runs_of_threads stops a run.

    A second Ctrl-C does not wait for the end of the step. A run inside another one, in an observer, stops first; its
    exception ends the outer one. Python says nothing as it ends by Terminated: a sentence on standard error does,
    unless a caller tells it, see endings_are_told.
    """
    received: list[int] = []
    before: dict[int, Any] = {}

    def request(number: int, _frame: FrameType | None) -> None:
        run.stop_requested = True
        received.append(number)
        if number == signal.SIGINT:
            _give_back(number, request, before)

    deadline = monotonic() + seconds
    of_thread = threading.current_thread() is not threading.main_thread()
    is_inner = bool(_active) and not of_thread
    active = _of_threads if of_thread else _active
    run.stop_requested = False
    active[id(request)] = (run, request)
    timer = None
    if seconds < threading.TIMEOUT_MAX:  # 292 years
        timer = threading.Timer(seconds, setattr, (run, "stop_requested", True))
        timer.start()
    outer = [handler for _, handler in _active.values()]
    try:
        try:
            with _handled(dict.fromkeys(SIGNALS, request), before, outer):
                yield
        finally:
            if timer is not None:
                timer.cancel()
            run.stop_requested = False
            del active[id(request)]
        if received:
            raise KeyboardInterrupt("the run is complete, and was stopped after the last step")
    except KeyboardInterrupt as stopped:
        if not received and monotonic() > deadline:
            ending = f"{stopped}, because max_seconds = {seconds:g} have passed{_kept(stopped)}"
            for endings in _callers:
                endings.append(ending)
            if not _callers:
                tell(f"minimd: {ending}")
            return
        if received[:1] in ([], [signal.SIGINT]):
            stopped.args = (f"{str(stopped) or 'interrupted'}{_kept(stopped)}",)
            raise
        ended = Terminated(received[0], str(stopped), getattr(stopped, "kept", ()))
    except Terminated as of_inner:
        ended = of_inner
    else:
        return
    if not is_inner:
        tell_ending(ended)
    raise ended from None


@contextmanager
def raising_on_signals() -> Iterator[None]:
    """While active, Ctrl-C raises KeyboardInterrupt, and SIGTERM and SIGHUP raise Terminated, at once;
    a run inside stops after a whole step.

    For the main thread of a process whose workers do the work. Handlers that the host has set, and signals that it
    ignores, are left alone.
    """
    handlers: dict[int, Any] = dict.fromkeys(SIGNALS, raise_terminated)
    handlers[signal.SIGINT] = signal.default_int_handler
    with _handled(handlers, {}):
        yield


@contextmanager
def _handled(
    handlers: dict[int, Any], before: dict[int, Any], also: Sequence[Any] = ()
) -> Iterator[None]:
    """Set handlers of signals, in the main thread, in place of the default ones and of those named in also; before :
    takes the replaced ones. At the end they are set again, that of Ctrl-C last: it may raise."""
    try:
        is_main = threading.current_thread() is threading.main_thread()
        for number in SIGNALS if is_main else ():
            handler = signal.getsignal(number)
            if handler in (*DEFAULT_HANDLERS, *also):
                before[number] = handler
                signal.signal(number, handlers[number])
        yield
    finally:
        for number in reversed(before):
            _give_back(number, handlers[number], before)


def _give_back(number: int, handler: Any, before: dict[int, Any]) -> None:
    if signal.getsignal(number) is handler:  # the host may have set its own meanwhile
        signal.signal(number, before[number])


# (run, its handler) of the runs in the main thread, from the outermost to the innermost; and of those in other threads
_active: dict[int, tuple[Stoppable, Any]] = {}
_of_threads: dict[int, tuple[Stoppable, Any]] = {}


def stop_runs_of_threads() -> None:
    """Set stop_requested of all runs outside the main thread: each ends after a whole step with KeyboardInterrupt."""
    for run, _ in list(_of_threads.values()):
        run.stop_requested = True


_callers: list[list[str]] = []  # endings of those within endings_are_told


@contextmanager
def endings_are_told() -> Iterator[list[str]]:
    """Context of a caller that tells itself how runs were ended by a signal, or has nobody to tell.
    Yields a list, to which sentences about runs that have ended before their last step are added."""
    endings: list[str] = []
    _callers.append(endings)
    try:
        yield endings
    finally:
        _callers.pop()


def tell_ending(ended: "Terminated") -> None:
    """Tell on standard error how runs were ended by a signal, unless a caller does."""
    if not _callers:
        tell(f"minimd: {ended}{_kept(ended)}")


def _kept(stopped: BaseException) -> str:
    """Which files of a run hold what was written, and how a script goes on, as clauses; empty if there are none, or a
    caller tells it."""
    files = [str(file) for file in getattr(stopped, "kept", ()) if file.exists()]
    if not files or _callers:
        return ""
    kept = f"; what was written is kept in {', '.join(files)}"
    for file in files:
        if file.lower().endswith(".h5md"):
            return (
                f"{kept}; to go on, call run with trajectory={file!r}, append=True; in a new session first sim = "
                f"minimd.Simulation.resume({file!r}, potentials)"
            )
    return kept


class Terminated(SystemExit):
    """A run was ended by SIGTERM or SIGHUP, after a whole step. The exit code is 128 + the number of the signal, as in
    shells.
    kept : files of the run."""

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
