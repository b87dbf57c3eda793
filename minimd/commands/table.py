"""The commands, each a row: its function, its help, its arguments; and those that make runs or read their files.

A command of another package is a Command that an entry point of the group "minimd.commands" names.
"""

import ast
import json
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import minimd as md
from minimd.view.viewing import FRAMES


class Argument(NamedTuple):
    """One argument.
    name : with dashes for an option.
    more : further ones for argparse."""

    name: str
    help: str
    kind: Callable[[str], Any] | None = None
    metavar: str | None = None
    more: dict[str, Any] = {}  # noqa: RUF012 - never changed


class Command(NamedTuple):
    """One command.
    run : called with the parsed arguments; returns False if a check failed.
    help : in the list of all commands.
    below : its own commands, one of which must be named unless it can run without.
    epilog : after its help."""

    name: str
    help: str
    description: str
    arguments: tuple[Argument, ...] = ()
    run: Callable[[Namespace], Any] | None = None
    below: tuple["Command", ...] = ()
    epilog: str | None = None


def flag(name: str, text: str) -> Argument:
    """An option that is given or not."""
    return Argument(name, text, more={"action": "store_true"})


QUIET = flag("--quiet", "print only errors")  # of all commands


def add(parsers: Any, command: Command) -> None:
    """Add a command to the subparsers of argparse."""
    parser: ArgumentParser = parsers.add_parser(
        command.name, help=command.help, description=command.description, epilog=command.epilog
    )
    parser.set_defaults(command=command.run, refuse=parser.error)
    for argument in command.arguments if command.below else (*command.arguments, QUIET):
        options = dict(argument.more)
        if argument.kind is not None:
            options["type"] = argument.kind
        if argument.metavar is not None:
            options["metavar"] = argument.metavar
        parser.add_argument(argument.name, help=argument.help, **options)
    if command.below:
        word = f"{command.name}mark"
        is_needed = command.run is None
        subparsers = parser.add_subparsers(metavar=word, title=f"{word}s", required=is_needed)
        for below in command.below:
            add(subparsers, below)


def whole_number(text: str, least: int = 0) -> int:
    """A whole number, for argparse.
    Raises ArgumentTypeError for any other text, or a number that is too small."""
    digits = text.replace("_", "")
    if not digits.isdecimal() or int(digits) < least:
        raise ArgumentTypeError(f"must be a whole number, at least {least}; it is {text!r}")
    return int(digits)


def written_to(metavar: str, text: str, **more: Any) -> Argument:
    """Where a command writes."""
    return Argument("--out", text, Path, metavar, more)


def scene_of(arguments: Namespace) -> Any:
    """The minimd.scene.Scene in the file that is named; None if there is none."""
    from minimd.scene import load_scene

    return None if arguments.scene is None else load_scene(arguments.scene)


def potentials_of(arguments: Namespace) -> Any:
    """The potentials of the file of --scene; None if it is not given."""
    return arguments.scene and scene_of(arguments).potentials()


def refuse(what: str, place: Path, run: Path, metavar: str) -> NoReturn:
    """Raise FileExistsError for an output; it says how to go on with the run in a file, if there is one."""
    message = f"{what} {str(place)!r} exists; write elsewhere with --out {metavar}, delete it with --overwrite"
    if run.suffix.lower() == ".h5md" and run.exists():
        message += f", or go on with the run: minimd resume {run}"
    raise FileExistsError(message)


def drawing(file: Path) -> str:
    """Tell that a picture or a page is being drawn; returns the word for the end.
    Raises OSError, ValueError for a place where it cannot be written."""
    from minimd.core.files.trajectory import checked_output

    checked_output(file, overwrite=True, suffixes=(file.suffix.lower(),))
    print(f"drawing        {file} ...", flush=True)
    return "replaced" if file.exists() else "written"


def tell_next(files: Iterable[Path]) -> None:
    """Print the commands that check and show the files of a run."""
    from minimd.scene.document import h5md_files

    for file in h5md_files(files):
        print(f"next           minimd check {file}")
        print(f"               minimd plot {file}")
        print(f"               minimd view {file}")


def run(arguments: Namespace) -> None:
    """Run a scene.
    Raises as run_scene."""
    from minimd.scene import run_scene

    scene = scene_of(arguments)
    out = arguments.out
    overwrite = arguments.overwrite
    for file in () if overwrite else scene.named_outputs(out):
        if file.exists():
            refuse("output", file, file, "FILE")
    run_scene(
        scene,
        steps=arguments.steps,
        trajectory=out,
        overwrite=overwrite,
        max_seconds=arguments.max_seconds,
        progress=not arguments.quiet,
    )
    tell_next(scene.trajectories(out))


def scan(arguments: Namespace) -> bool:
    """Scan a scene, or print the status of a scan, with averages and picture; False if members have failed.
    Raises as scan_scene."""
    from minimd.ensemble.scan import parsed_setting, scan_scene
    from minimd.ensemble.table import save_picture, status
    from minimd.ensemble.workers import named_executor

    if arguments.status is not None:
        table, lines = status(arguments.status)
    elif arguments.scene is None:
        raise ValueError(
            "minimd scan needs a scene file, or --status FOLDER to show the state of a scan"
        )
    else:
        names = ("replicas", "steps", "seed", "members", "retries")
        options: dict[str, Any] = {name: getattr(arguments, name) for name in names}
        options |= {
            "folder": arguments.out,
            "resume": not arguments.overwrite,
            "progress": not arguments.quiet,
            "plot": arguments.plot,
        }
        with named_executor(arguments.executor, arguments.workers) as workers:
            if workers is None:
                return True
            settings = [parsed_setting(text) for text in arguments.settings]
            table = scan_scene(arguments.scene, settings, **options, **workers)
        lines = [str(table)]
    print("\n".join(lines))
    if table.done.any() and arguments.members is None:
        files = [save_picture(table, arguments.plot)]
        if arguments.status is None:
            files = [table.folder / "table.csv", table.folder / "table.json", *files]
        print(f"written        {', '.join(map(str, files))}")
    members = arguments.members or range(len(table))
    return not any(table["status"][members.start : members.stop] == "failed")


def slice_of_members(text: str) -> range:
    """FROM:TO, for argparse."""
    first, _, end = text.partition(":")
    return range(whole_number(first), whole_number(end))


def resume(arguments: Namespace) -> None:
    """Go on with a run.
    Raises as resume_run."""
    from minimd.scene import resume_run

    resume_run(
        arguments.file,
        arguments.steps,
        until_step=arguments.until_step,
        scene=scene_of(arguments),
        max_seconds=arguments.max_seconds,
        progress=not arguments.quiet,
    )
    tell_next([arguments.file])


def replay(arguments: Namespace) -> None:
    """Print the crash report and make the steps.
    Raises as verify_frames and minimd.replay."""
    from minimd.core.files.crash_file import read_crash_report
    from minimd.core.files.h5md_reader import verify_frames

    verify_frames(arguments.file)
    potentials = potentials_of(arguments)
    names = {}
    if arguments.out is not None:
        names = {"trajectory": arguments.out, "picture": arguments.out.with_suffix(".png")}
    print(read_crash_report(arguments.file).findings, flush=True)
    result = md.replay(arguments.file, potentials, overwrite=arguments.overwrite, **names)
    print(result)
    files = [str(file) for file in (result.trajectory, result.picture) if file]
    print(f"written        {', '.join(files)}")


def lammps(arguments: Namespace) -> None:
    """Hand a scene over.
    Raises as hand_over_scene."""
    from minimd.lammps.handing_over import TRAJECTORY
    from minimd.scene.running import hand_over_scene

    scene = scene_of(arguments)
    folder = arguments.out or Path(f"{scene.path.stem}-lammps")
    if folder.exists() and not arguments.overwrite:
        refuse("folder", folder, folder / TRAJECTORY, "FOLDER")
    result = hand_over_scene(
        scene,
        folder,
        steps=arguments.steps,
        processes=arguments.processes,
        overwrite=arguments.overwrite,
        progress=not arguments.quiet,
    )
    tell_next([result.trajectory])


def check(arguments: Namespace) -> bool:
    """Print the check of a file; True if it passed.
    Raises as check_file."""
    from minimd.view.check import check_file

    result = check_file(arguments.file)
    print(result)
    return result.passed


def plot(arguments: Namespace) -> None:
    """Draw the picture and print its name.
    Raises as verify_frames, drawing and plot_file."""
    from minimd.core.files.h5md_reader import verify_frames
    from minimd.view.plot import plot_file

    verify_frames(arguments.file)
    picture = arguments.out or arguments.file.with_suffix(".png")
    word = drawing(picture)
    print(f"{word:<14} {plot_file(arguments.file, picture)}")


def view(arguments: Namespace) -> None:
    """Write the page and print its name.
    Raises as verify_frames, drawing and minimd.view."""
    from minimd.core.files.h5md_reader import verify_frames

    verify_frames(arguments.file)
    potentials = potentials_of(arguments)
    page = arguments.out or arguments.file.with_suffix(".html")
    word = drawing(page)
    result = md.view(arguments.file, frames=arguments.frames, potentials=potentials)
    result.save(page)
    print(f"{word:<14} {page}: {result.summary}, {page.stat().st_size / 1e6:.1f} MB")
    if arguments.open:
        import webbrowser

        webbrowser.open(page.resolve().as_uri())


def frames(arguments: Namespace) -> None:
    """Write a file for each step.
    Raises as minimd.Past."""
    file = arguments.file
    progress = False if arguments.quiet else None
    past = md.Past(file, potentials_of(arguments))
    for step in arguments.at:
        out = arguments.out
        if out is None:
            out = file.with_name(f"{file.stem}-{step}.h5md")
        elif len(arguments.at) > 1:
            out = out.with_name(f"{out.stem}-{step}{out.suffix}")
        simulation = past.at(step, progress=progress)
        record = simulation.run(0, trajectory=out, overwrite=arguments.overwrite)
        units = simulation.system.units
        time = units.shown(simulation.time)
        energy = float(record.total_energy[0])
        print(
            f"step {step:<9} t = {time}, total energy {energy!r} {units.energy}: written to {out}"
        )


def archive(arguments: Namespace) -> None:
    """Write the archive and print its size.
    Raises as minimd.archive."""
    file = arguments.file
    out = arguments.out or file.with_name(f"{file.stem}.archive.h5md")
    potentials = potentials_of(arguments)
    print(md.archive(file, out, arguments.every, potentials, arguments.overwrite))


def doctor(arguments: Namespace) -> Any:
    """Print what is found about this machine; False if a test of it fails."""
    from minimd.commands.doctor import clear_cache, examine

    return clear_cache() if arguments.clear_cache else examine()


def grade(arguments: Namespace) -> bool:
    """Print the grade of a class of dynamics, or of a step; True if it passed.
    Raises ValueError for one that is not there."""
    from minimd.judge.grading import is_step
    from minimd.judge.telling import as_dict, draw, named

    function = named(arguments.dynamics)
    kind = "step" if is_step(function) else "dynamics"
    result = md.grade(function, kind=kind, **dict(arguments.options))
    print(json.dumps(as_dict(result), indent=1) if arguments.json else result)
    if arguments.out:
        draw(result, arguments.out)
    return result.passed is True


def option(text: str) -> tuple[str, Any]:
    """NAME=VALUE, for argparse: a number, a list or another literal of Python, else a text."""
    name, _, value = text.partition("=")
    with suppress(ValueError, SyntaxError):
        return name, ast.literal_eval(value)
    return name, value


at_least_one = partial(whole_number, least=1)
OVERWRITE = flag("--overwrite", "replace files that exist")
STEPS = Argument("--steps", "number of steps, in place of that in the scene", whole_number, "N")
MAX_SECONDS = Argument(
    "--max-seconds",
    "wall time after which the run ends, with exit code 4; it can be resumed",
    float,
    "S",
)
SCENE_FILE = Argument("scene", "scene file (TOML)", Path)
RUN_FILE = Argument("file", "trajectory (.h5md)", Path)
SCENE = Argument(
    "--scene",
    "take the potentials from this scene file, not from the scene stored in the run",
    metavar="TOML",
)
COMMANDS = (
    Command("run", "run a scene file", "Build a scene, run it, and write its files.", (
        SCENE_FILE, OVERWRITE, STEPS, MAX_SECONDS,
        written_to("FILE", "one trajectory file, in place of those in the scene; the picture is written beside it"),
    ), run),
    Command("scan", "run a scene with many values of its keys",
            "Run a scene with different values of its keys, each run with its own file, and average. Give the same "
            "command again to go on with a stopped scan; more replicas or steps add to the runs there. Example: "
            "minimd scan argon.toml --set dynamics.temperature_K=80:120:5 --replicas 4 --workers 2 --out scan", (
        SCENE_FILE._replace(more={"nargs": "?"}),
        Argument("--set", "values for a key of the scene: 80:120:5 is 80, 85, ..., 120; several --set give all "
                 "combinations; or KEY=VALUE,VALUE,...", None, "KEY=FROM:TO:STEP",
                 {"action": "append", "default": [], "dest": "settings"}),
        Argument("--replicas", "number of runs for each set of values, with different random numbers", at_least_one,
                 "N", {"default": 1}),
        STEPS,
        Argument("--executor", "who makes the runs: processes of this machine (if not given), threads of this process; "
                 "dask, from the scheduler in DASK_SCHEDULER_ADDRESS, or on this machine; mpi, the processes of the "
                 "mpiexec that begins the command", metavar="NAME", more={"default": "processes"}),
        Argument("--workers", "number of processes or threads of this machine, one for each core if not given; 0 for "
                 "this process only (dask starts at least one worker)", whole_number, "N"),
        Argument("--members", "make only these runs, from FROM to TO - 1; other commands may make others in the same "
                 "folder at the same time", slice_of_members, "FROM:TO"),
        Argument("--retries", "how often a run is tried again if its worker died, or after an error of files or memory",
                 whole_number, "N", {"default": 0}),
        Argument("--seed", "seed of all random numbers (default: 0)", whole_number, "N", {"default": 0}),
        written_to("FOLDER", "folder for all files (default: scan)", default=Path("scan")),
        Argument("--plot", "quantity in the picture (default: pressure)", None, "NAME"),
        Argument("--status", "show the state of the scan in a folder, and run nothing", Path, "FOLDER"),
        flag("--overwrite", "delete all members in the folder, and begin anew"),
    ), scan),
    Command("resume", "go on with a run", "Continue the run in an H5MD file and append to it.", (
        RUN_FILE._replace(help="trajectory (.h5md) of a run from a scene file"),
        SCENE._replace(help="use this scene, from now on, in place of the one stored in the run: potentials, method, "
                       "time step, barostat, output; structure, minimization and equilibration, which concern only the "
                       "start, are not used"),
        STEPS._replace(help="number of further steps; if not given, up to the number in the scene"),
        Argument("--until-step", "the step at which the run ends, in place of a number of further steps", whole_number,
                 "N"),
        MAX_SECONDS,
    ), resume),
    Command("replay", "make the last steps of a failed run again",
            "Make the last steps of a failed run again, one by one.", (
        RUN_FILE._replace(help="file (.crash.h5md) that the run left"), SCENE, OVERWRITE,
        written_to("FILE", "trajectory of the steps (.h5md); the picture is written beside it"),
    ), replay),
    Command("lammps", "let LAMMPS run a scene file",
            "Build a scene, let LAMMPS run it under MPI, and bring the result back as a file of minimd.", (
        SCENE_FILE, OVERWRITE,
        Argument("--processes", "number of MPI processes, 1 if not given", at_least_one, "P", {"default": 1}),
        STEPS._replace(kind=at_least_one),
        written_to("FOLDER", "folder for all files; named after the scene if not given"),
    ), lammps),
    Command("check", "check a run for its conservation laws", "Check a run for its conservation laws.", (RUN_FILE,),
            check),
    Command("grade", "test a class of dynamics, or a step",
            "Test a class of dynamics, as those of ase.md, in scenes with exact answers: does it sample the ensemble "
            "that it claims? Or a function step(x, v, force, m, dt): which laws does it obey? "
            "Example: minimd grade ase.md.langevin:Langevin temperature_K=300 friction=0.2", (
        Argument("dynamics", "module:class, or file.py:class; or the function of a step", None, "MODULE:CLASS"),
        Argument("options", "options of the class, in ASE units, and of md.grade: ensemble, runs, constraints, …",
                 option, "NAME=VALUE", {"nargs": "*"}),
        flag("--json", "print JSON"), written_to("PNG", "draw a picture"),
    ), grade),
    Command("plot", "draw the energies, the temperature and the structure of a run",
            "Draw the energies, the temperature and the structure of a run.", (
        RUN_FILE, written_to("PNG", "file of the picture; named after the trajectory if not given"),
    ), plot),
    Command("view", "show the atoms of a run in motion, in the browser",
            "Write a run as one HTML page: its report, its pictures, its atoms in motion. For a failed run the page "
            "shows the last steps and marks the pair of atoms to blame.", (
        RUN_FILE._replace(help="trajectory (.h5md), or file (.crash.h5md) that a failed run left"), SCENE,
        written_to("HTML", "file of the page; named after the run if not given"),
        Argument("--frames", f"largest number of frames, evenly chosen (default: {FRAMES})",
                 partial(whole_number, least=2), "N", {"default": FRAMES}),
        flag("--open", "show the page in the browser"),
    ), view),
    Command("frames", "make any step of a run again",
            "Compute steps of a run with precision='fixed-point' again, each from the nearest frame.", (
        RUN_FILE, SCENE, OVERWRITE,
        Argument("--at", "steps to make again", whole_number, "STEP", {"nargs": "+", "required": True}),
        written_to("FILE", "file to write; for several steps, the step is added to the name"),
    ), frames),
    Command("archive", "make a run's file small",
            "Copy few frames of a run with precision='fixed-point' to a new file. All steps between these frames can "
            "be computed again, to the last bit.", (
        RUN_FILE, SCENE, OVERWRITE,
        Argument("--every", "copy the frames whose step is a multiple of N", whole_number, "N", {"required": True}),
        written_to("FILE", "the archive (.h5md); beside the file if not given"),
    ), archive),
    Command("doctor", "describe this machine and test minimd on it",
            "Describe this machine, and test minimd on it: forces, conservation laws, equal bits on all threads, "
            "speed.", (flag("--clear-cache", "only remove the compiled kernels, of all versions of minimd"),), doctor),
)  # fmt: skip
