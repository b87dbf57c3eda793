"""`minimd plot`: draw a run."""

import argparse
from pathlib import Path
from typing import Any

from minimd.commands.options import add_command


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    parser = add_command(commands, plot, "draw the energies, the temperature and the structure of a run", ("file", "trajectory (.h5md)"))
    parser.add_argument("--out", type=Path, metavar="PNG", help="file of the picture; named after the trajectory if not given")


def plot(arguments: argparse.Namespace) -> None:
    """Draw the picture and print its name.  Raises as verify_frames and plot_file."""
    from minimd.analysis.plot import plot_file
    from minimd.files.h5md_reader import verify_frames

    verify_frames(arguments.file)
    picture = arguments.out or arguments.file.with_suffix(".png")
    word = "replaced" if picture.exists() else "written"
    print(f"drawing        {picture} ...", flush=True)
    print(f"{word:<14} {plot_file(arguments.file, picture)}")
