"""The program `minimd`: from its first line on, a signal ends it with one sentence,
whatever is being loaded or compiled.

The codes are those of shells: 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP.

This file is beside the package, because Python loads a package, and with it NumPy and Numba, before any of its modules.
A KeyboardInterrupt is not enough: while a compiled module is loaded or a kernel is compiled, it may become another
error, a traceback or nothing. Only a run has something to save; it replaces the handler by its own,
see minimd.core.console.signals.
"""

import _signal  # loaded at once, unlike the module signal
import os
import sys
from io import TextIOWrapper

WRONG_OUTPUT, BY_SIGNAL = 2, 128  # exit codes; to the second the number of the signal is added


def end_at_once(number: int, _frame: object) -> None:
    """Handler of Ctrl-C, SIGTERM and SIGHUP: print one sentence and end the process."""
    _signal.signal(number, _signal.SIG_DFL)  # earlier output may wait for its reader; a second one ends the process
    words = {_signal.SIGINT: "interrupted", _signal.SIGTERM: "stopped by SIGTERM"}.get(number, "stopped by SIGHUP")
    _end(BY_SIGNAL + number, f"minimd: error: {words}\n")


if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
    _signal.signal(_signal.SIGINT, end_at_once)


def main() -> None:
    """Run the command, and end the process with its exit code."""
    for number in (_signal.SIGTERM, getattr(_signal, "SIGHUP", _signal.SIGTERM)):  # Windows has no SIGHUP
        if _signal.getsignal(number) == _signal.SIG_DFL:  # not on import, which workers do: their runs end by SIGTERM
            _signal.signal(number, end_at_once)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # else the shell has closed it
            stream.reconfigure(errors="backslashreplace")  # not every code page of Windows has σ and −
    from minimd.commands.main import main as run_command
    from minimd.core.console.signals import DEFAULT_HANDLERS

    DEFAULT_HANDLERS.append(end_at_once)
    try:
        code = run_command()
    except SystemExit as ending:  # of argparse
        code = ending.code if isinstance(ending.code, int) else 0
    _end(code)


def _end(code: int, words: str = "") -> None:
    """End the process without shutting the interpreter down: threads may still compute,
    and HDF5 may be in the middle of a call."""
    for stream in (sys.__stdout__, sys.__stderr__):
        try:
            if stream is not None:
                stream.flush()
        except (
            OSError,
            RuntimeError,
            ValueError,
        ) as reason:  # the reader is gone, a print is not finished, or the stream is closed
            if code == 0:  # else the reason has already been printed
                code, words = WRONG_OUTPUT, f"minimd: error: the output is not complete: {reason}\n"
    try:
        os.write(2, words.encode())
    finally:
        os._exit(code)


if __name__ == "__main__":
    main()
