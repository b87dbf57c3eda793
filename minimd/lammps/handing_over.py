"""Handing a simulation over to LAMMPS: it is written, verified at step 0, run under MPI, and read back.

Frames are read from LAMMPS' binary dumps of all atoms (dump custom, suffix .bin; format 2 of 2020).
"""

import shutil
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from time import perf_counter
from typing import Any, BinaryIO
from uuid import uuid4

import numpy as np

from minimd.core.console.display import Displayed, Rows
from minimd.core.console.progress import progress_of
from minimd.core.console.signals import stop_on_signals
from minimd.core.console.whole_file import write_whole
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import check_extras, observe
from minimd.core.engine.record import Record
from minimd.core.files.trajectory import open_trajectories
from minimd.core.integrators.thermostats import LangevinBAOAB
from minimd.core.potentials.coulomb import Coulomb
from minimd.core.potentials.term import bound
from minimd.core.simulation.simulation import Simulation
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_count, checked_flag, checked_kind, checked_path
from minimd.core.structure.errors import HandOverError, sentence
from minimd.core.structure.lammps_box import Box
from minimd.lammps import script
from minimd.lammps.model import Model
from minimd.lammps.program import INSTALL, OUTPUT, LammpsProgram, Log, find_program, run
from minimd.lammps.verification import LEAST, Verification, compare, in_both

MAGIC = b"DUMPCUSTOM"


def frames(path: Path, n_atoms: int) -> Iterator[tuple[int, Array]]:
    """For each frame, its step and all columns but the first, (N, C); the first must be the id, which orders the rows.
    A file that does not exist has no frame; one that is cut off or lacks atoms ends the iteration.
    Raises ValueError for a file that is not such a dump."""
    with suppress(EOFError, FileNotFoundError), path.open("rb") as file:
        while file.peek(1):  # type: ignore[attr-defined]
            yield _frame(file, n_atoms)


def _frame(file: BinaryIO, expected: int) -> tuple[int, Array]:
    """The next frame.
    Raises EOFError if it is cut off, or has another number of atoms."""

    def read(kind: str) -> tuple[Any, ...]:
        form = struct.Struct(f"={kind}")  # without gaps
        part = file.read(form.size)
        if len(part) < form.size:
            raise EOFError
        return form.unpack(part)

    if read(f"q{len(MAGIC)}si") != (-len(MAGIC), MAGIC, 1):  # length, name, order of bytes
        raise ValueError(
            "LAMMPS has written a dump in a format that minimd does not know; use LAMMPS of 2021 or later"
        )

    _revision, step, n_atoms, tilted = read("iqqi")
    if n_atoms != expected:
        raise EOFError
    _boundaries_and_box, n_columns, size = read(f"{6 * 4 + (9 if tilted else 6) * 8}sii")
    _unit_style, has_time = read(f"{size}sb")
    *_time, size = read("di" if has_time else "i")
    _names_of_columns, n_processes = read(f"{size}si")
    rows = np.empty((n_atoms, n_columns - 1))
    filled = 0

    for _ in range(n_processes):
        (n_numbers,) = read("i")
        part = np.frombuffer(read(f"{8 * n_numbers}s")[0]).reshape(-1, n_columns)
        rows[part[:, 0].astype(np.int64) - 1] = part[:, 1:]
        filled += len(part)

    if filled != n_atoms:
        raise EOFError
    return step, rows


TRAJECTORY = "run.h5md"
BYTES_PER_ATOM = 490  # of the input and of step 0
BYTES_PER_FRAME = 130  # of a frame in the files of LAMMPS and minimd
# of Σ|e_i|, allowed between the energies of LAMMPS and minimd in a frame: more than rounding
DISAGREEMENT = 1e-8
MOST_STEPS = 2**31  # one run of LAMMPS makes fewer


@dataclass(frozen=True)
class HandOver(Displayed):
    """The result of a hand-over.
    folder : of all files.
    trajectory : the H5MD file, from which Simulation.resume goes on.
    record : Record of its frames.
    verification : of step 0.
    energy_difference : largest difference, in all frames, of the potential energies of LAMMPS and minimd, as a fraction
        of the largest of Verification.scale, the potential energy of the frame and its N k_B T.
    seconds : of each phase.
    version : of LAMMPS.
    processes : their number."""

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
        difference = f"{self.energy_difference:.1e} of Σ|e_i| or N k_B T"
        phases = [f"{name} {seconds:.3g} s" for name, seconds in self.seconds.items()]
        return [
            ("LAMMPS", f"{self.version}, on {_named(self.processes)}"),
            ("verified", str(self.verification)),
            (
                "frames",
                f"{len(self.record)}; energies of both programs differ by at most {difference}",
            ),
            ("time", ", ".join(phases)),
            ("written", str(self.trajectory)),
        ]


def not_carried_over(simulation: Simulation) -> list[str]:
    """The promises of minimd that a run by LAMMPS does not keep, one sentence each."""
    checked_kind("simulation", simulation, Simulation, "a Simulation")
    engine = simulation.engine
    method = simulation.method
    extra = engine.extra_observables
    has_waves = engine.system.cell.is_periodic and any(
        isinstance(potential, Coulomb) for potential in engine.interactions.potentials
    )
    is_fixed_point = engine.interactions.options.precision != "double"
    is_rigid = engine.constraint_set.bonds is not None
    rows = {  # sentence: whether it applies
        "exact restart: bits depend on the number of processes, and on where LAMMPS ended; minimd goes on from "
        "positions and velocities only": True,
        f"noise: the thermostat is LAMMPS' {script.BATHS.get(type(method))}, with random numbers that depend on the "
        "number of processes": method.is_thermostat,
        "order of the thermostat: fix langevin adds friction and noise to the forces of velocity Verlet, and has "
        "other errors of order Δt² than BAOAB": isinstance(method, LangevinBAOAB),
        "sum over waves: by pppm, with Gaussians and a mesh, to the accuracy asked for": has_waves,
        f"{', '.join(extra)}: computed by minimd for each frame, not by LAMMPS": bool(extra),
        "fixed-point arithmetic: LAMMPS computes in double precision": is_fixed_point,
        f"exact lengths: fix shake keeps them to {script.SHAKE_TOLERANCE:g} by iteration": is_rigid,
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
    tell: Callable[[str], object] | None = print,
) -> HandOver:
    """Let LAMMPS make the next steps of a simulation, which is then in the state in which LAMMPS ended, and can go on.

    The scene is written for LAMMPS from the same laws. LAMMPS evaluates it at step 0; energy, force and virial of each
    atom must agree with those of minimd to 1e-10 of the largest (charges in a periodic cell: to ten times their
    accuracy), or nothing is run. Then LAMMPS runs as a child process, under mpiexec for several processes. Its frames
    are read back, observed by minimd, and written to an H5MD file with a restart.

    Parameters
    ----------
    folder : for all files; it must not exist, or must be empty.
    steps : number of steps.
    processes : number of MPI processes.
    every : steps between frames: the first state, and then those whose step is a multiple of every.
    store_forces : also write forces.
    overwrite : replace the folder.
    progress : as for Simulation.run.
    tell : called with lines about the hand-over; None for silence.

    Raises
    ------
    FileNotFoundError : if LAMMPS is not found, or mpiexec for several processes; write_input needs neither.
    FileExistsError : for a folder that is not empty.
    OSError : for files.
    ValueError : for a scene that LAMMPS cannot run as minimd does.
    HandOverError : if LAMMPS disagrees or fails.
    The simulation is then in its state before, and the folder is removed. But if LAMMPS fails after it has written
    frames, the complete frames are kept, and the simulation is in the state of the last one.
    """
    job = _checked_job(simulation, folder, steps, processes, every, overwrite)
    _check_disk(job)
    with_forces = checked_flag("store_forces", store_forces)
    tell = tell or (lambda line: None)

    try:
        job.program = find_program(job.processes)
    except FileNotFoundError as error:
        Model(job.engine)  # what LAMMPS cannot run is told first
        raise FileNotFoundError(
            f"{error}; write_input writes the input for another machine"
        ) from None

    with _in_folder(job), stop_on_signals(job):
        model = _written(job)
        tell(f"LAMMPS         {job.program.version}, on {_named(job.processes)}")
        for k, line in enumerate(not_carried_over(simulation)):
            tell(f"{'' if k else 'not carried':<14} {line}")
        with phase(job, "verifying"):
            verification = _verified(job, model)
        tell(f"verified       {verification}")
        _remove_raw(job)
        (job.folder / script.LOG).unlink()
        log = Log(job.folder / script.LOG)
        failure = ""

        with phase(job, "running"), progress_of(job.steps, "LAMMPS", progress) as show:
            try:
                job.run(script.RUN, lambda step: show(step - job.first_step))
            except HandOverError as error:
                failure = str(error)

        log.read_on()

        with phase(job, "reading back"):
            is_whole = not (failure or job.stop_requested)
            record, difference, n_missing = _brought_back(
                job, model, log, verification.scale, with_forces, is_whole
            )

        _judge(job, failure, log, max(DISAGREEMENT, model.tolerance), record, difference, n_missing)
        answer = HandOver(
            job.folder,
            job.folder / TRAJECTORY,
            record,
            verification,
            difference,
            job.seconds,
            job.program.version,
            job.processes,
        )
        for line in str(answer).splitlines()[2:]:
            tell(line)
        return answer


def check_hand_over(
    simulation: Simulation,
    folder: str | Path,
    steps: int,
    *,
    processes: int = 1,
    every: int = 100,
    overwrite: bool = False,
) -> None:
    """Raise the errors of hand_over that need no LAMMPS: a scene that LAMMPS cannot run, the folder, the disk."""
    job = _checked_job(simulation, folder, steps, processes, every, overwrite)
    Model(job.engine)
    _check_disk(job)


def write_input(
    simulation: Simulation,
    folder: str | Path,
    steps: int,
    *,
    every: int = 100,
    overwrite: bool = False,
) -> None:
    """Write the input of LAMMPS, which another machine may run by `lmp -in run.lmp` in the folder.

    It needs no LAMMPS, and its forces are not compared with those of minimd. Positions and velocities in it satisfy the
    constraints; the simulation is left in its state.

    folder, steps, every, overwrite : see hand_over.
    Raises ValueError for a scene that LAMMPS cannot run as minimd does; FileExistsError for a folder that is not empty;
    FileNotFoundError if the one that would hold it does not exist; OSError for files. Nothing new is then left in it.
    """
    job = _checked_job(simulation, folder, steps, 1, every, overwrite)
    before = simulation.snapshot()
    with _in_folder(job):
        _written(job)
    simulation.restore(before)


@dataclass
class Job:
    """One hand-over, see hand_over.
    seconds : of each phase.
    stop_requested : by a signal, see console.signals."""

    simulation: Simulation
    folder: Path
    steps: int
    every: int
    processes: int
    first_step: int
    program: LammpsProgram = field(init=False)
    seconds: dict[str, float] = field(default_factory=dict)
    stop_requested: bool = False
    keeps_frames: bool = False

    @property
    def engine(self) -> Engine:
        """That of the simulation."""
        return self.simulation.engine

    def run(self, name: str, show: Callable[[int], object] = lambda step: None) -> Log:
        """Run a script, see program.run."""
        command = self.program.command(name, script.LOG, self.processes)
        return run(command, self.folder, script.LOG, self, show)


@contextmanager
def phase(job: Job, name: str) -> Iterator[None]:
    """Context whose duration is stored in seconds."""
    started = perf_counter()
    yield
    job.seconds[name] = perf_counter() - started


def _named(processes: int) -> str:
    return f"{processes} process{'es' * (processes > 1)}"


def _checked_job(
    simulation: Simulation,
    folder: str | Path,
    steps: int,
    processes: int,
    every: int,
    overwrite: bool,
) -> Job:
    """The hand-over.
    Raises ValueError for a scene or numbers that LAMMPS cannot run; FileNotFoundError or FileExistsError if the files
    cannot be written there."""
    checked_kind("simulation", simulation, Simulation, "a Simulation")
    folder = checked_path("folder", folder)
    overwrite = checked_flag("overwrite", overwrite)
    if simulation.barostat is not None:
        raise ValueError(
            "a run with a barostat cannot be handed over to LAMMPS, which has other barostats than "
            "minimd; run it with minimd"
        )

    steps = checked_count("steps", steps, limit=MOST_STEPS)
    every = checked_count("every", every)
    processes = checked_count("processes", processes)
    check_extras(simulation.engine)
    script.check_method(simulation.engine)
    is_file = folder.exists() and not folder.is_dir()
    names = {file.name for file in folder.iterdir()} if folder.is_dir() else set()
    if (is_file or names) and not overwrite:
        raise FileExistsError(
            f"folder {str(folder)!r} exists and is not empty; choose another name, or delete it, with "
            "all that is in it, by overwrite=True"
        )

    if is_file:
        raise FileExistsError(f"{str(folder)!r} is a file; choose another name")

    for name in sorted(names - {TRAJECTORY, OUTPUT, *script.FILES}):
        raise FileExistsError(
            f"{str(folder)!r} holds more than a hand-over, such as {name!r}; choose another name"
        )

    parent = folder.absolute().parent
    if not parent.is_dir():
        raise FileNotFoundError(f"folder {str(parent)!r} does not exist; make it first")
    return Job(simulation, folder, steps, every, processes, simulation.step)


def _check_disk(job: Job) -> None:
    """Raise OSError if the disk has no room for a hand-over."""
    n_atoms = len(job.simulation.system)
    n_frames = 2 + job.steps // job.every
    needed = n_atoms * (BYTES_PER_ATOM + BYTES_PER_FRAME * n_frames)
    free = shutil.disk_usage(job.folder.parent).free
    if needed > free:
        raise OSError(
            f"the hand-over needs {needed / 1e9:.2g} GB for {n_frames} frames of {n_atoms} atoms, and the "
            f"disk has {free / 1e9:.2g} GB left; free some space, or write frames less often (every = {job.every})"
        )


@contextmanager
def _in_folder(job: Job) -> Iterator[None]:
    """Context in which the folder exists; if something fails, it is removed, unless frames are kept in it."""
    before = job.engine.snapshot()
    folder = job.folder
    old = None
    if folder.is_dir() and any(folder.iterdir()):
        old = folder.rename(folder.with_name(f"{folder.name}.before-{uuid4().hex[:8]}"))
    folder.mkdir(exist_ok=True)
    try:
        yield
    except BaseException as error:
        _remove_raw(job)
        if not job.keeps_frames:
            shutil.rmtree(folder, ignore_errors=True)
            job.engine.restore(before)
            if old is not None:
                old.rename(folder)

        if isinstance(error, OSError) and error.strerror:
            raise type(error)(f"the hand-over to LAMMPS failed: {sentence(error)}") from None
        raise

    _remove_raw(job)
    if old is not None:
        shutil.rmtree(old)


def _remove_raw(job: Job) -> None:
    for name in (*script.RAW, OUTPUT):
        (job.folder / name).unlink(missing_ok=True)


def _written(job: Job) -> Model:
    """Write the input of the run, and return the scene as LAMMPS gets it."""
    with phase(job, "writing"):
        job.engine.begin()
        model = Model(job.engine)
        script.write(job.folder, job.engine, model, job.steps, job.every)
    return model


def _verified(job: Job, model: Model) -> Verification:
    """Compare step 0 in the scene and in a copy.
    Raises HandOverError if LAMMPS and minimd differ."""
    copy, ours = in_both(job.engine, model.smallest_cutoff, model.skin)
    box = Box(copy.cell, copy.positions)
    box.make_room(model.reach)
    script.write_atoms(job.folder / script.COPY, model, box, copy.velocities)
    write_whole(job.folder / script.VERIFY, script.VERIFICATION)
    log = job.run(script.VERIFY)
    if job.stop_requested:
        raise KeyboardInterrupt("stopped before the run of LAMMPS")
    if log.processes != job.processes:
        raise HandOverError(
            f"LAMMPS runs on {log.processes} process instead of {job.processes}; {job.program.lmp} was "
            f"probably built without MPI, or for another mpiexec than {job.program.mpiexec}: {INSTALL}"
        )

    theirs = []
    for name, box_of_file in zip(script.STEP_0, (model.box, box), strict=True):
        for _, columns in frames(job.folder / name, len(copy)):
            theirs.append(script.per_atom(columns, box_of_file))
    verification = compare(ours, iter(theirs))
    verification.check(job.engine, model.tolerance)
    return verification


def _brought_back(
    job: Job, model: Model, log: Log, scale: float, store_forces: bool, is_whole: bool
) -> tuple[Record, float, int]:
    """Write the frames, observed by minimd, into the H5MD file; the simulation is then in the last state.
    Returns the record of the frames, the energy difference (see HandOver), and the number of frames that are missing.
    is_whole : whether LAMMPS has reached its end. If not, the frames that exist are kept if there is one after the
    first."""
    engine = job.engine
    n_atoms = len(engine.system)
    notes = engine.notes
    record = Record(
        engine.system.units, n_atoms, job.folder / TRAJECTORY, engine.conserves_momentum
    )
    end = job.first_step + job.steps
    states: list[tuple[int, Array | None]] = [(job.first_step, None)]
    dump = frames(job.folder / script.FRAMES, n_atoms)
    later = (state for state in dump if state[0] > job.first_step)
    states += islice(later, 1)
    job.keeps_frames = len(states) > 1
    if not (job.keeps_frames or is_whole):
        return record, 0.0, 0
    start = engine.reservoir_energy
    title = notes["title"]
    differences = list[float]()
    # [energy], of tail corrections, which LAMMPS does not compute
    terms = [bound(potential, engine.system) for potential in engine.interactions.potentials]
    tail = sum(term.tail(engine.system)[0] for term in terms)

    def stand(step: int, columns: Array) -> None:
        _stand(job, model.box, step, columns)
        # a second number if there is a bath
        engine.reservoir_energy = start - sum(log.rows.get(step, ())[1:])

    notes["title"] = f"{title or f'{n_atoms} atoms'}, run by LAMMPS {job.program.version}"
    n_missing = 0
    try:
        with open_trajectories(
            job.folder / TRAJECTORY,
            engine,
            every=job.every,
            n_steps=job.steps,
            store_forces=store_forces,
            overwrite=False,
        ) as writers:
            for step, columns in chain(states, later):
                if columns is not None:
                    stand(step, columns)
                frame = observe(engine)
                record.append(frame)
                for writer in writers:
                    writer.write(frame)
                energy = frame.observables["potential_energy"] - tail
                heat = n_atoms * engine.system.units.k_B * frame.observables["temperature"]
                theirs = log.rows.get(step, (np.nan,))[0]
                differences.append(abs(theirs - energy) / max(scale, abs(energy), heat, LEAST))
            if is_whole:
                n_missing = 2 + end // job.every - job.first_step // job.every - len(record)
                for _, columns in frames(job.folder / script.LAST, n_atoms):
                    stand(end, columns)
                    n_missing -= 1
    finally:
        notes["title"] = title

    job.simulation.record = record
    return record, float(np.max(differences)), n_missing


def _stand(job: Job, box: Box, step: int, columns: Array) -> None:
    """Put the engine in the state of LAMMPS at a step."""
    engine = job.engine
    timestep = engine.method.timestep
    velocities = box.back(columns[:, 3:])
    if not np.isfinite(columns).all():
        raise HandOverError(
            f"positions or velocities in LAMMPS are not finite at step {step}; reduce the time step "
            f"({timestep:g})"
        )

    half = 0.5 * (step - engine.step) * timestep
    limit = box.most_images // 2
    most = np.abs(box.crossed(half * (velocities - engine.velocities))).max()
    if most > limit:
        raise HandOverError(
            f"it is unknown how many cells the atoms have crossed at step {step}: their places are "
            f"uncertain by {most:.3g} cells since step {engine.step}, and LAMMPS counts {limit} "
            f"at most; bring frames back more often (every = {job.every})"
        )

    engine.positions[:] = box.positions_back(
        columns[:, :3], engine.positions + half * (velocities + engine.velocities)
    )
    engine.velocities[:] = velocities
    engine.count(step - engine.step)
    engine.enter()
    # velocities of SHAKE have a component along the bonds
    engine.constraint_set.project(engine.velocities, engine.positions)


def _judge(
    job: Job,
    failure: str,
    log: Log,
    allowed: float,
    record: Record,
    difference: float,
    n_missing: int,
) -> None:
    """Raise HandOverError if LAMMPS failed, or frames are missing or wrong; KeyboardInterrupt if it was stopped."""
    if failure:
        reason = failure
    elif job.stop_requested:
        reason = "the run of LAMMPS was stopped"
    elif n_missing:
        reason = f"LAMMPS has made all steps, but {n_missing} frames are not on the disk; is the disk full?"
    elif not difference <= allowed:
        reason = (
            f"potential energies of LAMMPS and minimd differ by {difference:.1e} of Σ|e_i| or N k_B T in a frame, "
            f"allowed is {allowed:g}; lists of LAMMPS may have missed pairs ({log.dangerous_builds} dangerous "
            "builds): reduce the time step"
        )
    else:
        return

    if job.keeps_frames:
        kept = f"{len(record)} frames up to step {job.engine.step} are kept in {job.folder / TRAJECTORY}"
        # the name of the signal follows
        reason = f"{kept}; {reason}" if job.stop_requested else f"{reason}; {kept}"

    raise KeyboardInterrupt(reason) if job.stop_requested else HandOverError(reason)
