"""The program `minimd`: it finds the command, and turns errors into sentences and exit codes."""

import argparse
import sys
import warnings
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from importlib.metadata import entry_points
from io import StringIO
from typing import Any

from minimd.commands.table import COMMANDS, add
from minimd.core.compiled.terminal import tell
from minimd.core.console import __version__
from minimd.core.console.signals import Terminated, endings_are_told
from minimd.core.console.words import printable
from minimd.core.structure.errors import (
    ConstraintError,
    EnsembleError,
    HandOverError,
    NonFiniteError,
    sentence,
)

# exit codes
OK = 0
FAILED = 1
WRONG_INPUT = 2
BLOWN_UP = 3
UNFINISHED = 4
INTERRUPTED = 130
CODES: dict[type[BaseException], int] = {
    OSError: WRONG_INPUT,
    ValueError: WRONG_INPUT,
    TypeError: WRONG_INPUT,
    NonFiniteError: BLOWN_UP,
    ConstraintError: BLOWN_UP,
    EnsembleError: FAILED,
    HandOverError: FAILED,
    KeyboardInterrupt: INTERRUPTED,
}
EXPECTED: tuple[type[BaseException], ...] = (*CODES, Terminated)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    0 done, 1 a check failed, 2 wrong input, 3 blown up, 4 ended by max_seconds before the last step, 130 interrupted,
    143 terminated, 129 terminated because the terminal was closed. For an expected error, and for a run that
    max_seconds has ended, a sentence is printed to standard error. With --quiet nothing else is printed.
    """
    parser = argparse.ArgumentParser(
        prog="minimd",
        description="Molecular dynamics from scene files.",
        epilog="Begin with: minimd doctor",
    )
    parser.add_argument("--version", action="version", version=f"minimd {__version__}")
    commands = parser.add_subparsers(metavar="command", title="commands")
    for command in COMMANDS:
        add(commands, command)
    for entry_point in entry_points(group="minimd.commands"):
        try:
            command = entry_point.load()
        except Exception as error:  # of any package: it must not stop the commands of others
            _tell(
                f"the command {entry_point.name} of {entry_point.value} cannot be loaded: {error!r}"
            )
        else:
            add(commands, command)
    arguments, unknown = parser.parse_known_args(argv)
    if unknown:
        refuse = getattr(arguments, "refuse", parser.error)
        refuse(f"unrecognized arguments: {' '.join(unknown)}")
    if "command" not in arguments:
        parser.print_help()
        return OK
    out: Any = sys.stdout and Printable(sys.stdout)  # None if the shell has closed it
    err: Any = sys.stderr
    if getattr(arguments, "quiet", False):
        out = err = StringIO()
    try:
        # catch_warnings acts on the whole process, which is this command
        with (
            endings_are_told() as endings,
            redirect_stdout(out),
            redirect_stderr(err),
            warnings.catch_warnings(),
        ):
            warnings.showwarning = _tell
            passed = arguments.command(arguments)  # None for a command without a judgement
        for ending in endings:
            tell(f"minimd: {printable(ending)}")
        if endings:
            return UNFINISHED
        return OK if passed is None or passed else FAILED
    except EXPECTED as error:
        with suppress(OSError, AttributeError):  # the reader may be gone
            sys.stdout.flush()
        is_stopped = isinstance(error, KeyboardInterrupt | Terminated)
        word = "" if is_stopped else "error: "
        for line in sentence(error).splitlines():
            tell(f"minimd: {word}{printable(line)}")
        if isinstance(error, Terminated):
            return int(error.code or FAILED)
        return next(code for kind, code in CODES.items() if isinstance(error, kind))


class Printable:
    """Standard output of a command: names and texts of files give no orders to the terminal."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> None:
        """Called by print."""
        self._stream.write(printable(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _tell(message: Warning | str, *_where: Any, **_more: Any) -> None:
    """Print a warning as a sentence, without the line of Python from which it comes, which is not the user's."""
    tell(f"minimd: warning: {printable(str(message))}")


if __name__ == "__main__":
    sys.exit(main())
