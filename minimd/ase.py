"""The bridge to ASE: atoms in and out, calculators both ways, velocity Verlet for ASE's scripts, ASE's trajectory files.

ASE's units are Å, eV, u and Å √(u/eV); minimd.units.ASE are the same, so nothing is converted here. A scene in reduced
units crosses with its numbers unchanged.
"""

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import ase.io
import numpy as np
from ase import Atoms
from ase.calculators.calculator import BaseCalculator, all_changes
from ase.calculators.calculator import Calculator as ASECalculator
from ase.calculators.singlepoint import SinglePointCalculator
from ase.data import atomic_numbers
from ase.io.trajectory import TrajectoryWriter
from ase.md.md import MolecularDynamics
from ase.stress import full_3x3_to_voigt_6_stress
from numpy.typing import ArrayLike, NDArray

from minimd import integrators, units
from minimd.cell import Cell
from minimd.errors import NonFiniteError
from minimd.forces import Forces, Potential
from minimd.neighbors.closest import closest_pair
from minimd.potentials.pair_loop import FORCES, PER_ATOM, TOTALS
from minimd.record import Frame
from minimd.simulation import Simulation
from minimd.system import System

LABELS = "species_labels"  # the array of an ase.Atoms that holds species which are no chemical elements


def system_from_atoms(atoms: Atoms, bonds: ArrayLike | None = None) -> System:
    """A system in ASE's units: positions, velocities, masses, cell and periodicity of the atoms.

    Parameters
    ----------
    atoms : ase.Atoms. Species are the chemical symbols, or the labels that atoms_from_system left there.
    bonds : (B, 2) int, pairs of bonded atoms; ASE's atoms carry none.

    Raises
    ------
    TypeError : for something that is no ase.Atoms.  ValueError : for atoms with constraints, and as System does.
    """
    if not isinstance(atoms, Atoms):
        raise TypeError(f"a minimd System or an ase.Atoms is expected; got {type(atoms).__name__}")
    if atoms.constraints:
        names = ", ".join(sorted({type(constraint).__name__ for constraint in atoms.constraints}))
        raise ValueError(f"atoms.constraints must be empty, minimd would ignore them; it holds {names}: remove them, or use ASE's dynamics")
    return _system(atoms, bonds)


def atoms_from_system(system: System) -> Atoms:
    """ASE's atoms with the positions (not wrapped), momenta, masses, cell and periodicity of a system; bonds are lost.

    Species that are chemical symbols become elements. All others become 'X', ASE's symbol for no element, and all labels
    are kept in the array "species_labels", where system_from_atoms finds them again. Numbers cross unchanged: for a system
    in reduced units they are no Å and eV.
    """
    symbols = [label if label in atomic_numbers else "X" for label in system.species.tolist()]
    momenta = system.velocities * system.masses[:, None]
    atoms = Atoms(symbols, system.positions, momenta=momenta, masses=system.masses, cell=system.cell.vectors, pbc=system.cell.pbc)
    if not set(system.species_names) <= set(atomic_numbers):
        atoms.set_array(LABELS, system.species)
    return atoms


def _system(atoms: Atoms, bonds: ArrayLike | None) -> System:
    species = atoms.arrays.get(LABELS, atoms.get_chemical_symbols())
    velocities = atoms.get_velocities()
    return System(atoms.positions, masses=atoms.get_masses(), velocities=velocities, cell=_cell(atoms), species=species, bonds=bonds, units=units.ASE)


def _cell(atoms: Atoms) -> Cell:
    return Cell.of(atoms.cell.array, atoms.pbc)


def _same_labels(one: Atoms, other: Atoms) -> bool:
    return np.array_equal(one.arrays.get(LABELS, ()), other.arrays.get(LABELS, ()))


def _same_scene(one: Atoms, other: Atoms) -> bool:
    """True if only positions, momenta and cell can differ."""
    arrays = ((one.numbers, other.numbers), (one.get_masses(), other.get_masses()), (one.pbc, other.pbc))
    return all(np.array_equal(a, b) for a, b in arrays) and _same_labels(one, other) and one.calc is other.calc


class Calculator(ASECalculator):
    """A calculator for ase.Atoms: their energy, forces and stress from potentials of minimd, in Å and eV.

    The stress is −W/V, tension positive, in the order xx yy zz yz xz xy, without the ideal-gas part, for every cell with
    three lattice vectors; stresses are each atom's share of it. The pair list is kept while atoms move: see PairList.
    ASE applies the constraints of the atoms itself. Copies and pickles carry the potentials, not the list.

    Parameters
    ----------
    potentials : one potential or several.
    bonds : (B, 2) int, pairs of bonded atoms.
    skin : of the pair lists [Å]; chosen if not given.

    Raises
    ------
    TypeError, ValueError : when it first meets the atoms, as System and Forces do.
    NonFiniteError : where a force or an energy is not finite, as for two atoms on one spot; it names the closest pair.
    """

    implemented_properties = ["energy", "free_energy", "energies", "forces", "stress", "stresses"]  # noqa: RUF012 - ASE's form

    def __init__(self, potentials: Potential | Sequence[Potential], bonds: ArrayLike | None = None, skin: float | None = None) -> None:
        super().__init__()
        self.potentials, self.bonds, self.skin = potentials, bonds, skin
        self._plan: tuple[Atoms, Forces] | None = None

    @property
    def n_builds(self) -> int:
        """How often a pair list was built since the scene was last planned."""
        return self._plan[1].n_builds if self._plan else 0

    def calculate(self, atoms: Atoms | None = None, properties: Sequence[str] = ("energy",), system_changes: Sequence[str] = all_changes) -> None:
        """Fill results. What is kept is decided by a look at the atoms: system_changes knows neither masses nor failed calls."""
        super().calculate(atoms, list(properties), list(system_changes))
        per_atom = bool({"energies", "stresses"} & set(properties))
        forces = self._forces_at(self.atoms)
        forces.compute(PER_ATOM if per_atom else TOTALS)
        if not (np.isfinite(forces.potential_energy) and np.isfinite(forces.forces).all()):
            raise NonFiniteError(f"forces or energies are not finite; the closest pair is {closest_pair(forces.system)}: move them apart")
        self.results = _results(forces, _volume(self.atoms), per_atom)

    def check_state(self, atoms: Atoms, tol: float = 1e-15) -> list[str]:
        """ASE's list of what has changed; another label counts as another atomic number."""
        changes = super().check_state(atoms, tol)
        return changes if self.atoms is None or _same_labels(self.atoms, atoms) else [*changes, "numbers"]

    def adopt(self, atoms: Atoms, potential_energy: float, forces: NDArray[np.float64]) -> None:
        """Take over results [eV], (N, 3) [eV/Å] that minimd has found for these atoms and potentials elsewhere."""
        self.atoms = atoms.copy()
        self.results = {"energy": potential_energy, "free_energy": potential_energy, "forces": forces.copy()}

    def _forces_at(self, atoms: Atoms) -> Forces:
        """The Forces on these atoms: those of the last call with their pair list, if only positions or an unbonded scene's cell changed."""
        cell = _cell(atoms)
        if self._plan and _same_scene(self._plan[0], atoms):
            forces = self._plan[1]
            if cell.same_as(forces.system.cell) or not len(forces.system.bonds):  # with bonds the skin may depend on the cell
                forces.system.positions[:], forces.system.cell = atoms.positions, cell
                return forces
        forces = Forces(_system(atoms, self.bonds), self.potentials, self.skin)
        self._plan = atoms, forces
        return forces

    def _get_name(self) -> str:
        return "minimd"

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_plan": None}


def _volume(atoms: Atoms) -> float:
    """Volume of the parallelepiped, periodic or not [Å³]; 0 if there is none."""
    return float(atoms.get_volume()) if atoms.cell.rank == 3 else 0.0


def _results(forces: Forces, volume: float, per_atom: bool) -> dict:
    energy = forces.potential_energy
    results = {"energy": energy, "free_energy": energy, "forces": forces.forces.copy()}
    if per_atom:
        results["energies"] = forces.energies
    if volume:
        results["stress"] = -full_3x3_to_voigt_6_stress(forces.virial) / volume
    if volume and per_atom:
        results["stresses"] = -forces.virials / volume
    return results


class VelocityVerlet(MolecularDynamics):
    """ase.md.verlet.VelocityVerlet for atoms whose calculator is a minimd Calculator, with the steps made by minimd.

    run makes all steps between two observations at once, then brings atoms, momenta and the calculator's results up to
    date; an observer may change positions, momenta or cell. irun yields after every step, as ASE's does.
    Parameters (atoms, timestep, trajectory, logfile, loginterval), attach and get_time are ASE's.

    Raises
    ------
    TypeError : when it runs, if the calculator of the atoms is another one.  ValueError : for atoms with constraints.
    NonFiniteError : if the run blows up; atoms hold the last good state.
    KeyboardInterrupt : after Ctrl-C; atoms hold the state of the last whole step.
    """

    _simulation: Simulation
    _made_for: Atoms | None = None

    def run(self, steps: int = 50) -> bool:
        """Make so many steps; True at their end, False if an observer lowered max_steps."""
        next(self.irun(steps))  # what ASE does before the first step
        while self.nsteps < self.max_steps:
            self._advance(self._next_look() - self.nsteps)
            self._refresh_properties()
            self.log()
            self.call_observers()
        return self.nsteps == self.max_steps

    def step(self) -> NDArray[np.float64]:
        """Make one step, which the caller counts; returns the forces after it, (N, 3) [eV/Å]."""
        self._advance(1)
        self.nsteps -= 1
        return self.atoms.get_forces(md=True)

    def _next_look(self) -> int:
        """The step after which the next observer is due, or the last one: interval n > 0 is every n-th, −n the n-th only."""
        looks = [n * (self.nsteps // n + 1) if n > 0 else -n for _, n, _, _ in self.observers]
        return min([self.max_steps, *(look for look in looks if look > self.nsteps)])

    def _advance(self, n_steps: int) -> None:
        """Make n_steps steps; atoms and nsteps are right also after an exception."""
        atoms, simulation = self.atoms, self._simulation_at(self.atoms)
        simulation.method = integrators.VelocityVerlet(self.dt)
        start = simulation.step
        try:
            record = simulation.run(n_steps, every=n_steps, progress=False)
        finally:
            self.nsteps += simulation.step - start
            atoms.positions[:] = simulation.positions
            atoms.set_momenta(_momenta(simulation))
        atoms.calc.adopt(atoms, float(record.potential_energy[-1]), simulation.forces)

    def _simulation_at(self, atoms: Atoms) -> Simulation:
        """The simulation, with positions and momenta of the atoms; a new one if anything else was changed from outside."""
        made_for = self._made_for
        if made_for is None or atoms.constraints or not (_same_scene(made_for, atoms) and _cell(made_for).same_as(_cell(atoms))):
            return self._new_simulation(atoms)
        simulation = self._simulation
        if not np.array_equal(atoms.positions, simulation.positions):
            simulation.positions[:] = atoms.positions
            simulation.forces_are_current = False
        if not np.array_equal(atoms.get_momenta(), _momenta(simulation)):
            simulation.velocities[:] = atoms.get_velocities()
        return simulation

    def _new_simulation(self, atoms: Atoms) -> Simulation:
        calculator = atoms.calc
        if not isinstance(calculator, Calculator):
            name = type(calculator).__name__
            raise TypeError(f"the calculator of atoms must be a minimd.ase.Calculator; it is {name}: use ase.md.verlet.VelocityVerlet")
        system, method = system_from_atoms(atoms, calculator.bonds), integrators.VelocityVerlet(self.dt)
        self._simulation = Simulation(system, calculator.potentials, method, skin=calculator.skin)
        self._made_for = atoms.copy()
        self._made_for.calc = calculator
        return self._simulation


def _momenta(simulation: Simulation) -> NDArray[np.float64]:
    return simulation.velocities * simulation.system.masses[:, None]


class ForcesFromCalculator:
    """A potential for scenes of minimd: forces, energy and virial from any calculator of ASE.

    The energy is the one that belongs to the forces (free_energy), where the calculator has it. The virial is
    W = −stress · volume; in an open scene W = Σ r ⊗ F, which needs no stress. Where neither is to be had, virial and
    pressure are NaN, and a warning says so. The units of the calculator (Å, eV) should be those of the system.

    calculator : of ase.calculators, an EMT() for instance.  Raises TypeError if it is none.
    """

    def __init__(self, calculator: BaseCalculator) -> None:
        if not (hasattr(calculator, "get_forces") and hasattr(calculator, "get_potential_energy")):
            raise TypeError(f"calculator must be a calculator of ASE, such as ase.calculators.emt.EMT(); got {calculator!r}")
        self.calculator = calculator

    def bind(self, system: System) -> "CalculatorTerm":
        """The term that asks the calculator for the forces on this system."""
        atoms = atoms_from_system(system)
        atoms.calc = self.calculator
        return CalculatorTerm(atoms)


class CalculatorTerm:
    """Forces on one system from the calculator of its atoms; see minimd.forces.Term."""

    def __init__(self, atoms: Atoms) -> None:
        self._atoms = atoms
        self._implemented = getattr(atoms.calc, "implemented_properties", ())

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        """Add forces, (N, 3); for TOTALS and PER_ATOM also energies, (N,), and virials, (N, 6), the latter in equal shares."""
        self._atoms.positions[:], self._atoms.cell[:] = system.positions, system.cell.vectors
        own = self._atoms.get_forces()
        forces += own
        if detail != FORCES:
            energies += self._shares_of_energy(detail)
            virials += self._virial(system, own) / len(system)

    def skipped(self) -> Iterable[str]:
        """Nothing that minimd knows of."""
        return ()

    def _shares_of_energy(self, detail: int) -> NDArray[np.float64]:
        """(N,), with the right sum; the calculator's own shares if it has them and somebody asks."""
        total = self._atoms.get_potential_energy(force_consistent="free_energy" in self._implemented)
        own = detail == PER_ATOM and "energies" in self._implemented
        shares = self._atoms.get_potential_energies() if own else np.zeros(len(self._atoms))
        return shares + (total - shares.sum()) / len(shares)

    def _virial(self, system: System, forces: NDArray[np.float64]) -> NDArray[np.float64]:
        """W, (6,) as xx yy zz yz xz xy."""
        if not system.cell.is_periodic:
            return full_3x3_to_voigt_6_stress((system.positions - system.positions.mean(axis=0)).T @ forces)
        try:
            return -self._atoms.get_stress() * _volume(self._atoms)
        except NotImplementedError as reason:
            warnings.warn(f"{type(self._atoms.calc).__name__} gives no stress ({reason}); virial and pressure are NaN", stacklevel=2)
            return np.full(6, np.nan)


class ASEWriter:
    """A trajectory written by ASE, in the units of the system: .traj in float64, .xyz and .extxyz as extended XYZ, with 8 decimals.

    Each frame holds positions (not wrapped), momenta, masses, cell, the potential energy as that of a calculator, forces
    if they are to be stored, and step and time in info.
    """

    def __init__(self, file: Path, simulation: Simulation, store_forces: bool) -> None:
        self._template = atoms_from_system(simulation.system)
        self._store_forces = store_forces
        self._output = TrajectoryWriter(file, "w") if file.suffix.lower() == ".traj" else file.open("w", encoding="utf-8")

    def write(self, frame: Frame) -> None:
        """Append one frame."""
        atoms = self._template.copy()
        atoms.positions[:] = frame.positions
        atoms.set_momenta(frame.velocities * atoms.get_masses()[:, None])
        atoms.info.update(step=frame.step, time=frame.time)
        forces = frame.forces if self._store_forces else None
        atoms.calc = SinglePointCalculator(atoms, energy=frame.observables["potential_energy"], forces=forces)
        if isinstance(self._output, TrajectoryWriter):
            self._output.write(atoms)
        else:
            ase.io.write(self._output, atoms, format="extxyz")

    def close(self) -> None:
        """Finish the file."""
        self._output.close()
