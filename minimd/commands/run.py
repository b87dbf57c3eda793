"""`minimd run`: build a scene, run it, and write its files."""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from minimd.commands.options import add_quiet, add_steps, silence


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    parser = commands.add_parser("run", help="run a scene file", description="Build a scene, run it, and write its files.")
    parser.add_argument("scene", help="scene file (TOML)")
    add_steps(parser, "instead of the steps in the scene")
    parser.add_argument("--out", type=Path, metavar="FILE", help="one trajectory file instead of those in the scene; the picture lies beside it")
    parser.add_argument("--overwrite", action="store_true", help="replace files that exist")
    add_quiet(parser)
    parser.set_defaults(command=run)


def run(arguments: argparse.Namespace) -> None:
    """Run a scene.  Raises as run_scene."""
    from minimd.scene import load_scene, run_scene

    scene = load_scene(arguments.scene)
    files = scene.trajectories() if arguments.out is None else [arguments.out]
    if not arguments.overwrite:
        plot = scene.sections.output.plot
        _refuse_existing([*files, Path(plot)] if isinstance(plot, str) and arguments.out is None else files)
    with silence(arguments.quiet):
        progress = not arguments.quiet
        run_scene(scene, steps=arguments.steps, trajectory=arguments.out, overwrite=arguments.overwrite, progress=progress)
        tell_next(files)


def tell_next(files: Sequence[Path]) -> None:
    """Name the commands that look at the files of a run."""
    for file in files:
        if file.suffix.lower() == ".h5md":
            print(f"next           minimd check {file}\n               minimd plot {file}")


def _refuse_existing(files: Iterable[Path]) -> None:
    for file in files:
        if file.exists():
            resume = f", or go on with the run: minimd resume {file}" if file.suffix.lower() == ".h5md" else ""
            raise FileExistsError(f"output {str(file)!r} exists; replace it with --overwrite, write elsewhere with --out FILE{resume}")
