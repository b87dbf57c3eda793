"""`minimd view`: show a run as a page in the browser."""

import argparse
from pathlib import Path
from typing import Any

from minimd.commands.options import add_command, scene_of, whole_number
from minimd.view.viewing import FRAMES


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    text = "Write a run as one HTML page: its report, its pictures, its atoms in motion. For a failed run it shows the last steps and marks the pair."
    file = ("file", "trajectory (.h5md), or file (.crash.h5md) that a failed run left")
    parser = add_command(commands, view, "show the atoms of a run in motion, in the browser", file, "--scene", description=text)
    parser.add_argument("--out", type=Path, metavar="HTML", help="file of the page; named after the run if not given")
    parser.add_argument(
        "--frames",
        type=lambda text: whole_number(text, 2),
        metavar="N",
        default=FRAMES,
        help=f"largest number of frames, evenly chosen (default: {FRAMES})",
    )
    parser.add_argument("--open", action="store_true", help="show the page in the browser")


def view(arguments: argparse.Namespace) -> None:
    """Write the page and print its name.  Raises as minimd.view."""
    import minimd as md

    scene, page = scene_of(arguments), arguments.out or arguments.file.with_suffix(".html")
    word = "replaced" if page.exists() else "written"
    print(f"drawing        {page} ...", flush=True)
    seen = md.view(arguments.file, frames=arguments.frames, potentials=scene and scene.potentials())
    seen.save(page)
    print(f"{word:<14} {page}: {seen.summary}, {page.stat().st_size / 1e6:.1f} MB")
    if arguments.open:
        import webbrowser

        webbrowser.open(page.resolve().as_uri())
