"""`minimd lammps`: build a scene, let LAMMPS run it, and bring the result back."""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

from minimd.commands.options import add_command, silence, whole_number
from minimd.commands.run import tell_next


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    text = "Build a scene, let LAMMPS run it under MPI, and bring the result back as a file of minimd."
    file = "scene", "scene file (TOML)"
    parser = add_command(commands, lammps, "let LAMMPS run a scene file", file, "--overwrite", "--quiet", description=text)
    parser.add_argument("--processes", type=partial(whole_number, least=1), default=1, metavar="P", help="number of MPI processes, 1 if not given")
    parser.add_argument("--steps", type=partial(whole_number, least=1), metavar="N", help="number of steps, in place of that in the scene")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="folder for all files; named after the scene if not given")


def lammps(arguments: argparse.Namespace) -> None:
    """Hand a scene over.  Raises as hand_over_scene."""
    from minimd.lammps.handing_over import TRAJECTORY
    from minimd.scene import load_scene
    from minimd.scene.handing_over import hand_over_scene

    scene, quiet = load_scene(arguments.scene), arguments.quiet
    folder = arguments.out or Path(f"{scene.path.stem}-lammps")
    if folder.exists() and not arguments.overwrite:
        file = folder / TRAJECTORY
        resume = f", or go on with the run: minimd resume {file}" if file.exists() else ""
        raise FileExistsError(f"folder {str(folder)!r} exists; replace it with --overwrite, write elsewhere with --out FOLDER{resume}")
    with silence(quiet):
        done = hand_over_scene(scene, folder, steps=arguments.steps, processes=arguments.processes, overwrite=arguments.overwrite, progress=not quiet)
        tell_next([done.trajectory])
