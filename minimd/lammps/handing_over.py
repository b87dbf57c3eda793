"""Handing a simulation over to LAMMPS: it is written, verified at step 0, run under MPI, and read back.

Frames are read from LAMMPS' binary dumps of all atoms (dump custom, suffix .bin; format 2 of 2020).
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import Any, BinaryIO
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from minimd.console.display import Displayed, Rows
from minimd.console.progress import progress_of
from minimd.console.signals import stop_on_signals
from minimd.engine.observation import check_extras, observe
from minimd.engine.record import Record
from minimd.files.claim import write_whole
from minimd.files.trajectory import open_trajectories
from minimd.integrators import LangevinBAOAB
from minimd.lammps import script
from minimd.lammps.box import IMAGES, Box
from minimd.lammps.model import Model
from minimd.lammps.program import INSTALL, OUTPUT, Log, Program, find_program, run
from minimd.lammps.verification import LEAST, Verification, compare, in_both, tails_of
from minimd.simulation.simulation import Simulation
from minimd.structure.checks import checked_count, checked_flag
from minimd.structure.errors import HandOverError, sentence

MAGIC = b"DUMPCUSTOM"


def frames(path: Path, n_atoms: int) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """For each frame, its step and all columns but the first, (N, C); the first must be the id, which orders the rows.

    A frame that is cut off or lacks atoms ends the iteration.  Raises ValueError for a file that is not such a dump.
    """
    with path.open("rb") as file:
        while file.peek(1):  # type: ignore[attr-defined]
            try:
                yield _frame(file, n_atoms)
            except EOFError:
                return


def _frame(file: BinaryIO, expected: int) -> tuple[int, NDArray[np.float64]]:
    length = -_read(file, "q")
    if length != len(MAGIC) or _exactly(file, length) != MAGIC or _read(file, "i") != 1:
        raise ValueError("LAMMPS has written a dump in a format that minimd does not know; use LAMMPS of 2021 or later")
    _read(file, "i")  # revision
    step, n_atoms, tilted = _read(file, "q"), _read(file, "q"), _read(file, "i")
    if n_atoms != expected:
        raise EOFError
    _exactly(file, 6 * 4 + (9 if tilted else 6) * 8)  # boundaries and box
    n_columns = _read(file, "i")
    _exactly(file, _read(file, "i"))  # unit style
    if _read(file, "b"):
        _read(file, "d")  # time
    _exactly(file, _read(file, "i"))  # names of the columns
    rows, filled = np.empty((n_atoms, n_columns - 1)), 0
    for _ in range(_read(file, "i")):  # processes
        n_numbers = _read(file, "i")
        part = np.frombuffer(_exactly(file, 8 * n_numbers)).reshape(-1, n_columns)
        rows[part[:, 0].astype(np.int64) - 1] = part[:, 1:]
        filled += len(part)
    if filled != n_atoms:
        raise EOFError
    return step, rows


def _read(file: BinaryIO, kind: str) -> Any:
    return struct.unpack(kind, _exactly(file, struct.calcsize(kind)))[0]


def _exactly(file: BinaryIO, n_bytes: int) -> bytes:
    """The next n_bytes bytes.  Raises EOFError if there are fewer."""
    read = file.read(n_bytes)
    if len(read) < n_bytes:
        raise EOFError
    return read


TRAJECTORY = "run.h5md"
BYTES_PER_ATOM, BYTES_PER_FRAME = 450, 130  # of the input and of step 0; of a frame in the files of LAMMPS and minimd
DISAGREEMENT = 1e-8  # of Σ|e_i|, allowed between the energies of LAMMPS and minimd in a frame: more than rounding
MOST_STEPS = 2**31  # one run of LAMMPS makes fewer

Tell = Callable[[str], object]


@dataclass(frozen=True)
class HandOver(Displayed):
    """The result of a hand-over.

    folder : of all files.  trajectory : the H5MD file, from which Simulation.resume goes on.  record :
        Record of its frames.
    verification : of step 0.  energy_difference : largest difference, in all frames, of the potential energies of
        LAMMPS and minimd, as a fraction of the largest of Verification.scale,
        the potential energy of the frame and its N k_B T.
    seconds : of each phase.  version : of LAMMPS.  processes : their number.
    """

    folder: Path
    trajectory: Path
    record: Record
    verification: Verification
    energy_difference: float
    seconds: dict[str, float]
    version: str
    processes: int

    def display_rows(self) -> Rows:
        """See Displayed."""
        times = ", ".join(f"{name} {seconds:.3g} s" for name, seconds in self.seconds.items())
        return [
            ("LAMMPS", f"{self.version}, on {self.processes} process{'es' * (self.processes > 1)}"),
            ("verified", f"{self.verification}"),
            (
                "frames",
                f"{len(self.record)}; potential energies differ by at most {self.energy_difference:.1e} of Σ|e_i| or N "
                "k_B T",
            ),
            ("time", times),
            ("written", str(self.trajectory)),
        ]


def not_carried_over(simulation: Simulation) -> list[str]:
    """The promises of minimd that a run by LAMMPS does not keep, one sentence each."""
    engine, method, extra = simulation.engine, simulation.method, simulation.engine.extra_observables
    rows = {  # sentence: whether it applies
        "exact restart: bits depend on the number of processes, and on where LAMMPS ended; minimd goes on from "
        "positions and velocities only": True,
        f"noise: its bath is LAMMPS' {script.BATHS.get(type(method))}, with random numbers that depend on the number "
        "of processes": method.is_thermostat,
        "order of the bath: fix langevin adds friction and noise to the forces of velocity Verlet, and its errors "
        "of order Δt² differ": isinstance(method, LangevinBAOAB),
        f"{', '.join(extra)}: computed by minimd for each frame, not by LAMMPS": len(extra) > 0,
        "fixed-point arithmetic: LAMMPS computes in double precision": engine.interactions.options.precision
        != "double",
        f"exact lengths: fix shake keeps them to {script.SHAKE_TOLERANCE:g} by iteration": engine.constraint_set.bonds
        is not None,
        "observers, crash reports and the run guard: a run of LAMMPS that fails ends with LAMMPS' own error, and the "
        "frames before it are kept": True,
    }
    return [sentence for sentence, applies in rows.items() if applies]


def hand_over(
    simulation: Simulation,
    folder: str | Path,
    steps: int,
    *,
    processes: int = 1,
    every: int = 100,
    store_forces: bool = False,
    overwrite: bool = False,
    progress: bool | None = None,
    tell: Tell | None = print,
) -> HandOver:
    """Let LAMMPS make the next steps of a simulation.

    Afterwards the simulation is in the state in which LAMMPS ended, and can go on.

    The scene is written for LAMMPS from the same laws. LAMMPS evaluates it at step 0; energy, force and virial of each
    atom must agree with those of minimd to 1e-10 of the largest, or nothing is run. Then LAMMPS runs as a child
    process, under mpiexec for several processes. Its frames are read back, observed by minimd,
    and written to an H5MD file with a restart.

    Parameters
    ----------
    folder : for all files; it must not exist, or must be empty.  steps : number of steps.  processes :
        number of MPI processes.
    every : steps between frames: the first state, and then those whose step is a multiple of every.  store_forces :
        also write forces.
    overwrite : replace the folder.  progress : as for Simulation.run.  tell : called with lines about the hand-over;
        None for silence.

    Raises
    ------
    FileNotFoundError : if LAMMPS is not found, or mpiexec for several processes.  FileExistsError :
        for a folder that is not empty.
    ValueError : for a scene that LAMMPS cannot run as minimd does.  HandOverError : if LAMMPS disagrees or fails.
        OSError : for files.
    The simulation is then in its state before, and the folder is removed. But if LAMMPS fails after it has written
    frames, the complete frames are kept, and the simulation is in the state of the last one.
    """
    job = Job(simulation, Path(folder), steps, processes, every, progress, tell or (lambda line: None))
    with job.in_folder(checked_flag("overwrite", overwrite)):
        verification = job.prepare()
        return job.run(verification, checked_flag("store_forces", store_forces))


def check_hand_over(
    simulation: Simulation,
    folder: str | Path,
    steps: int,
    *,
    processes: int = 1,
    every: int = 100,
    overwrite: bool = False,
) -> None:
    """Raise the errors that hand_over raises before it starts: for a scene that LAMMPS cannot run,
    if LAMMPS is not found, for the folder."""
    job = Job(simulation, Path(folder), steps, processes, every)
    job.check_folder(overwrite)
    Model(job.engine)


class Job:
    """One hand-over; see hand_over for the arguments.  stop_requested : by a signal, see minimd.console.signals."""

    def __init__(
        self,
        simulation: Simulation,
        folder: Path,
        steps: int,
        processes: int,
        every: int,
        progress: bool | None = None,
        tell: Tell = lambda line: None,
    ) -> None:
        if simulation.barostat is not None:
            raise ValueError(
                "a run with a barostat cannot be handed over to LAMMPS, which has other barostats than minimd; run it "
                "with minimd"
            )
        self.simulation, self.engine = simulation, simulation.engine
        self.folder, self.trajectory = folder, folder / TRAJECTORY
        self.steps, self.every = checked_count("steps", steps, limit=MOST_STEPS), checked_count("every", every)
        self.processes = checked_count("processes", processes)
        self.progress, self.tell = progress, tell
        self.stop_requested, self.seconds = False, dict[str, float]()
        self.first_step, self.keeps_frames = simulation.step, False
        check_extras(self.engine)
        script.check_method(self.engine)
        self.program: Program = find_program()
        self.program.command(script.RUN, script.LOG, processes)

    @contextmanager
    def in_folder(self, overwrite: bool) -> Iterator[None]:
        """Context in which the folder exists.

        If something fails, the folder is removed, unless frames are kept in it.
        """
        self.check_folder(overwrite)
        before, old = self.engine.snapshot(), None
        if self.folder.is_dir() and any(self.folder.iterdir()):
            self.folder.rename(old := self.folder.with_name(f"{self.folder.name}.before-{uuid4().hex[:8]}"))
        self.folder.mkdir(exist_ok=True)
        try:
            with stop_on_signals(self):
                yield
        except BaseException as error:
            self._remove_raw()
            if not self.keeps_frames:
                shutil.rmtree(self.folder, ignore_errors=True)
                self.engine.restore(before)
                if old is not None:
                    old.rename(self.folder)
            if isinstance(error, OSError) and error.strerror:
                raise type(error)(f"the hand-over to LAMMPS failed: {sentence(error)}") from None
            raise
        self._remove_raw()
        if old is not None:
            shutil.rmtree(old)

    def check_folder(self, overwrite: bool) -> None:
        """Raise FileExistsError, FileNotFoundError or OSError if the hand-over cannot be written there."""
        if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
            if not overwrite:
                raise FileExistsError(
                    f"folder {str(self.folder)!r} exists and is not empty; choose another name, or pass overwrite=True"
                )
            own = {TRAJECTORY, OUTPUT, *script.FILES}
            if not self.folder.is_dir() or (others := sorted({file.name for file in self.folder.iterdir()} - own)):
                held = f"holds more than a hand-over, such as {others[0]!r}" if self.folder.is_dir() else "is a file"
                raise FileExistsError(f"{str(self.folder)!r} {held}; choose another name")
        if not self.folder.absolute().parent.is_dir():
            raise FileNotFoundError(f"folder {str(self.folder.absolute().parent)!r} does not exist; make it first")
        n_atoms, n_frames = len(self.simulation.system), 2 + self.steps // self.every
        needed = n_atoms * (BYTES_PER_ATOM + BYTES_PER_FRAME * n_frames)
        if needed > (free := shutil.disk_usage(self.folder.absolute().parent).free):
            raise OSError(
                f"the hand-over needs {needed / 1e9:.2g} GB for {n_frames} frames of {n_atoms} atoms, and the disk has "
                f"{free / 1e9:.2g} GB left; free some space, or write frames less often (every = {self.every})"
            )

    def _remove_raw(self) -> None:
        for name in (*script.RAW, OUTPUT):
            (self.folder / name).unlink(missing_ok=True)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Context whose duration is stored in seconds."""
        started = perf_counter()
        yield
        self.seconds[name] = perf_counter() - started

    def prepare(self) -> Verification:
        """Write the scene, and compare step 0.  Raises HandOverError if LAMMPS and minimd differ."""
        with self.phase("writing"):
            self.engine.begin()
            self.model = Model(self.engine)
            script.write_atoms(self.folder / script.ATOMS, self.model, self.model.box, self.engine.velocities)
            write_whole(self.folder / script.FORCES, script.forces_script(self.model))
            write_whole(self.folder / script.VERIFY, script.verify_script())
            write_whole(self.folder / script.RUN, script.run_script(self.engine, self.model, self.steps, self.every))
        self.tell(f"LAMMPS         {self.program.version}, on {self.processes} process{'es' * (self.processes > 1)}")
        for k, line in enumerate(not_carried_over(self.simulation)):
            self.tell(f"{'' if k else 'not carried':<14} {line}")
        with self.phase("verifying"):
            copy, ours = in_both(self.engine, self.model.smallest_cutoff, self.model.skin)
            box = Box(copy)
            box.make_room(self.model.reach)
            script.write_atoms(self.folder / script.COPY, self.model, box, copy.velocities)
            log = run(self.program.command(script.VERIFY, script.LOG, self.processes), self.folder, script.LOG, self)
            if self.stop_requested:
                raise KeyboardInterrupt("stopped before the run of LAMMPS")
            if log.processes != self.processes:
                raise HandOverError(
                    f"LAMMPS runs on {log.processes} process instead of {self.processes}; {self.program.lmp} was "
                    f"probably built without MPI, or for another mpiexec than {self.program.mpiexec}: {INSTALL}"
                )
            theirs = (
                script.per_atom(columns, place)
                for name, place in zip(script.STEP_0.values(), (self.model.box, box), strict=True)
                for _, columns in frames(self.folder / name, len(copy))
            )
            verification = compare(ours, theirs)
            verification.check(self.engine)
            self._scale = verification.scale
        self.tell(f"verified       {verification}")
        self._remove_raw()
        return verification

    def run(self, verification: Verification, store_forces: bool) -> HandOver:
        """Run LAMMPS, and read back the frames that it has written, also if it fails or is interrupted."""
        command, log = self.program.command(script.RUN, script.LOG, self.processes), Log(self.folder / script.LOG)
        (self.folder / script.LOG).unlink()
        failure: HandOverError | None = None
        with self.phase("running"), progress_of(self.steps, "LAMMPS", self.progress) as show:
            try:
                run(command, self.folder, script.LOG, self, lambda step: show(step - self.first_step))
            except HandOverError as error:
                failure = error
        log.read_on()
        with self.phase("reading back"):
            record, difference, n_missing = self._bring_back(
                log, store_forces, failure is None and not self.stop_requested
            )
        self._judge(failure, record, difference, n_missing, log)
        done = HandOver(
            self.folder,
            self.trajectory,
            record,
            verification,
            difference,
            self.seconds,
            self.program.version,
            self.processes,
        )
        for line in str(done).splitlines()[2:]:
            self.tell(line)
        return done

    def _judge(
        self, failure: HandOverError | None, record: Record, difference: float, n_missing: int, log: Log
    ) -> None:
        """Raise HandOverError if LAMMPS has failed, or frames are missing or wrong;
        KeyboardInterrupt if the run was stopped."""
        words = ""
        if failure is not None:
            words = str(failure)
        elif self.stop_requested:
            words = "the run of LAMMPS was stopped"
        elif n_missing:
            words = f"LAMMPS has made all steps, but {n_missing} frames are not on the disk; is the disk full?"
        elif not difference <= DISAGREEMENT:
            words = (
                f"potential energies of a frame differ by {difference:.1e} of Σ|e_i| or N k_B T, allowed is "
                f"{DISAGREEMENT:g}; its lists may have missed pairs ({log.dangerous_builds} dangerous builds): reduce "
                "the time step"
            )
        if words and self.keeps_frames:
            kept = f"{len(record)} frames up to step {self.engine.step} are kept in {self.trajectory}"
            words = f"{kept}; {words}" if self.stop_requested else f"{words}; {kept}"  # the name of the signal follows
        if words:
            raise KeyboardInterrupt(words) if self.stop_requested else HandOverError(words)

    def _bring_back(self, log: Log, store_forces: bool, is_whole: bool) -> tuple[Record, float, int]:
        """Write the frames, observed by minimd, into the H5MD file; the simulation is then in the last state.

        Returns the record of the frames, the energy difference (see HandOver), and the number of frames that are
        missing.  is_whole : whether LAMMPS has reached its end. If not, the frames that exist are kept if there is one
        after the first.
        """
        path, n_atoms = self.folder / script.FRAMES, len(self.engine.system)
        record = Record(self.engine.system.units, n_atoms, self.trajectory)
        found = (one for one in frames(path, n_atoms) if one[0] > self.first_step) if path.is_file() else iter(())
        first = next(found, None)
        self.keeps_frames = first is not None
        if first is None and not is_whole:
            return record, 0.0, 0
        start, tail, differences, n_missing = self.engine.reservoir_energy, float(tails_of(self.engine)[0]), [], 0

        def reservoir_energy(step: int) -> float:
            return start - sum(log.rows.get(step, ())[1:])  # a second number if there is a bath

        opened = open_trajectories(
            self.trajectory,
            self.engine,
            every=self.every,
            n_steps=self.steps,
            store_forces=store_forces,
            overwrite=False,
        )
        with self._titled(), opened as writers:
            for step, columns in chain([(self.first_step, None)], [first] if first else [], found):
                if columns is not None:
                    self._stand(step, columns, reservoir_energy(step))
                frame = observe(self.engine)
                record.append(frame)
                for writer in writers:
                    writer.write(frame)
                energy = float(frame.observables["potential_energy"]) - tail
                heat = n_atoms * self.engine.system.units.k_B * float(frame.observables["temperature"])
                theirs = log.rows.get(step, (np.nan,))[0]
                differences.append(abs(theirs - energy) / max(self._scale, abs(energy), heat, LEAST))
            if is_whole:
                n_missing = self._end(reservoir_energy(self.first_step + self.steps), len(record))
        self.simulation.record = record
        return record, float(np.max(differences)), n_missing

    @contextmanager
    def _titled(self) -> Iterator[None]:
        """Context in which the title of files says that LAMMPS has made the steps."""
        notes = self.engine.notes
        before = notes["title"]
        notes["title"] = f"{before or f'{len(self.engine.system)} atoms'}, run by LAMMPS {self.program.version}"
        try:
            yield
        finally:
            notes["title"] = before

    def _end(self, reservoir_energy: float, n_frames: int) -> int:
        """Put the engine in the last state; returns how many frames, the last state included, are missing."""
        last, end = self.folder / script.LAST, self.first_step + self.steps
        expected = 1 + end // self.every - self.first_step // self.every
        final = next(frames(last, len(self.engine.system)), None) if last.is_file() else None
        if final is not None:
            self._stand(end, final[1], reservoir_energy)
        return expected - n_frames + (final is None)

    def _stand(self, step: int, columns: np.ndarray, reservoir_energy: float) -> None:
        """Put the engine in the state of LAMMPS at a step."""
        engine, box, velocities = self.engine, self.model.box, self.model.box.back(columns[:, 3:])
        if not np.isfinite(columns).all():
            raise HandOverError(
                f"positions or velocities in LAMMPS are not finite at step {step}; reduce the time step "
                f"({engine.method.timestep:g})"
            )
        half = 0.5 * (step - engine.step) * engine.method.timestep
        if (most := np.abs(box.crossed(half * (velocities - engine.velocities))).max()) > IMAGES / 2:
            raise HandOverError(
                f"the images of atoms at step {step} are unknown: the change of their velocities since step "
                f"{engine.step} amounts to {most:.3g} cells, and LAMMPS counts {IMAGES // 2}; bring frames back more "
                f"often (every = {self.every})"
            )
        expected = engine.positions + half * (velocities + engine.velocities)
        engine.positions[:] = box.positions_back(columns[:, :3], expected)
        engine.velocities[:] = velocities
        engine.count(step - engine.step)
        engine.reservoir_energy = reservoir_energy
        engine.moved()
        engine.fit_images()
        # velocities of SHAKE have a component along the bonds
        engine.constraint_set.project(engine.velocities, engine.positions)
