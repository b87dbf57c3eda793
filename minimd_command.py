"""The program `minimd`: from its first line on, Ctrl-C ends it with one sentence and code 130, even while modules are loaded or compiled.

This file is beside the package, because Python loads a package, and with it NumPy and Numba, before any of its modules. A KeyboardInterrupt
is not enough: while a compiled module is loaded or a kernel is compiled, it may become another error, a traceback or nothing. Only a run
has something to save; it replaces the handler by its own, see minimd.structure.console.
"""

import os
import sys
from _signal import SIG_DFL, SIGINT, default_int_handler, getsignal, signal  # loaded at once, unlike the module signal

WRONG_OUTPUT, INTERRUPTED = 2, 130  # exit codes


def end_at_once(_number: int, _frame: object) -> None:
    """Handler of Ctrl-C: print one sentence and end the process."""
    signal(SIGINT, SIG_DFL)  # earlier output may wait for its reader; then a second Ctrl-C ends the process
    _end(INTERRUPTED, "minimd: error: interrupted\n")


if getsignal(SIGINT) is default_int_handler:
    signal(SIGINT, end_at_once)


def main() -> None:
    """Run the command, and end the process with its exit code."""
    from minimd.commands.main import main as run_command
    from minimd.structure.console import DEFAULT_HANDLERS

    DEFAULT_HANDLERS.append(end_at_once)
    try:
        code = run_command()
    except SystemExit as ending:  # of argparse
        code = ending.code if isinstance(ending.code, int) else 0
    _end(code)


def _end(code: int, words: str = "") -> None:
    """End the process without shutting the interpreter down: threads may still compute, and HDF5 may be in the middle of a call."""
    for stream in (sys.__stdout__, sys.__stderr__):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, RuntimeError, ValueError) as reason:  # the reader is gone, a print is not finished, or the stream is closed
            if code == 0:  # else the reason has already been printed
                code, words = WRONG_OUTPUT, f"minimd: error: the output is not complete: {reason}\n"
    try:
        os.write(2, words.encode())
    finally:
        os._exit(code)


if __name__ == "__main__":
    main()
