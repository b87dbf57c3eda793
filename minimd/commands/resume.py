"""`minimd resume`: go on with the run in an H5MD file."""

import argparse
from pathlib import Path
from typing import Any

from minimd.commands.options import add_quiet, add_scene, add_steps, scene_of, silence
from minimd.commands.run import tell_next


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    parser = commands.add_parser("resume", help="go on with a run", description="Continue the run in an H5MD file and append to it.")
    parser.add_argument("file", type=Path, help="trajectory (.h5md) of a run from a scene file")
    add_steps(parser, "how many more steps; up to the end of the scene if not given")
    add_scene(parser)
    add_quiet(parser)
    parser.set_defaults(command=resume)


def resume(arguments: argparse.Namespace) -> None:
    """Go on with a run.  Raises as resume_run."""
    from minimd.scene import resume_run

    scene = scene_of(arguments)
    with silence(arguments.quiet):
        resume_run(arguments.file, arguments.steps, scene=scene, progress=not arguments.quiet)
        tell_next([arguments.file])
