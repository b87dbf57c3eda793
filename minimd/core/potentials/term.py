"""The interface of all forces: a potential has bind(system), which returns a Term; a Term adds its forces to a sum.

At the end of the file: what may stand where potentials are expected, and calculators of ASE.
"""

from collections.abc import Iterable
from copy import deepcopy
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.program import Operation, in_python
from minimd.core.console.display import Displayed, Rows, as_text, call_of
from minimd.core.console.quiet import warn
from minimd.core.console.words import shown
from minimd.core.neighbors.queries import closest_pair
from minimd.core.neighbors.verlet_list import VerletList
from minimd.core.potentials.law import ACCURACY, agree
from minimd.core.potentials.prolates import Split
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import checked_pairs
from minimd.core.structure.cell import Images
from minimd.core.structure.system import System

if TYPE_CHECKING:
    from ase import Atoms

FORCES, TOTALS, PER_ATOM = 0, 1, 2  # the detail of an evaluation; each includes the ones before
ALWAYS = "cutoff", "truncation", "accuracy"  # of the arguments, are shown
MOST_SHOWN = 6  # numbers of an array, where potentials are printed
BOND_LOOP = "bond loop"
VOIGT = (0, 1, 2, 1, 0, 0), (0, 1, 2, 2, 2, 1)  # xx yy zz yz xz xy
# comparisons of force and energy; from where, and how far atoms move, see _length_of
TRIES = 3
SHAKEN = 1e-2
STEP = 1e-4
ROUGH = 10.0  # of a slope: relative to the difference of two of them
CLOSE = 1e-2  # the closest distance that counts, relative to the mean spacing of atoms


class Embedding(NamedTuple):
    """The energy F(ρ) of an atom in the density that its neighbors give it, see embedded_laws.

    law : law type of F.
    table : (S, P) numbers of each species; S = 1 if all atoms are alike.
    """

    law: tuple
    table: NDArray


class PairLaw(NamedTuple):
    """A law on all pairs within a cutoff, as the planner needs it to find a list of neighbors.

    name : of the potential, for messages.
    law : law type, truncation included.
    cutoff : the largest [length].
    table : (S, S, 1 + P) numbers of each pair of species, the squared cutoff first; S = 1 if all atoms are alike.
    bonded_scale : factors for pairs one, two and three bonds apart; all laws share one list.
    charges : (N,) of atoms [√(energy · length)], whose product is then the first parameter of the law, and not in the
        table; None for laws without.
    split : how 1/r is split, if a sum over waves belongs to the law.
    method : of that sum, see Coulomb.
    slab : see Coulomb.
    exclusions : (P, 2) int, pairs on which it does not act, whatever bonded_scale says.
    embedding : of the atoms, whose slopes F′ are then the first two parameters of the law, and not in the table; None
        for laws without.
    """

    name: str
    law: tuple
    table: NDArray
    cutoff: float
    bonded_scale: tuple[float, ...]
    charges: NDArray | None = None
    split: Split | None = None
    method: str = ""
    slab: str = "none"
    exclusions: Indices = checked_pairs("exclusions", None)
    embedding: Embedding | None = None

    @property
    def n_parameters(self) -> int:
        """Of the law."""
        return self.table.shape[-1] - 1 + len(self.of_atoms)

    @property
    def of_atoms(self) -> tuple[float, ...]:
        """The parameters that are not in the table, of a pair with the largest charges and without slopes."""
        if self.embedding is not None:
            return 0.0, 0.0
        return () if self.charges is None else (-(float(np.abs(self.charges).max()) ** 2),)


class Target(NamedTuple):
    """What the operations of an evaluation work on.

    detail : FORCES, TOTALS or PER_ATOM.
    forces : (N, 3) output [energy/length].
    energies, virials : to which TOTALS and PER_ATOM add, (N,) and (N, 6); or (1,) and (1, 6) if that is enough for all
        terms and TOTALS.
    slots : (3 S,), of LinkedTerm.
    images : Images of the cell.
    steps : Steps, in fixed-point arithmetic, where forces and slots are impulses, int64 in steps of momentum; else ().
    """

    detail: int
    forces: NDArray
    energies: NDArray
    virials: NDArray
    slots: NDArray
    images: Images
    steps: Any = ()


class Term:
    """One kind of force on one system: what bind of a potential returns. Only add must be defined.

        class Gravity:                                      # a potential: any object with bind(system)
            def bind(self, system):
                return Weight(system.masses)

        class Weight(Term):                                 # F = −m g e_z, U = Σ m g z
            acts_from_outside = True

            def __init__(self, masses):
                self.weights = 9.81 * masses

            def add(self, system, detail, forces, energies, virials):
                forces[:, 2] -= self.weights
                if detail != FORCES:
                    energies += self.weights * system.positions[:, 2]

    bind is called when a simulation is made, and again when the cell changes; add is called at each evaluation, and may
    call kernels compiled with numba.njit on the arrays. examples/own_force.py has two such potentials. The virial
    decides the pressure; fields and walls, which act from outside, may leave it out.

    Attributes
    ----------
    pair_law : a PairLaw for the planner to run on a list of neighbors; None for a term that adds its forces itself.
    cutoff : an atom that moves farther in one step may pass another without interacting [length].
    shortest_length : rounding errors of separations must be small compared with it [length].
    list : the list of neighbors, if the term keeps one.
    widest_skin : that the list can have [length].  summary :
        of the list, for the report.
    ingredient : name of what this term adds to a scene; the report lists it if absent.
    warning : for the user, given once.
    name : of the potential, for messages.
    acts_from_outside : whether its forces need not add up to zero, as those of fields and walls:
        the total momentum is then not constant.
    needs_one_accumulator : whether TOTALS needs the first elements of energies and virials only.
    depends_on_time : whether its forces depend on time. Its attribute time [time] is then set before each evaluation,
        and it must set power to ∂U/∂t of its energy [energy/time],
        from which the work that is done from outside is counted. is_moved says whether that holds just before this time
        and just after it: one of both where a motion begins or ends.
    is_checked : whether the first run compares its force with its energy, see check_force. False for a force that is no
        gradient, such as friction beside an energy. A term without any energy is not checked.
    fits_grid : whether it can add impulses, for precision="fixed-point".
    has_heat_flux : whether its energies and virials of atoms are halves of pairs, or it is a LinkedTerm, as
        Forces.heat_flux needs it.
    memory : (M,) float64, what it remembers from step to step, changed in place; undone with a step that is undone, and
        stored with each restart. None without.
    assigns : whether its operations set all forces and do not add to them: of one term only, which comes first.
    """

    pair_law: PairLaw | None = None
    cutoff: float = inf
    shortest_length: float = inf
    list: VerletList | None = None
    widest_skin: float = inf
    summary: str = ""
    ingredient: str = ""
    warning: str = ""
    name: str = ""
    acts_from_outside: bool = False
    needs_one_accumulator: bool = False
    depends_on_time: bool = False
    time: float = 0.0
    power: float = 0.0
    is_moved: tuple[bool, bool] = (True, True)
    is_checked: bool = True
    fits_grid: bool = False
    has_heat_flux: bool = False
    assigns: bool = False
    memory: Array | None = None

    def add(
        self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray
    ) -> None:
        """Add to forces (N, 3), and unless detail is FORCES to energies (N,) and virials (N, 6), xx yy zz yz xz xy.

        With TOTALS only the sums of energies and virials over all atoms must be right, with PER_ATOM each atom's share.
        """
        raise NotImplementedError(f"{type(self).__name__} has no add")

    def operations(self, system: System, target: Target) -> Iterable[Operation]:
        """The operations that add the forces of this term to a target."""
        arrays = target.forces, target.energies, target.virials
        yield in_python(lambda: self.add(system, target.detail, *arrays))

    def collect(self, target: Target) -> None:
        """After operations: add energies and virials that they have left elsewhere to those of the target."""

    def follow(self, system: System) -> bool:
        """Whether the term, after a strain of atoms and cell, stands for the system; else it must be bound again."""
        return False

    def skipped(self) -> Iterable[str]:
        """What this term does not need in this scene, for the report."""
        return ()

    def tail(self, system: System) -> tuple[float, float]:
        """Energy, and trace of the virial, of the pairs beyond the cutoff [energy]."""
        return 0.0, 0.0


class OwnTerm(Term):
    """Base class of terms that are compiled, as minimd's own are; those that add with force_along set fits_grid."""

    is_checked = False
    needs_one_accumulator = True


class NoTerm(OwnTerm):
    """The term of a potential in a system where it has nothing to act on."""

    fits_grid = True
    has_heat_flux = True

    def __init__(self, warning: str = "") -> None:
        self.warning = warning

    def follow(self, system: System) -> bool:
        """See Term."""
        return True

    def operations(self, system: System, target: Target) -> Iterable[Operation]:
        """See Term."""
        return ()


class Potential(Protocol):
    """What a Simulation takes: minimd's potentials, and any object with bind."""

    def bind(self, system: System) -> Any:
        """The Term for this system, or another object with add, and perhaps skipped, acts_from_outside, is_checked."""


class OwnPotential(Displayed):
    """Base class of minimd's own potentials; type checkers see a list of several different ones as a list of it."""

    def bind(self, system: System) -> Term:
        """See Potential."""
        raise NotImplementedError(f"{type(self).__name__} has no bind")

    def arguments(self) -> dict[str, Any]:
        """All arguments that recreate this potential, by name."""
        return {}

    def in_full(self) -> str:
        """The call that recreates this potential, for comparison."""
        return call_of(self, self.arguments(), ALWAYS)

    def __repr__(self) -> str:
        return call_of(self, self.arguments(), ALWAYS, MOST_SHOWN)

    def display_rows(self) -> Rows:
        """See Displayed."""
        rows = [("potential", type(self).__name__)]
        for name, value in self.arguments().items():
            if value is not None:
                rows.append((name, as_text(value)))
        return rows


def bound(potential: Any, system: System) -> Term:
    """The term of a potential on a system.
    Raises TypeError for something that is no potential, or binds to something that is no term."""
    if not hasattr(potential, "bind") or isinstance(potential, type):
        raise TypeError(
            "potentials must be potentials of minimd, such as LennardJones, or objects with bind(system); "
            "a law of your own is passed as PairPotential(law, parameters, cutoff): see docs/own-laws.md; "
            f"got {shown(potential)}"
        )

    term = potential.bind(system)
    if isinstance(term, Term):
        return term
    if not hasattr(term, "add"):
        raise TypeError(
            "bind must return a term, an object with add(system, detail, forces, energies, virials); "
            f"that of {shown(potential)} is {shown(term)}"
        )

    completed = Term()  # what the object has, and the defaults of a Term
    for name in ("add", "skipped", "acts_from_outside", "is_checked"):
        if hasattr(term, name):
            setattr(completed, name, getattr(term, name))
    return completed


def check_force(potential: Any, system: System, time: float) -> bool:
    """Compare the force of a term with its energy at a time: F·w = −dU/dw, along random displacements w of all atoms.

    The slope is a central difference. The larger the disagreement with that of twice the step, as at a jump of the
    energy or in float32, the more may the force differ. A copy of the potential is bound to a copy of the system: the
    term of the run sees nothing of it. Returns whether they were compared: a potential that cannot be copied, or has
    no energy, is not.
    Raises ValueError if most of the finite forces are wrong.
    """
    try:
        potential, system = deepcopy((potential, system))
    except Exception:  # whatever an object of the user's raises
        return False

    term = bound(potential, system)
    term.time = time
    rng = np.random.default_rng(1)
    length = _length_of(system)
    # where no force is zero by symmetry
    positions = system.positions + SHAKEN * length * rng.standard_normal(system.positions.shape)

    def evaluate(displacement: NDArray | float) -> tuple[NDArray, NDArray]:
        forces = np.zeros_like(positions)
        energies = np.zeros(len(positions))
        virials = np.zeros((len(positions), 6))
        system.positions[:] = positions + displacement
        term.add(system, TOTALS, forces, energies, virials)
        return forces, energies

    def slope_along(way: NDArray, h: float) -> float:
        differences = evaluate(-h * way)[1] - evaluate(h * way)[1]
        return float(differences.sum()) / (2.0 * h)

    forces, energies = evaluate(0.0)
    if not energies.any():
        return False
    n_compared = 0
    faults = []

    for way in rng.standard_normal((TRIES, *positions.shape)):
        force = float((forces * way).sum())
        slope = slope_along(way, STEP * length)
        coarse = slope_along(way, 2.0 * STEP * length)
        n_compared += bool(np.isfinite([force, slope, coarse]).all())
        if not agree(force, slope, np.abs(energies).sum() / length, ROUGH * abs(slope - coarse)):
            faults.append(f"F·w = {force:.8g}, but -dU/dw = {slope:.8g}")

    if 2 * len(faults) > n_compared:
        raise ValueError(
            f"the force of {shown(potential)} must be minus the gradient of its energy, to a relative {ACCURACY:g}; "
            f"for a displacement w of all atoms {faults[0]}; "
            "a term whose force is no gradient sets is_checked = False"
        )
    return True


def _length_of(system: System) -> float:
    """A length by which atoms can move: the closest distance, within bounds if they overlap or are far off [length]."""
    cell = system.cell
    positions = system.positions
    sizes = (
        cell.heights[cell.pbc].min(initial=inf),
        np.ptp(positions, axis=0).max(),
        np.abs(positions).max(),
        1.0,
    )
    size = next(size for size in sizes if 0.0 < size < inf)
    spacing = size / len(system) ** (1.0 / 3.0)
    pair = closest_pair(system)
    return float(np.clip(pair.distance if pair else spacing, CLOSE * spacing, spacing))


def no_bonds(what: str, groups: str = "bonds") -> str:
    """The warning that something made for bonds, angles, dihedrals or impropers finds none."""
    key = {"bonds": "structure.bonds", "angles": "triples"}.get(groups, "quadruples")
    return (
        f"{what} has no effect: the system has no {groups}; give them as System({groups}=...) or "
        f"System.from_ase(atoms, {groups}=...), in a scene file as {key}"
    )


def as_potentials(given: Any) -> tuple[Any, ...]:
    """One potential or several as a tuple. A calculator of ASE becomes the potentials of a minimd.ase.Calculator, or
    ForcesFromCalculator, with a warning; other objects stay as they are, to be refused by bound."""
    potentials: list[Any] = []
    for potential in given if isinstance(given, list | tuple) else (given,):
        own = getattr(potential, "own_potentials", None)
        if hasattr(potential, "bind") or not is_calculator(potential):
            potentials.append(potential)
        elif own is not None:
            potentials.extend(as_potentials(own))
        else:
            warn(calculators_said(potential))
            potentials.append(ForcesFromCalculator(potential))
    return tuple(potentials)


def is_calculator(calculator: Any) -> bool:
    """Whether an object has the methods of a calculator of ASE."""
    return hasattr(calculator, "get_forces") and hasattr(calculator, "get_potential_energy")


def calculators_said(calculator: Any) -> str:
    """The warning, given once, for steps with a calculator that is not minimd's."""
    name = type(calculator).__name__
    return (
        f"the calculator is {name}, not minimd.ase.Calculator: "
        f"minimd makes the steps, but only as fast as {name} computes the forces"
    )


class ForcesFromCalculator(OwnPotential):
    """A potential for systems of minimd: forces, energy and virial from any calculator of ASE.

    The energy is the one that is consistent with the forces (free_energy) if the calculator has it. The virial is
    W = −stress · volume; in a system without periodic directions it is W = Σ r ⊗ F, which needs no stress. If the
    calculator gives no stress that is needed, virial and pressure are NaN, and a warning says so. The units of the
    system should be those of the calculator (Å, eV).

    calculator : of ase.calculators, such as EMT().
    Raises TypeError for anything else."""

    def __init__(self, calculator: Any) -> None:
        if not is_calculator(calculator):
            raise TypeError(
                "calculator must be a calculator of ASE, such as ase.calculators.emt.EMT(); "
                f"got {shown(calculator)}"
            )
        self.calculator = calculator

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return {"calculator": type(self.calculator)}

    def bind(self, system: System) -> Any:
        """The term that gets the forces on this system from the calculator."""
        from minimd.core.structure.ase_atoms import atoms_from_system

        atoms = atoms_from_system(system)
        # minimd needs the forces without constraints, which it applies itself
        atoms.set_constraint()
        atoms.calc = self.calculator
        return CalculatorTerm(atoms)


class CalculatorTerm(Term):
    """Forces on one system from the calculator of its atoms."""

    is_checked = False  # an evaluation may be dear, and float32 too rough for differences

    def __init__(self, atoms: "Atoms") -> None:
        self._atoms = atoms
        self._implemented = getattr(atoms.calc, "implemented_properties", ())

    def add(
        self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray
    ) -> None:
        """See Term. Shares are equal; but PER_ATOM takes energies of atoms from a calculator that has them, shifted to
        the right sum."""
        atoms = self._atoms
        atoms.positions[:] = system.positions
        atoms.cell[:] = system.cell.vectors
        own = atoms.get_forces(apply_constraint=False)
        forces += own
        if detail != FORCES:
            has_free_energy = "free_energy" in self._implemented
            total = atoms.get_potential_energy(force_consistent=has_free_energy)
            shares = np.zeros(len(atoms))
            if detail == PER_ATOM and "energies" in self._implemented:
                shares = atoms.get_potential_energies()
            energies += shares + (total - shares.sum()) / len(shares)
            virials += self._virial(system, own) / len(system)

    def _virial(self, system: System, forces: Array) -> Array:
        """W, (6,) as xx yy zz yz xz xy."""
        if not system.cell.is_periodic:
            virial = (system.positions - system.positions.mean(axis=0)).T @ forces
            return 0.5 * (virial + virial.T)[VOIGT]
        try:
            from minimd.core.structure.ase_atoms import volume_of

            return -self._atoms.get_stress() * volume_of(self._atoms)
        except NotImplementedError as reason:
            name = type(self._atoms.calc).__name__
            warn(f"{name} gives no stress ({reason}); virial and pressure are NaN")
            return np.full(6, np.nan)
