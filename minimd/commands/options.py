"""The parts that several commands share: adding a command, options, silence."""

import argparse
import io
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

OPTIONS: dict[str, dict[str, Any]] = {  # options of several commands, as arguments for argparse
    "--overwrite": {"action": "store_true", "help": "replace files that exist"},
    "--quiet": {"action": "store_true", "help": "print only errors"},
    "--scene": {"metavar": "TOML", "help": "take the potentials from this scene file, not from the scene stored in the run"},
}


def add_command(commands: Any, run: Callable[..., Any], text: str, file: tuple[str, str], *shared: str, **more: Any) -> argparse.ArgumentParser:
    """Add a command, named after the function that runs it, to the subparsers of `minimd`.

    text : its help.  file : name and help of its required argument.  shared : options from OPTIONS.  more : arguments for argparse.
    """
    described = {"description": f"{text[0].upper()}{text[1:]}.", **more}
    parser: argparse.ArgumentParser = commands.add_parser(run.__name__, help=text, **described)
    parser.add_argument(file[0], type=Path, help=file[1])
    for name in shared:
        parser.add_argument(name, **OPTIONS[name])
    parser.set_defaults(command=run)
    return parser


def scene_of(arguments: argparse.Namespace) -> Any:
    """The minimd.scene.Scene in the file of --scene; None if it is not given."""
    from minimd.scene import load_scene

    return None if arguments.scene is None else load_scene(arguments.scene)


@contextmanager
def silence(quiet: bool) -> Iterator[None]:
    """If quiet, discard everything that is printed to both streams; errors are printed after this context."""
    with redirect_stdout(io.StringIO() if quiet else sys.stdout), redirect_stderr(io.StringIO() if quiet else sys.stderr):
        yield


def whole_number(text: str, least: int = 0) -> int:
    """A whole number, for argparse.  Raises ArgumentTypeError for any other text, or a number that is too small."""
    digits = text.replace("_", "")
    if not digits.isdecimal() or int(digits) < least:
        raise argparse.ArgumentTypeError(f"must be a whole number, at least {least}; it is {text!r}")
    return int(digits)
