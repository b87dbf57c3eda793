"""`minimd check`: check the file of a run for its conservation laws."""

import argparse
from typing import Any

from minimd.commands.options import add_command


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    add_command(commands, check, "check a run for its conservation laws", ("file", "trajectory (.h5md)"))


def check(arguments: argparse.Namespace) -> bool:
    """Print the check of a file; True if it passed.  Raises as check_file."""
    from minimd.analysis.check import check_file

    result = check_file(arguments.file)
    print(result)
    return result.passed
