"""`minimd replay`: make the last steps of a failed run again."""

import argparse
from pathlib import Path
from typing import Any

from minimd.commands.options import add_quiet, add_scene, scene_of, silence


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    parser = commands.add_parser("replay", help="see a failed run fail again", description="Make the last steps of a failed run again, one by one.")
    parser.add_argument("file", type=Path, help="file (.crash.h5md) that the run left")
    add_scene(parser)
    parser.add_argument("--out", type=Path, metavar="FILE", help="trajectory of the steps (.h5md); the picture lies beside it")
    parser.add_argument("--overwrite", action="store_true", help="replace files that exist")
    add_quiet(parser)
    parser.set_defaults(command=replay)


def replay(arguments: argparse.Namespace) -> None:
    """Print the crash report and make the steps.  Raises as minimd.replay."""
    import minimd as md
    from minimd.files.crash_file import read_crash_report

    scene = scene_of(arguments)
    potentials = None if scene is None else scene.potentials()
    out, picture = (True, True) if arguments.out is None else (arguments.out, arguments.out.with_suffix(".png"))
    with silence(arguments.quiet):
        print(read_crash_report(arguments.file).findings, flush=True)
        seen = md.replay(arguments.file, potentials, trajectory=out, picture=picture, overwrite=arguments.overwrite)
        print(seen)
        print(f"written        {', '.join(str(file) for file in (seen.trajectory, seen.picture) if file)}")
