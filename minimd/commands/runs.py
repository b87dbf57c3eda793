"""The commands that make runs, and those that read their files: everything but `minimd bench` and `minimd doctor`."""

import argparse
import io
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

from minimd.commands.table import (
    OVERWRITE,
    QUIET,
    STEPS,
    Argument,
    Command,
    at_least_one,
    flag,
    whole_number,
    written_to,
)
from minimd.view.viewing import FRAMES

SCENE_FILE = Argument("scene", "scene file (TOML)", Path)
RUN_FILE = Argument("file", "trajectory (.h5md)", Path)
SCENE = Argument(
    "--scene", "take the potentials from this scene file, not from the scene stored in the run", metavar="TOML"
)


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


OTHER_SCENE = """use this scene, from now on, in place of the one stored in the run: potentials, method, time step,
bath, output; structure, minimization and equilibration, which concern only the start, are not used"""
SCAN = """Run a scene with different values of its keys, each run with its own file, and average. The same command goes
on where it was stopped; with more replicas or steps it adds to the runs that are there. Example:
minimd scan argon.toml --set dynamics.temperature_K=80:120:5 --replicas 4 --workers 2 --out scan"""
REPLICAS = "number of runs for each set of values, with different random numbers"
SETTINGS = """values for a key of the scene: 80:120:5 is 80, 85, ..., 120; several --set give all combinations; or
KEY=VALUE,VALUE,..."""
VIEW = """Write a run as one HTML page: its report, its pictures, its atoms in motion. For a failed run it shows the
last steps and marks the pair."""
ARCHIVE = """Keep few frames of a run with precision='fixed-point'. All steps in between can be made again from them, to
the last bit."""
LAMMPS = "Build a scene, let LAMMPS run it under MPI, and bring the result back as a file of minimd."
MOST = f"largest number of frames, evenly chosen (default: {FRAMES})"
PICTURE = "draw the energies, the temperature and the structure of a run"
AGAIN = "Make steps of a run with precision='fixed-point' again, from the frame before them."
COMMANDS = (
    Command("run", "run a scene file", "Build a scene, run it, and write its files.", (
        SCENE_FILE, OVERWRITE, QUIET, STEPS,
        written_to("FILE", "one trajectory file, in place of those in the scene; the picture is written beside it"),
    ), run),
    Command("scan", "run a scene with many values of its keys", SCAN, (
        SCENE_FILE._replace(more={"nargs": "?"}),
        Argument("--set", SETTINGS, None, "KEY=FROM:TO:STEP", {"action": "append", "default": [], "dest": "settings"}),
        Argument("--replicas", REPLICAS, at_least_one, "N", {"default": 1}),
        STEPS,
        Argument("--workers", "number of processes, one for each core if not given; 0 for this process only",
                 whole_number, "N"),
        Argument("--seed", "seed of all random numbers (default: 0)", whole_number, "N", {"default": 0}),
        written_to("FOLDER", "folder for all files (default: scan)", default=Path("scan")),
        Argument("--plot", "quantity in the picture (default: pressure)", None, "NAME"),
        Argument("--status", "show the state of the scan in a folder, and run nothing", Path, "FOLDER"),
        OVERWRITE, QUIET,
    ), scan),
    Command("resume", "go on with a run", "Continue the run in an H5MD file and append to it.", (
        RUN_FILE._replace(help="trajectory (.h5md) of a run from a scene file"), QUIET,
        SCENE._replace(help=OTHER_SCENE),
        STEPS._replace(help="number of further steps; if not given, up to the number in the scene"),
    ), resume),
    Command("replay", "make the last steps of a failed run again",
            "Make the last steps of a failed run again, one by one.", (
        RUN_FILE._replace(help="file (.crash.h5md) that the run left"), SCENE, OVERWRITE, QUIET,
        written_to("FILE", "trajectory of the steps (.h5md); the picture is written beside it"),
    ), replay),
    Command("lammps", "let LAMMPS run a scene file", LAMMPS, (
        SCENE_FILE, OVERWRITE, QUIET,
        Argument("--processes", "number of MPI processes, 1 if not given", at_least_one, "P", {"default": 1}),
        STEPS._replace(kind=at_least_one),
        written_to("FOLDER", "folder for all files; named after the scene if not given"),
    ), lammps),
    Command("check", "check a run for its conservation laws", "Check a run for its conservation laws.", (RUN_FILE,),
            check),
    Command("plot", PICTURE, "Draw the energies, the temperature and the structure of a run.", (
        RUN_FILE, written_to("PNG", "file of the picture; named after the trajectory if not given"),
    ), plot),
    Command("view", "show the atoms of a run in motion, in the browser", VIEW, (
        RUN_FILE._replace(help="trajectory (.h5md), or file (.crash.h5md) that a failed run left"), SCENE,
        written_to("HTML", "file of the page; named after the run if not given"),
        Argument("--frames", MOST, partial(whole_number, least=2), "N", {"default": FRAMES}),
        flag("--open", "show the page in the browser"),
    ), view),
    Command("frames", "make any step of a run again", AGAIN, (
        RUN_FILE, SCENE, OVERWRITE, QUIET,
        Argument("--at", "steps to make again", whole_number, "STEP", {"nargs": "+", "required": True}),
        written_to("FILE", "file to write; for several steps, the step is added to the name"),
    ), frames),
    Command("archive", "make a run's file small", ARCHIVE, (
        RUN_FILE, SCENE, OVERWRITE,
        Argument("--every", "keep the frames whose step is a multiple of N", whole_number, "N", {"required": True}),
        written_to("FILE", "the archive (.h5md); beside the file if not given"),
    ), archive),
)  # fmt: skip
