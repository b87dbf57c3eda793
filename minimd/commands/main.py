"""The command `minimd`: finds the command that is asked for, and turns failures into sentences and exit codes."""

import argparse
import os
import sys
from collections.abc import Sequence

from minimd.bench.outcome import DisagreementError
from minimd.commands import bench, check, doctor, plot, replay, resume, run
from minimd.compiled.machine import version
from minimd.structure.errors import ConstraintError, NonFiniteError

OK, FAILED, WRONG_INPUT, BLOWN_UP, INTERRUPTED = 0, 1, 2, 3, 130  # exit codes


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 a check failed, 2 wrong input, 3 blown up, 130 interrupted.

    Expected failures end in one sentence for each problem on standard error.
    """
    parser = _parser()
    arguments = parser.parse_args(argv)
    if "command" not in arguments:
        parser.print_help()
        return OK
    try:
        passed = arguments.command(arguments)  # None of a command that judges nothing
        return OK if passed is None or passed else FAILED
    except KeyboardInterrupt as error:
        return _failed(str(error) or "interrupted", INTERRUPTED)
    except (NonFiniteError, ConstraintError) as error:
        return _failed(str(error), BLOWN_UP)
    except DisagreementError as error:
        return _failed(str(error), FAILED)
    except OSError as error:
        return _failed(_about_file(error), WRONG_INPUT)
    except (ValueError, TypeError) as error:
        return _failed(str(error), WRONG_INPUT)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="minimd", description="Molecular dynamics from a scene file, in small.", epilog="Begin with: minimd doctor")
    parser.add_argument("--version", action="version", version=f"minimd {version('minimd')}")
    commands = parser.add_subparsers(metavar="command", title="commands")
    for command in (run, resume, replay, check, plot, bench, doctor):
        command.add(commands)
    return parser


def _about_file(error: OSError) -> str:
    """An error of the operating system with the name of its file, if it has one."""
    if error.strerror is None:
        return str(error)
    return error.strerror if error.filename is None else f"{os.fsdecode(error.filename)}: {error.strerror}"


def _failed(message: str, code: int) -> int:
    sys.stdout.flush()
    for line in message.splitlines():
        print(f"minimd: error: {line}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
