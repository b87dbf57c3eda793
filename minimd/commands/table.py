"""How a command is declared: its function, its help, its arguments, each a row; other packages add theirs.

A command of another package is a Command that an entry point of the group "minimd.commands" names.
"""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple


class Argument(NamedTuple):
    """One argument.  name : with dashes for an option.  more : further ones for argparse."""

    name: str
    help: str
    kind: Callable[[str], Any] | None = None
    metavar: str | None = None
    more: dict[str, Any] = {}  # noqa: RUF012 - never changed


class Command(NamedTuple):
    """One command.  run : called with the parsed arguments; returns False if a check failed.  help : in the list of
    all commands.  below : its own commands, which it has in place of run.  epilog : after its help."""

    name: str
    help: str
    description: str
    arguments: tuple[Argument, ...] = ()
    run: Callable[[argparse.Namespace], Any] | None = None
    below: tuple["Command", ...] = ()
    epilog: str | None = None


def flag(name: str, text: str) -> Argument:
    """An option that is given or not."""
    return Argument(name, text, more={"action": "store_true"})


def add(parsers: Any, command: Command) -> None:
    """Add a command to the subparsers of argparse."""
    words = {"help": command.help, "description": command.description, "epilog": command.epilog}
    parser: argparse.ArgumentParser = parsers.add_parser(command.name, **words)
    for one in command.arguments:
        kind = {"type": one.kind, "metavar": one.metavar}
        given: dict[str, Any] = {name: value for name, value in kind.items() if value is not None}
        parser.add_argument(one.name, help=one.help, **given, **one.more)
    if not command.below:
        parser.set_defaults(command=command.run)
        return
    more = parser.add_subparsers(metavar=f"{command.name}mark", title=f"{command.name}marks", required=True)
    for below in command.below:
        add(more, below)


def whole_number(text: str, least: int = 0) -> int:
    """A whole number, for argparse.  Raises ArgumentTypeError for any other text, or a number that is too small."""
    digits = text.replace("_", "")
    if not digits.isdecimal() or int(digits) < least:
        raise argparse.ArgumentTypeError(f"must be a whole number, at least {least}; it is {text!r}")
    return int(digits)


at_least_one = partial(whole_number, least=1)
OVERWRITE, QUIET = flag("--overwrite", "replace files that exist"), flag("--quiet", "print only errors")
STEPS = Argument("--steps", "number of steps, in place of that in the scene", whole_number, "N")


def written_to(metavar: str, text: str, **more: Any) -> Argument:
    """Where a command writes."""
    return Argument("--out", text, Path, metavar, more)
