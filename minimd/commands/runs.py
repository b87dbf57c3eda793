"""The commands that make runs, and those that read their files: everything but `minimd bench` and `minimd doctor`."""

import argparse
import io
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

from minimd.view.viewing import FRAMES

SCENE_FILE, RUN_FILE = ("scene", "scene file (TOML)"), ("file", "trajectory (.h5md)")
OTHER_SCENE = """use this scene, from now on, in place of the one stored in the run: potentials, method, time step,
bath, output; structure, minimization and equilibration, which concern only the start, are not used"""
SCAN = """Run a scene with different values of its keys, each run with its own file, and average. The same command goes
on where it was stopped; with more replicas or steps it adds to the runs that are there. Example:
minimd scan argon.toml --set dynamics.temperature_K=80:120:5 --replicas 4 --workers 2 --out scan"""
OPTIONS: dict[str, dict[str, Any]] = {  # options of several commands, as arguments for argparse
    "--overwrite": {"action": "store_true", "help": "replace files that exist"},
    "--quiet": {"action": "store_true", "help": "print only errors"},
    "--scene": {
        "metavar": "TOML",
        "help": "take the potentials from this scene file, not from the scene stored in the run",
    },
}


def whole_number(text: str, least: int = 0) -> int:
    """A whole number, for argparse.  Raises ArgumentTypeError for any other text, or a number that is too small."""
    digits = text.replace("_", "")
    if not digits.isdecimal() or int(digits) < least:
        raise argparse.ArgumentTypeError(f"must be a whole number, at least {least}; it is {text!r}")
    return int(digits)


at_least_one = partial(whole_number, least=1)


def add(commands: Any) -> None:
    """Add the commands to the subparsers of `minimd`."""
    for add_some in (_add_new_runs, _add_further_runs, _add_readers):
        add_some(commands)


def add_command(
    commands: Any, run: Callable[..., Any], text: str, file: tuple[str, str], *shared: str, **more: Any
) -> argparse.ArgumentParser:
    """Add a command, named after the function that runs it, to the subparsers of `minimd`.

    text : its help.  file : name and help of its required argument.  shared : options from OPTIONS.  more :
        arguments for argparse.
    """
    described = {"description": f"{text[0].upper()}{text[1:]}.", **more}
    parser: argparse.ArgumentParser = commands.add_parser(run.__name__, help=text, **described)
    parser.add_argument(file[0], type=Path, help=file[1])
    for name in shared:
        parser.add_argument(name, **OPTIONS[name])
    parser.set_defaults(command=run)
    return parser


def _add_new_runs(commands: Any) -> None:
    text = "Build a scene, run it, and write its files."
    parser = add_command(commands, run, "run a scene file", SCENE_FILE, "--overwrite", "--quiet", description=text)
    parser.add_argument(
        "--steps", type=whole_number, metavar="N", help="number of steps, in place of that in the scene"
    )
    told = "one trajectory file, in place of those in the scene; the picture is written beside it"
    parser.add_argument("--out", type=Path, metavar="FILE", help=told)
    parser = commands.add_parser("scan", help="run a scene with many values of its keys", description=SCAN)
    parser.add_argument("scene", type=Path, nargs="?", help="scene file (TOML)")
    values = "values for a key of the scene: 80:120:5 is 80, 85, ..., 120; several --set give all combinations"
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=FROM:TO:STEP",
        dest="settings",
        help=f"{values}; or KEY=VALUE,VALUE,...",
    )
    replicas = "number of runs for each set of values, with different random numbers"
    parser.add_argument("--replicas", type=at_least_one, default=1, metavar="N", help=replicas)
    parser.add_argument(
        "--steps", type=whole_number, metavar="N", help="number of steps, in place of that in the scene"
    )
    workers = "number of processes, one for each core if not given; 0 for this process only"
    parser.add_argument("--workers", type=whole_number, metavar="N", help=workers)
    parser.add_argument(
        "--seed", type=whole_number, default=0, metavar="N", help="seed of all random numbers (default: 0)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("scan"), metavar="FOLDER", help="folder for all files (default: scan)"
    )
    parser.add_argument("--plot", metavar="NAME", help="quantity in the picture (default: pressure)")
    parser.add_argument(
        "--status", type=Path, metavar="FOLDER", help="show the state of the scan in a folder, and run nothing"
    )
    for name in ("--overwrite", "--quiet"):
        parser.add_argument(name, **OPTIONS[name])
    parser.set_defaults(command=scan)


def _add_further_runs(commands: Any) -> None:
    text, file = (
        "Continue the run in an H5MD file and append to it.",
        ("file", "trajectory (.h5md) of a run from a scene file"),
    )
    parser = add_command(commands, resume, "go on with a run", file, "--quiet", description=text)
    parser.add_argument("--scene", metavar="TOML", help=OTHER_SCENE)
    parser.add_argument(
        "--steps",
        type=whole_number,
        metavar="N",
        help="number of further steps; if not given, up to the number in the scene",
    )
    text, file = (
        "Make the last steps of a failed run again, one by one.",
        ("file", "file (.crash.h5md) that the run left"),
    )
    parser = add_command(
        commands,
        replay,
        "make the last steps of a failed run again",
        file,
        "--scene",
        "--overwrite",
        "--quiet",
        description=text,
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="trajectory of the steps (.h5md); the picture is written beside it"
    )
    text = "Build a scene, let LAMMPS run it under MPI, and bring the result back as a file of minimd."
    parser = add_command(
        commands, lammps, "let LAMMPS run a scene file", SCENE_FILE, "--overwrite", "--quiet", description=text
    )
    parser.add_argument(
        "--processes", type=at_least_one, default=1, metavar="P", help="number of MPI processes, 1 if not given"
    )
    parser.add_argument(
        "--steps", type=at_least_one, metavar="N", help="number of steps, in place of that in the scene"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help="folder for all files; named after the scene if not given"
    )


def _add_readers(commands: Any) -> None:
    add_command(commands, check, "check a run for its conservation laws", RUN_FILE)
    parser = add_command(commands, plot, "draw the energies, the temperature and the structure of a run", RUN_FILE)
    parser.add_argument(
        "--out", type=Path, metavar="PNG", help="file of the picture; named after the trajectory if not given"
    )
    text = (
        "Write a run as one HTML page: its report, its pictures, its atoms in motion. For a failed run it shows the "
        "last steps and marks the pair."
    )
    file = ("file", "trajectory (.h5md), or file (.crash.h5md) that a failed run left")
    parser = add_command(
        commands, view, "show the atoms of a run in motion, in the browser", file, "--scene", description=text
    )
    parser.add_argument("--out", type=Path, metavar="HTML", help="file of the page; named after the run if not given")
    told = f"largest number of frames, evenly chosen (default: {FRAMES})"
    parser.add_argument("--frames", type=partial(whole_number, least=2), metavar="N", default=FRAMES, help=told)
    parser.add_argument("--open", action="store_true", help="show the page in the browser")
    text, shared = (
        "Make steps of a run with precision='fixed-point' again, from the frame before them.",
        ("--scene", "--overwrite"),
    )
    parser = add_command(
        commands, frames, "make any step of a run again", RUN_FILE, *shared, "--quiet", description=text
    )
    parser.add_argument("--at", type=whole_number, nargs="+", required=True, metavar="STEP", help="steps to make again")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="file to write; for several steps, the step is added to the name"
    )
    text = (
        "Keep few frames of a run with precision='fixed-point'. All steps in between can be made again from them, "
        "to the last bit."
    )
    parser = add_command(commands, archive, "make a run's file small", RUN_FILE, *shared, description=text)
    parser.add_argument(
        "--every", type=whole_number, required=True, metavar="N", help="keep the frames whose step is a multiple of N"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="the archive (.h5md); beside the file if not given")


def scene_of(arguments: argparse.Namespace) -> Any:
    """The minimd.scene.Scene in the file of --scene; None if it is not given."""
    from minimd.scene import load_scene

    return None if arguments.scene is None else load_scene(arguments.scene)


@contextmanager
def silence(quiet: bool) -> Iterator[None]:
    """If quiet, discard everything that is printed to both streams; errors are printed after this context."""
    with (
        redirect_stdout(io.StringIO() if quiet else sys.stdout),
        redirect_stderr(io.StringIO() if quiet else sys.stderr),
    ):
        yield


def run(arguments: argparse.Namespace) -> None:
    """Run a scene.  Raises as run_scene."""
    from minimd.scene import load_scene, run_scene

    scene, quiet = load_scene(arguments.scene), arguments.quiet
    for file in () if arguments.overwrite else scene.named_outputs(arguments.out):
        if file.exists():
            resume = f", or go on with the run: minimd resume {file}" if file.suffix.lower() == ".h5md" else ""
            raise FileExistsError(
                f"output {str(file)!r} exists; replace it with --overwrite, write elsewhere with --out FILE{resume}"
            )
    with silence(quiet):
        run_scene(
            scene, steps=arguments.steps, trajectory=arguments.out, overwrite=arguments.overwrite, progress=not quiet
        )
        tell_next(scene.trajectories(arguments.out))


def tell_next(files: Iterable[Path]) -> None:
    """Print the commands that check and show the files of a run."""
    from minimd.document.document import h5md_files

    for file in h5md_files(files):
        print(
            f"next           minimd check {file}\n               minimd plot {file}\n               minimd view {file}"
        )


def scan(arguments: argparse.Namespace) -> bool:
    """Scan a scene, or print the status of a scan; False if members have failed.  Raises as scan_scene."""
    from minimd.ensemble.scan import parsed_setting, scan_scene
    from minimd.ensemble.table import status

    if arguments.status is not None:
        table, lines = status(arguments.status)
        print("\n".join(lines))
        return tell_results(table, arguments)
    if arguments.scene is None:
        raise ValueError("minimd scan needs a scene file, or --status FOLDER to show the state of a scan")
    names = ("replicas", "steps", "workers", "seed")
    options: dict[str, Any] = {name: getattr(arguments, name) for name in names} | {
        "folder": arguments.out,
        "resume": not arguments.overwrite,
    }
    with silence(arguments.quiet):
        table = scan_scene(
            arguments.scene,
            [parsed_setting(text) for text in arguments.settings],
            progress=not arguments.quiet,
            **options,
        )
        print(table)
        return tell_results(table, arguments)


def tell_results(table: Any, arguments: argparse.Namespace) -> bool:
    """Print the averages, draw the picture, name the files; True if no member has failed."""
    from minimd.ensemble.table import save_picture, told_averages

    if table.done.any():
        print("\n".join(told_averages(table)))
        picture = save_picture(table, arguments.plot)
        print(f"written        {table.folder / 'table.csv'}, {table.folder / 'table.json'}, {picture}")
    return not any(table["status"] == "failed")


def resume(arguments: argparse.Namespace) -> None:
    """Go on with a run.  Raises as resume_run."""
    from minimd.scene import resume_run

    scene = scene_of(arguments)
    with silence(arguments.quiet):
        resume_run(arguments.file, arguments.steps, scene=scene, progress=not arguments.quiet)
        tell_next([arguments.file])


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
        seen = md.replay(
            arguments.file, scene and scene.potentials(), trajectory=out, picture=picture, overwrite=arguments.overwrite
        )
        print(seen)
        print(f"written        {', '.join(str(file) for file in (seen.trajectory, seen.picture) if file)}")


def lammps(arguments: argparse.Namespace) -> None:
    """Hand a scene over.  Raises as hand_over_scene."""
    from minimd.lammps.handing_over import TRAJECTORY
    from minimd.scene import load_scene
    from minimd.scene.running import hand_over_scene

    scene, quiet = load_scene(arguments.scene), arguments.quiet
    folder = arguments.out or Path(f"{scene.path.stem}-lammps")
    if folder.exists() and not arguments.overwrite:
        file = folder / TRAJECTORY
        resume = f", or go on with the run: minimd resume {file}" if file.exists() else ""
        raise FileExistsError(
            f"folder {str(folder)!r} exists; replace it with --overwrite, write elsewhere with --out FOLDER{resume}"
        )
    with silence(quiet):
        done = hand_over_scene(
            scene,
            folder,
            steps=arguments.steps,
            processes=arguments.processes,
            overwrite=arguments.overwrite,
            progress=not quiet,
        )
        tell_next([done.trajectory])


def check(arguments: argparse.Namespace) -> bool:
    """Print the check of a file; True if it passed.  Raises as check_file."""
    from minimd.analysis.check import check_file

    result = check_file(arguments.file)
    print(result)
    return result.passed


def plot(arguments: argparse.Namespace) -> None:
    """Draw the picture and print its name.  Raises as verify_frames and plot_file."""
    from minimd.analysis.plot import plot_file
    from minimd.files.h5md_reader import verify_frames

    verify_frames(arguments.file)
    picture = arguments.out or arguments.file.with_suffix(".png")
    word = "replaced" if picture.exists() else "written"
    print(f"drawing        {picture} ...", flush=True)
    print(f"{word:<14} {plot_file(arguments.file, picture)}")


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


def frames(arguments: argparse.Namespace) -> None:
    """Write a file for each step.  Raises as Simulation.resume."""
    import minimd as md

    scene, file = scene_of(arguments), arguments.file
    with silence(arguments.quiet):
        for step in arguments.at:
            out = arguments.out or file.with_name(f"{file.stem}-{step}.h5md")
            if arguments.out and len(arguments.at) > 1:
                out = out.with_name(f"{out.stem}-{step}{out.suffix}")
            simulation = md.Simulation.resume(file, scene and scene.potentials(), step=step)
            record = simulation.run(0, trajectory=out, overwrite=arguments.overwrite)
            energy, units = record.total_energy[0], simulation.system.units
            print(
                f"step {step:<9} t = {units.shown(simulation.time)}, total energy {energy!r} {units.energy}: written "
                f"to {out}"
            )


def archive(arguments: argparse.Namespace) -> None:
    """Write the archive and print its size.  Raises as minimd.archive."""
    import minimd as md

    scene, file = scene_of(arguments), arguments.file
    out = arguments.out or file.with_name(f"{file.stem}.archive.h5md")
    print(md.archive(file, out, arguments.every, scene and scene.potentials(), arguments.overwrite))
