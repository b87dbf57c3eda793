"""The command `minimd`: run a scene, go on with it, check and plot its file, and look at the machine."""

import argparse
import contextlib
import io
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from minimd.bench.command import DisagreementError, add_benchmarks
from minimd.compiled.machine import version
from minimd.structure.errors import ConstraintError, NonFiniteError

OK, FAILED, WRONG_INPUT, BLOWN_UP, INTERRUPTED = 0, 1, 2, 3, 130  # exit codes


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 a check failed, 2 wrong input, 3 blown up, 130 interrupted.

    Expected failures end in one sentence for each problem on standard error.
    """
    parser = _parser()
    arguments = parser.parse_args(argv)
    if "command" not in arguments:
        parser.print_help()
        return OK
    try:
        return arguments.command(arguments)
    except KeyboardInterrupt as error:
        return _failed(str(error) or "interrupted", INTERRUPTED)
    except (NonFiniteError, ConstraintError) as error:
        return _failed(str(error), BLOWN_UP)
    except DisagreementError as error:
        return _failed(str(error), FAILED)
    except OSError as error:
        return _failed(_about_file(error), WRONG_INPUT)
    except (ValueError, TypeError) as error:
        return _failed(str(error), WRONG_INPUT)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="minimd", description="Molecular dynamics from a scene file, in small.", epilog="Begin with: minimd doctor")
    parser.add_argument("--version", action="version", version=f"minimd {version('minimd')}")
    commands = parser.add_subparsers(metavar="command", title="commands")
    run = commands.add_parser("run", help="run a scene file", description="Build a scene, run it, and write its files.")
    run.add_argument("scene", help="scene file (TOML)")
    run.add_argument("--steps", type=_number_of_steps, metavar="N", help="instead of the steps in the scene")
    run.add_argument("--out", type=Path, metavar="FILE", help="one trajectory file instead of those in the scene; the picture lies beside it")
    run.add_argument("--overwrite", action="store_true", help="replace files that exist")
    resume = commands.add_parser("resume", help="go on with a run", description="Continue the run in an H5MD file and append to it.")
    resume.add_argument("file", type=Path, help="trajectory (.h5md) of a run from a scene file")
    resume.add_argument("--steps", type=_number_of_steps, metavar="N", help="how many more steps; up to the end of the scene if not given")
    resume.add_argument("--scene", metavar="TOML", help="take the potentials from this scene file, instead of the one stored in the run")
    replay = commands.add_parser("replay", help="see a failed run fail again", description="Make the last steps of a failed run again, one by one.")
    replay.add_argument("file", type=Path, help="file (.crash.h5md) that the run left")
    replay.add_argument("--scene", metavar="TOML", help="take the potentials from this scene file, instead of the one stored in the run")
    replay.add_argument("--out", type=Path, metavar="FILE", help="trajectory of the steps (.h5md); the picture lies beside it")
    replay.add_argument("--overwrite", action="store_true", help="replace files that exist")
    for command, function in ((run, _run), (resume, _resume), (replay, _replay)):
        command.add_argument("--quiet", action="store_true", help="print nothing but errors")
        command.set_defaults(command=function)
    check = commands.add_parser("check", help="check a run for its conservation laws")
    plot = commands.add_parser("plot", help="draw the energies, the temperature and the structure of a run")
    for command, function in ((check, _check), (plot, _plot)):
        command.add_argument("file", type=Path, help="trajectory (.h5md)")
        command.set_defaults(command=function)
    plot.add_argument("--out", type=Path, metavar="PNG", help="picture, named after the trajectory if not given")
    add_benchmarks(commands.add_parser("bench", help="time minimd: beside other engines, and run time against error"))
    commands.add_parser("doctor", help="look at this machine and test minimd on it").set_defaults(command=_doctor)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from minimd.scene import load_scene, run_scene

    scene = load_scene(arguments.scene)
    files = scene.trajectories() if arguments.out is None else [arguments.out]
    if not arguments.overwrite:
        plot = scene.sections.output.plot
        _refuse_existing([*files, Path(plot)] if isinstance(plot, str) and arguments.out is None else files)
    with _silence(arguments.quiet):
        run_scene(
            scene,
            steps=arguments.steps,
            trajectory=arguments.out,
            overwrite=arguments.overwrite,
            progress=not arguments.quiet,
        )
        _tell_next(files)
    return OK


def _resume(arguments: argparse.Namespace) -> int:
    from minimd.scene import load_scene, resume_run

    scene = None if arguments.scene is None else load_scene(arguments.scene)
    with _silence(arguments.quiet):
        resume_run(arguments.file, arguments.steps, scene=scene, progress=not arguments.quiet)
        _tell_next([arguments.file])
    return OK


def _replay(arguments: argparse.Namespace) -> int:
    from minimd.files.crash_file import read_crash_report
    from minimd.replay import replay
    from minimd.scene import load_scene

    potentials = None if arguments.scene is None else load_scene(arguments.scene).potentials()
    out, picture = (True, True) if arguments.out is None else (arguments.out, arguments.out.with_suffix(".png"))
    with _silence(arguments.quiet):
        print(read_crash_report(arguments.file).findings, flush=True)
        seen = replay(arguments.file, potentials, trajectory=out, picture=picture, overwrite=arguments.overwrite)
        print(seen)
        print(f"written        {', '.join(str(file) for file in (seen.trajectory, seen.picture) if file)}")
    return OK


def _check(arguments: argparse.Namespace) -> int:
    from minimd.analysis.check import check_file

    result = check_file(arguments.file)
    print(result)
    return OK if result.passed else FAILED


def _plot(arguments: argparse.Namespace) -> int:
    from minimd.analysis.plot import plot_file

    picture = arguments.file.with_suffix(".png") if arguments.out is None else arguments.out
    word = "replaced" if picture.exists() else "written"
    print(f"drawing        {picture} ...", flush=True)
    print(f"{word:<14} {plot_file(arguments.file, picture)}")
    return OK


def _doctor(_arguments: argparse.Namespace) -> int:
    from minimd.commands.doctor import examine

    return OK if examine() else FAILED


def _refuse_existing(files: Iterable[Path]) -> None:
    for file in files:
        if file.exists():
            resume = f", or go on with the run: minimd resume {file}" if file.suffix.lower() == ".h5md" else ""
            raise FileExistsError(f"output {str(file)!r} exists; replace it with --overwrite, write elsewhere with --out FILE{resume}")


def _tell_next(files: Sequence[Path]) -> None:
    for file in files:
        if file.suffix.lower() == ".h5md":
            print(f"next           minimd check {file}\n               minimd plot {file}")


@contextlib.contextmanager
def _silence(quiet: bool) -> Iterator[None]:
    """Swallow what is printed, on both streams, if quiet; errors are printed after it."""
    with contextlib.ExitStack() as stack:
        if quiet:
            stack.enter_context(contextlib.redirect_stdout(io.StringIO()))
            stack.enter_context(contextlib.redirect_stderr(io.StringIO()))
        yield


def _about_file(error: OSError) -> str:
    """An error of the operating system with the name of its file, if it has one."""
    if error.strerror is None:
        return str(error)
    return error.strerror if error.filename is None else f"{os.fsdecode(error.filename)}: {error.strerror}"


def _failed(message: str, code: int) -> int:
    sys.stdout.flush()
    for line in message.splitlines():
        print(f"minimd: error: {line}", file=sys.stderr)
    return code


def _number_of_steps(text: str) -> int:
    try:
        number = int(text.replace("_", ""))
    except ValueError:
        number = -1
    if number < 0:
        raise argparse.ArgumentTypeError(f"the number of steps must be a whole number, at least 0; it is {text!r}")
    return number


if __name__ == "__main__":
    sys.exit(main())
