"""`minimd plot`: draw a run."""

import argparse
from pathlib import Path
from typing import Any


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    parser = commands.add_parser("plot", help="draw the energies, the temperature and the structure of a run")
    parser.add_argument("file", type=Path, help="trajectory (.h5md)")
    parser.add_argument("--out", type=Path, metavar="PNG", help="picture, named after the trajectory if not given")
    parser.set_defaults(command=plot)


def plot(arguments: argparse.Namespace) -> None:
    """Draw the picture and print its name.  Raises as plot_file."""
    from minimd.analysis.plot import plot_file

    picture = arguments.file.with_suffix(".png") if arguments.out is None else arguments.out
    word = "replaced" if picture.exists() else "written"
    print(f"drawing        {picture} ...", flush=True)
    print(f"{word:<14} {plot_file(arguments.file, picture)}")
