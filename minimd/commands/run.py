"""`minimd run`: build a scene, run it, and write its files."""

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from minimd.commands.options import add_command, silence, whole_number


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    text, file = "Build a scene, run it, and write its files.", ("scene", "scene file (TOML)")
    parser = add_command(commands, run, "run a scene file", file, "--overwrite", "--quiet", description=text)
    parser.add_argument("--steps", type=whole_number, metavar="N", help="number of steps, in place of that in the scene")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="one trajectory file, in place of those in the scene; the picture is written beside it"
    )


def run(arguments: argparse.Namespace) -> None:
    """Run a scene.  Raises as run_scene."""
    from minimd.scene import load_scene, run_scene

    scene, quiet = load_scene(arguments.scene), arguments.quiet
    for file in () if arguments.overwrite else scene.named_outputs(arguments.out):
        if file.exists():
            resume = f", or go on with the run: minimd resume {file}" if file.suffix.lower() == ".h5md" else ""
            raise FileExistsError(f"output {str(file)!r} exists; replace it with --overwrite, write elsewhere with --out FILE{resume}")
    with silence(quiet):
        run_scene(scene, steps=arguments.steps, trajectory=arguments.out, overwrite=arguments.overwrite, progress=not quiet)
        tell_next(scene.trajectories(arguments.out))


def tell_next(files: Iterable[Path]) -> None:
    """Print the commands that check and show the files of a run."""
    from minimd.scene.document import h5md_files

    for file in h5md_files(files):
        print(f"next           minimd check {file}\n               minimd plot {file}\n               minimd view {file}")
