"""`minimd check`: check the file of a run for its conservation laws."""

import argparse
from pathlib import Path
from typing import Any


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    parser = commands.add_parser("check", help="check a run for its conservation laws")
    parser.add_argument("file", type=Path, help="trajectory (.h5md)")
    parser.set_defaults(command=check)


def check(arguments: argparse.Namespace) -> bool:
    """Print the check of a file; True if it passed.  Raises as check_file."""
    from minimd.analysis.check import check_file

    result = check_file(arguments.file)
    print(result)
    return result.passed
