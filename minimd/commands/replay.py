"""`minimd replay`: make the last steps of a failed run again."""

import argparse
from pathlib import Path
from typing import Any

from minimd.commands.options import add_command, scene_of, silence


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    text, file = "Make the last steps of a failed run again, one by one.", ("file", "file (.crash.h5md) that the run left")
    parser = add_command(commands, replay, "make the last steps of a failed run again", file, "--scene", "--overwrite", "--quiet", description=text)
    parser.add_argument("--out", type=Path, metavar="FILE", help="trajectory of the steps (.h5md); the picture is written beside it")


def replay(arguments: argparse.Namespace) -> None:
    """Print the crash report and make the steps.  Raises as verify_frames and minimd.replay."""
    import minimd as md
    from minimd.files.crash_file import read_crash_report
    from minimd.files.h5md_reader import verify_frames

    verify_frames(arguments.file)
    scene = scene_of(arguments)
    out, picture = (True, True) if arguments.out is None else (arguments.out, arguments.out.with_suffix(".png"))
    with silence(arguments.quiet):
        print(read_crash_report(arguments.file).findings, flush=True)
        seen = md.replay(arguments.file, scene and scene.potentials(), trajectory=out, picture=picture, overwrite=arguments.overwrite)
        print(seen)
        print(f"written        {', '.join(str(file) for file in (seen.trajectory, seen.picture) if file)}")
