"""`minimd scan`: runs of a scene with different values of its keys, on many cores, with one table of results."""

import argparse
from pathlib import Path
from typing import Any

from minimd.commands.options import OPTIONS, silence, whole_number

TEXT = """Run a scene with different values of its keys, each run with its own file, and average. The same command goes on where it was stopped;
with more replicas or steps it adds to the runs that are there. Example:
minimd scan argon.toml --set dynamics.temperature_K=80:120:5 --replicas 4 --workers 2 --out scan"""


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    parser: argparse.ArgumentParser = commands.add_parser("scan", help="run a scene with many values of its keys", description=TEXT)
    parser.add_argument("scene", type=Path, nargs="?", help="scene file (TOML)")
    values = "values for a key of the scene: 80:120:5 is 80, 85, ..., 120; several --set give all combinations"
    parser.add_argument("--set", action="append", default=[], metavar="KEY=FROM:TO:STEP", dest="settings", help=f"{values}; or KEY=VALUE,VALUE,...")
    parser.add_argument(
        "--replicas",
        type=lambda text: whole_number(text, 1),
        default=1,
        metavar="N",
        help="number of runs for each set of values, with different random numbers",
    )
    parser.add_argument("--steps", type=whole_number, metavar="N", help="number of steps, in place of that in the scene")
    parser.add_argument(
        "--workers", type=whole_number, metavar="N", help="number of processes, one for each core if not given; 0 for this process only"
    )
    parser.add_argument("--seed", type=whole_number, default=0, metavar="N", help="seed of all random numbers (default: 0)")
    parser.add_argument("--out", type=Path, default=Path("scan"), metavar="FOLDER", help="folder for all files (default: scan)")
    parser.add_argument("--plot", metavar="NAME", help="quantity in the picture (default: pressure)")
    parser.add_argument("--status", type=Path, metavar="FOLDER", help="show the state of the scan in a folder, and run nothing")
    for name in ("--overwrite", "--quiet"):
        parser.add_argument(name, **OPTIONS[name])
    parser.set_defaults(command=scan)


def scan(arguments: argparse.Namespace) -> bool:
    """Scan a scene, or print the status of a scan; False if members have failed.  Raises as scan_scene."""
    from minimd.ensemble.scan import parsed_setting, scan_scene
    from minimd.ensemble.status import status

    if arguments.status is not None:
        table, lines = status(arguments.status)
        print("\n".join(lines))
        return tell_results(table, arguments)
    if arguments.scene is None:
        raise ValueError("minimd scan needs a scene file, or --status FOLDER to show the state of a scan")
    names = ("replicas", "steps", "workers", "seed")
    options: dict[str, Any] = {name: getattr(arguments, name) for name in names} | {"folder": arguments.out, "resume": not arguments.overwrite}
    with silence(arguments.quiet):
        table = scan_scene(arguments.scene, [parsed_setting(text) for text in arguments.settings], progress=not arguments.quiet, **options)
        print(table)
        return tell_results(table, arguments)


def tell_results(table: Any, arguments: argparse.Namespace) -> bool:
    """Print the averages, draw the picture, name the files; True if no member has failed."""
    from minimd.ensemble.summary import save_picture, told_averages

    if table.done.any():
        print("\n".join(told_averages(table)))
        picture = save_picture(table, arguments.plot)
        print(f"written        {table.folder / 'table.csv'}, {table.folder / 'table.json'}, {picture}")
    return not any(table["status"] == "failed")
