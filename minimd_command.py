"""The command `minimd`, from its first line on: Ctrl-C ends it with one sentence and code 130, whatever is being loaded or compiled.

This file lies beside the package because Python loads a package, and with it NumPy and Numba, before any of its modules. A KeyboardInterrupt
would not do: while a compiled module is loaded or a kernel compiled, it may turn into another error, a traceback or nothing. Only a run has
something to save. It replaces the handler by its own, see minimd.structure.console.
"""

import os
import sys
from _signal import SIG_DFL, SIGINT, default_int_handler, getsignal, signal  # loaded at once, unlike the module signal

WRONG_OUTPUT, INTERRUPTED = 2, 130  # exit codes


def end_at_once(_number: int, _frame: object) -> None:
    """Handler of Ctrl-C: one sentence, and the end."""
    signal(SIGINT, SIG_DFL)  # what was printed before may wait for somebody to read it; a second Ctrl-C does not
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
    """End without taking the interpreter down, while threads may still compute and HDF5 may be in the middle of a call."""
    for stream in (sys.__stdout__, sys.__stderr__):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, RuntimeError, ValueError) as reason:  # nobody reads it, it is in the middle of a print, or closed
            if code == 0:  # else a reason to end has been told
                code, words = WRONG_OUTPUT, f"minimd: error: the output is not complete: {reason}\n"
    try:
        os.write(2, words.encode())
    finally:
        os._exit(code)


if __name__ == "__main__":
    main()
