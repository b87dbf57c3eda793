"""Options that several commands have."""

import argparse
import contextlib
import io
from collections.abc import Iterator
from typing import Any


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """--quiet."""
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def add_steps(parser: argparse.ArgumentParser, text: str) -> None:
    """--steps N."""
    parser.add_argument("--steps", type=whole_number, metavar="N", help=text)


def add_scene(parser: argparse.ArgumentParser) -> None:
    """--scene TOML."""
    parser.add_argument("--scene", metavar="TOML", help="take the potentials from this scene file, instead of the one stored in the run")


def scene_of(arguments: argparse.Namespace) -> Any:
    """The minimd.scene.Scene that --scene names; None without."""
    from minimd.scene import load_scene

    return None if arguments.scene is None else load_scene(arguments.scene)


@contextlib.contextmanager
def silence(quiet: bool) -> Iterator[None]:
    """Swallow what is printed on both streams, if quiet; errors are printed after it."""
    with contextlib.ExitStack() as stack:
        if quiet:
            stack.enter_context(contextlib.redirect_stdout(io.StringIO()))
            stack.enter_context(contextlib.redirect_stderr(io.StringIO()))
        yield


def whole_number(text: str, least: int = 0) -> int:
    """A whole number, for argparse.  Raises ArgumentTypeError for what is none, or too small."""
    digits = text.replace("_", "")
    if not digits.isdecimal() or int(digits) < least:
        raise argparse.ArgumentTypeError(f"must be a whole number, at least {least}; it is {text!r}")
    return int(digits)
