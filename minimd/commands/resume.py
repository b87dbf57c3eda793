"""`minimd resume`: go on with the run in an H5MD file."""

import argparse
from typing import Any

from minimd.commands.options import add_command, scene_of, silence, whole_number
from minimd.commands.run import tell_next

SCENE = """use this scene, from now on, in place of the one stored in the run: potentials, method, time step, bath, output; structure, minimization
and equilibration, which concern only the start, are not used"""


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    text, file = "Continue the run in an H5MD file and append to it.", ("file", "trajectory (.h5md) of a run from a scene file")
    parser = add_command(commands, resume, "go on with a run", file, "--quiet", description=text)
    parser.add_argument("--scene", metavar="TOML", help=SCENE)
    parser.add_argument("--steps", type=whole_number, metavar="N", help="number of further steps; if not given, up to the number in the scene")


def resume(arguments: argparse.Namespace) -> None:
    """Go on with a run.  Raises as resume_run."""
    from minimd.scene import resume_run

    scene = scene_of(arguments)
    with silence(arguments.quiet):
        resume_run(arguments.file, arguments.steps, scene=scene, progress=not arguments.quiet)
        tell_next([arguments.file])
