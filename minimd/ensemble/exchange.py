"""md.exchange: replica exchange, also called parallel tempering; a call goes on where an earlier one was stopped.

A replica is a simulation with a file of its own. All replicas make a round of `every` steps; then neighbors in the
ladder of temperatures may exchange their temperatures, which is an attempt. The files are the only memory: the energies
in their frames and the seed of the ladder say which exchanges were accepted. A frame is written, and a restart kept,
before the exchange that follows it. A replica whose file ends before those of the others, because the process was
killed, makes its missing rounds alone, at the temperatures that the energies of all replicas give.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ThreadPoolExecutor
from contextlib import ExitStack, nullcontext, suppress
from math import sqrt
from pathlib import Path
from pickle import PicklingError
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.machine import available_cores, threads_by_default
from minimd.core.console.progress import progress_of
from minimd.core.console.quiet import quiet
from minimd.core.console.signals import Terminated, endings_are_told, raising_on_signals
from minimd.core.console.words import shown
from minimd.core.engine.engine import Engine
from minimd.core.engine.record import Frame
from minimd.core.files.crash_file import crash_file_place
from minimd.core.files.trajectory import open_trajectories
from minimd.core.integrators.hybrid_monte_carlo import HybridMonteCarlo
from minimd.core.simulation.simulation import Simulation
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.checks import (
    checked_count,
    checked_flag,
    checked_kind,
    checked_numbers,
    checked_path,
)
from minimd.core.structure.errors import ConstraintError, EnsembleError, NonFiniteError, sentence
from minimd.ensemble.folder import ENTROPIES, EXCHANGE, Asked, EnsembleFolder, name_of
from minimd.ensemble.ladder import Ladder
from minimd.ensemble.member import Member
from minimd.ensemble.running import (
    ANOTHER,
    check_functions,
    end_all,
    ending_of,
    n_processes,
    opened_executor,
)
from minimd.ensemble.workers import WorkerDied, WorkerNeverBegan, WorkerStopped
from minimd.observers.accumulator import ObservedRun

OF_ATTEMPTS = 1  # behind the number of an attempt, in the key of its random numbers: those of members have one number
Prepare = Callable[[Simulation, Member], Any]


def exchange(
    build: Callable[[Member], Simulation],
    temperatures: Sequence[float],
    steps: int,
    *,
    every: int = 100,
    prepare: Prepare | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    seed: int = 0,
    folder: str | Path = "ladder",
    resume: bool = True,
    progress: bool | None = None,
) -> Ladder:
    """Replica exchange, or parallel tempering: runs at several temperatures, whose neighbors exchange them.

    Every so many steps, replicas i and j at neighboring temperatures exchange these with the probability

        P = min(1, exp((β_i − β_j)(U_i − U_j))),  β = 1/(k_B T)

    and their velocities are multiplied by √(T_new/T_old). Odd attempts are for the pairs (0, 1), (2, 3), …, even ones
    for (1, 2), (3, 4), … At each temperature the states are those of the canonical ensemble.

    Each replica has a file with a frame for each attempt. A call that was stopped at any moment goes on when it is
    repeated, to the same bits; with more steps, a finished one does. Results depend on the arguments alone, not on
    executor and workers.

    Parameters
    ----------
    build : function of a Member that returns its Simulation, with a thermostat. member["temperature"] is the
        temperature at which this replica starts, member.seed is for its noise. It is called again in a later call.
    temperatures : (K,) ascending, one for each replica.
    steps : number of steps of each replica, a multiple of every.
    every : steps between two attempts.
    prepare : function of simulation and member, such as an equilibration, called before the first step, but not when a
        replica goes on.
    executor : as for md.ensemble; if not given, replicas run in threads of this process. The state of a replica is
        sent to a process and back for each round.
    workers : number of processes of this machine that are spawned in place of threads.
    seed : of exchanges, and of the seeds of members.
    folder : for all files; that of replica 3 is 0000-0999/0003.h5md.
    resume : False to delete all replicas in the folder, and begin anew.
    progress : whether to show a bar that counts attempts, as for Simulation.run.

    Raises
    ------
    TypeError, ValueError : for wrong arguments, simulations that do not sample the canonical ensemble, or a folder
        with other runs.
    NonFiniteError, ConstraintError : if a replica blows up; a note says which.
    EnsembleError, a RuntimeError : if the executor cannot run replicas.
    KeyboardInterrupt : after Ctrl-C; all whole rounds are kept, and the next call goes on.
    OSError : if the folder cannot be written.

    Y. Sugita, Y. Okamoto, Chem. Phys. Lett. 314, 141 (1999), eqs. 10 to 12.
    """
    levels = checked_ladder(temperatures)
    place = checked_path("folder", folder)
    steps = checked_count("steps", steps, 0)
    every = checked_count("every", every)
    seed = checked_count("seed", seed, 0, ENTROPIES)
    resume = checked_flag("resume", resume)
    if steps % every:
        raise ValueError(f"steps must be a multiple of every = {every}; steps = {steps}")
    check_functions({"build": build, "prepare": prepare})
    is_alone = executor is None and workers is None
    n_workers = n_processes(executor, 0 if is_alone else workers, {"prepare": prepare})
    n_rounds = steps // every
    rows = [{"temperature": level} for level in levels.tolist()]
    run = f"{EXCHANGE} {len(levels)} temperatures"
    threads: Any = nullcontext(executor)
    if executor is None and n_workers == 0:
        threads = ThreadPoolExecutor(min(len(levels), available_cores()))

    with EnsembleFolder(place, writes=True) as opened, ExitStack() as files:
        opened.begin(Asked(seed, steps, every, rows, name_of(build), name_of(prepare), run), resume)
        members = [Member(k, row, seed, steps, opened.file(k)) for k, row in enumerate(rows)]
        replicas = [Replica(build, member, levels.tolist(), every, files) for member in members]
        check_replicas(replicas)
        scene = ObservedRun.of(replicas[0].simulation.engine, every)
        walk = Walk(levels, scene.unit_system.k_B, seed)
        stopped: KeyboardInterrupt | Terminated | None = None
        try:
            with (
                endings_are_told(),
                raising_on_signals(),
                threads as pool,
                opened_executor(pool, n_workers) as (chosen, _, _),
                progress_of(n_rounds, "exchange", progress, "attempt") as tell,
            ):
                for number in range(n_rounds + 1):
                    make_round(chosen, replicas, walk, number, prepare)
                    tell(number)
        except (KeyboardInterrupt, Terminated) as ending:
            stopped = ending
        finally:
            for replica in replicas:
                replica.go_back()

    ladder = Ladder(scene, levels, place, *walk.arrays())
    if stopped is not None:
        state = f"{len(ladder)} of {n_rounds} attempts are made and kept in {place}; make the same call again to go on"
        raise ending_of(stopped, state, ladder) from None
    return ladder


class Replica:
    """A replica: its simulation and its file, which goes on if it is there.

    member, simulation : of the replica.
    energies : potential energy at the end of each round in the file, the start first [energy].
    """

    def __init__(
        self,
        build: Callable[[Member], Simulation],
        member: Member,
        levels: list[float],
        every: int,
        files: ExitStack,
    ) -> None:
        self.member = member
        self.energies: list[float] = []
        self._every = every
        self._files = files
        self._first = 0
        self._writer: Any = None
        self._kept: tuple[Any, Any] | None = None
        self._methods: dict[float, Any] = {}
        with threads_by_default(1):
            self.simulation = build(member)
        check_canonical(self.simulation, member)
        contents = self._contents(levels)
        if contents is None:
            member.file.unlink(missing_ok=True)
            member.file.parent.mkdir(parents=True, exist_ok=True)
            return
        self._kept = (self._method_at(contents.parameters["temperature"]), contents.restart)
        self.simulation.method = self._kept[0]
        self.simulation.engine.go_on_from(contents.restart)
        self._first = int(contents.record.step[0])
        self.energies = contents.record.potential_energy.tolist()

    def _contents(self, levels: list[float]) -> Any:
        """The contents of the file; None if it is not there, is damaged, or is not of a replica at one of these
        temperatures: the replica then begins anew, to the same bits."""
        from minimd.core.files.h5md_reader import read_file, verify_frames

        with suppress(OSError, ValueError):
            verify_frames(self.member.file)
            contents = read_file(self.member.file)
            steps = contents.record.step
            rounds = steps[:1] + self._every * np.arange(len(steps))
            is_whole = np.array_equal(steps, rounds) and contents.step in steps[-1:]
            is_same = len(contents.system) == len(self.simulation.system)
            if is_whole and is_same and contents.parameters.get("temperature") in levels:
                return contents
        return None

    def _open(self, append: bool) -> None:
        context = open_trajectories(
            self.member.file,
            self.simulation.engine,
            store_forces=False,
            overwrite=False,
            append=append,
            every=self._every,
        )
        (self._writer,) = self._files.enter_context(context)

    def _method_at(self, temperature: float) -> Any:
        """The method at a temperature, the same object each time: an engine remembers the steps of several methods."""
        if temperature not in self._methods:
            method: Any = self.simulation.method
            arguments = method.parameters | {"temperature": temperature}
            self._methods[temperature] = type(method)(**arguments)
        return self._methods[temperature]

    def steps_to(self, number: int) -> int:
        """Steps to the end of a round; round 0 is the start, which has none."""
        return self._first + number * self._every - self.simulation.step if number else 0

    def begin_round(self, temperature: float) -> None:
        """Go to the temperature of the next round: v ← v √(T_new/T_old), relative to the drift. What the kinetic energy
        gains is given by the bath."""
        simulation = self.simulation
        before: Any = simulation.method
        if self._writer is None and self.energies:
            self._open(append=True)
        if temperature == before.temperature:
            return
        drift = simulation.drift
        velocities = simulation.velocities
        kinetic_energy = simulation.engine.kinetic_energy
        velocities[:] = drift + sqrt(temperature / before.temperature) * (velocities - drift)
        simulation.reservoir_energy += simulation.engine.kinetic_energy - kinetic_energy
        simulation.method = self._method_at(temperature)

    def store(self, checkpoint: Any, frame: Frame) -> None:
        """Store the end of a round, which may have been made in another process."""
        engine = self.simulation.engine
        if not is_at(engine, checkpoint):
            engine.go_on_from(checkpoint)
        if self._writer is None:
            self._first = frame.step
            self._open(append=False)
        self._kept = (self.simulation.method, checkpoint)
        self._writer.write(frame)
        self.energies.append(float(frame.observables["potential_energy"]))

    def go_back(self) -> None:
        """Go back to the end of the last whole round, from which the file goes on."""
        if self._kept is None:
            return
        method, checkpoint = self._kept
        if method is not self.simulation.method or not is_at(self.simulation.engine, checkpoint):
            self.simulation.method = method
            self.simulation.engine.go_on_from(checkpoint)


class Walk:
    """The way of replicas through the ladder.

    levels : (K,) temperatures, ascending.
    seed : of exchanges.
    now : (K,) place in the ladder of each replica.
    places, energies : at each attempt so far, before it: (K,) place and potential energy [energy] of each replica.
    accepted : at each attempt, (K − 1,), whether the pairs (k, k + 1) of the ladder were exchanged.
    """

    def __init__(self, levels: Array, k_B: float, seed: int) -> None:
        self.levels = levels
        self.now = np.arange(len(levels))
        self.places: list[Indices] = []
        self.energies: list[Array] = []
        self.accepted: list[NDArray[np.bool_]] = []
        self._betas = 1.0 / (k_B * levels)
        self._seed = seed

    def attempt(self, energies: Array) -> None:
        """Attempt exchanges, with the potential energy of each replica, (K,) [energy]."""
        number = len(self.places) + 1
        accepted = accepted_pairs(energies[np.argsort(self.now)], self._betas, self._seed, number)
        self.places.append(self.now)
        self.energies.append(energies)
        self.accepted.append(accepted)
        order = np.argsort(self.now)
        for k in np.flatnonzero(accepted):
            order[[k, k + 1]] = order[[k + 1, k]]
        self.now = np.argsort(order)

    def arrays(self) -> tuple[Indices, Array, NDArray[np.bool_]]:
        """places and energies, (A, K), and accepted, (A, K − 1)."""
        n = len(self.levels)
        return (
            np.array(self.places, dtype=np.int64).reshape(-1, n),
            np.array(self.energies, dtype=np.float64).reshape(-1, n),
            np.array(self.accepted, dtype=np.bool_).reshape(-1, n - 1),
        )


def accepted_pairs(energies: Array, betas: Array, seed: int, attempt: int) -> NDArray[np.bool_]:
    """Whether the neighbors k and k + 1 in the ladder exchange their temperatures, (K − 1,).

        P = min(1, exp((β_k − β_{k+1})(U_k − U_{k+1})))

    Pairs of an odd attempt begin with k = 0, those of an even one with k = 1. Random numbers depend on the seed and the
    number of the attempt alone.

    energies : (K,) potential energies at each temperature [energy].
    betas : (K,) 1/(k_B T) [1/energy].
    Y. Sugita, Y. Okamoto, Chem. Phys. Lett. 314, 141 (1999), eqs. 11 and 12."""
    key = np.random.SeedSequence(seed, spawn_key=(attempt, OF_ATTEMPTS))
    chances = np.random.default_rng(key).random(len(betas) - 1)
    probabilities = np.exp(np.minimum(0.0, np.diff(betas) * np.diff(energies)))
    pairs = np.arange(len(betas) - 1)
    return np.asarray((pairs % 2 != attempt % 2) & (chances < probabilities))


def make_round(
    executor: Executor, replicas: list[Replica], walk: Walk, number: int, prepare: Prepare | None
) -> None:
    """Let the replicas whose files end before this round make it, then attempt exchanges; round 0 is the start.
    Raises as exchange."""
    behind = [replica for replica in replicas if len(replica.energies) == number]
    futures: list[Any] = []
    try:
        for replica in behind:
            replica.begin_round(float(walk.levels[walk.now[replica.member.index]]))
            first = prepare if number == 0 else None
            job = replica.simulation, replica.member, replica.steps_to(number), first
            futures.append(executor.submit(moved, *job))
        for replica, future in zip(behind, futures, strict=True):
            replica.store(*future.result())
    except WorkerStopped:
        raise KeyboardInterrupt from None
    except (WorkerNeverBegan, WorkerDied, BrokenExecutor, CancelledError, PicklingError) as error:
        raise EnsembleError(
            f"round {number} could not be made: {type(error).__name__}: {sentence(error)}. {ANOTHER}"
        ) from error
    finally:
        end_all(executor, futures)
    if number:
        walk.attempt(np.array([replica.energies[number] for replica in replicas]))


def moved(
    simulation: Simulation, member: Member, n_steps: int, prepare: Prepare | None
) -> tuple[Any, Frame]:
    """Make the steps of a round, in any process; returns the checkpoint and the frame at its end.
    Only round 0 warns."""
    try:
        with threads_by_default(1), quiet() if n_steps else nullcontext():
            if prepare is not None:
                prepare(simulation, member)
            place = crash_file_place(True, member.file)
            simulation.run(
                n_steps, every=max(1, n_steps), progress=False, crash_report=place or False
            )
            return simulation.engine.checkpoint(), simulation.frame()
    except (NonFiniteError, ConstraintError) as error:
        error.add_note(f"This is the replica of {member}.")
        raise


def is_at(engine: Engine, checkpoint: Any) -> bool:
    """Whether an engine is in the state of a checkpoint."""
    state = checkpoint.state
    is_there = np.array_equal(engine.positions, state.positions)
    return (
        is_there
        and engine.step == state.step
        and np.array_equal(engine.velocities, state.velocities)
    )


def checked_ladder(temperatures: Any) -> Array:
    """The temperatures as an array.
    Raises ValueError unless they are two or more positive numbers that ascend."""
    demand = "two or more positive numbers in ascending order"
    levels = checked_numbers("temperatures", temperatures, demand)
    is_ladder = levels.ndim == 1 and len(levels) > 1 and np.isfinite(levels).all()
    if not is_ladder or levels[0] <= 0.0 or (np.diff(levels) <= 0.0).any():
        raise ValueError(f"temperatures must be {demand}; temperatures = {shown(levels.tolist())}")
    return levels


def check_canonical(simulation: Any, member: Member) -> None:
    """Raise TypeError, ValueError unless build has returned a simulation that samples the canonical ensemble."""
    checked_kind("what build returns", simulation, Simulation, "a Simulation")
    method = simulation.method
    engine = simulation.engine
    temperature = method.parameters.get("temperature")
    is_constant = isinstance(temperature, float | int)
    counts = isinstance(method, HybridMonteCarlo)  # its memory
    remembers = engine.interactions.memories or (method.memory is not None and not counts)
    faults = {
        "which is no thermostat": not method.is_thermostat,
        "whose temperature is no constant above zero": not is_constant or temperature <= 0.0,
        "whose friction is zero": method.parameters.get("friction") == 0.0,
        f"and {simulation.barostat!r}, which changes the volume": simulation.barostat is not None,
        "and a memory, as of an active force, which no exchange of temperatures transforms": remembers,
        "and forces that depend on time": engine.interactions.depend_on_time,
    }
    for fault, is_there in faults.items():
        if is_there:
            raise ValueError(
                "build must return simulations that sample the canonical ensemble, with a thermostat at a constant "
                f"temperature; that of {member} has {method!r}, {fault}"
            )


def check_replicas(replicas: list[Replica]) -> None:
    """Raise ValueError unless all replicas have the same atoms, cell, constraints and potentials, as far as their repr
    shows these, and each its own noise."""
    first = replicas[0].simulation
    seeds: dict[Any, Member] = {}
    for replica in replicas:
        simulation = replica.simulation
        system = simulation.system
        is_same = np.array_equal(system.masses, first.system.masses)
        if not is_same or not system.cell.same_as(first.system.cell):
            raise ValueError(
                f"build must return the same atoms in the same cell for all replicas; {replica.member} has {system!r}, "
                f"{replicas[0].member} has {first.system!r}"
            )
        laws = (simulation.potentials, simulation.n_dof, system.units)
        if repr(laws) != repr((first.potentials, first.n_dof, first.system.units)):
            raise ValueError(
                "build must return the same potentials and constraints for all replicas; potentials, degrees of "
                f"freedom and units of {replica.member} are {laws!r}"
            )
        seed = replica.simulation.method.parameters.get("seed")
        if seed is not None and seeds.setdefault(seed, replica.member) is not replica.member:
            raise ValueError(
                f"build must give each thermostat a seed of its own, such as member.seed; {seeds[seed]} and "
                f"{replica.member} have the seed {seed}"
            )
