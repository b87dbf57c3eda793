"""`minimd archive`: a small file of a run in fixed-point arithmetic, from which every step can be made again."""

import argparse
from pathlib import Path
from typing import Any

from minimd.commands.options import add_command, scene_of, whole_number


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    text = "Keep few frames of a run with precision='fixed-point'. All steps in between can be made again from them, to the last bit."
    parser = add_command(commands, archive, "make a run's file small", ("file", "trajectory (.h5md)"), "--scene", "--overwrite", description=text)
    parser.add_argument("--every", type=whole_number, required=True, metavar="N", help="keep the frames whose step is a multiple of N")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the archive (.h5md); beside the file if not given")


def archive(arguments: argparse.Namespace) -> None:
    """Write the archive and print its size.  Raises as minimd.archive."""
    import minimd as md

    scene, file = scene_of(arguments), arguments.file
    out = arguments.out or file.with_name(f"{file.stem}.archive.h5md")
    print(md.archive(file, out, arguments.every, scene and scene.potentials(), arguments.overwrite))
