"""Forces: plans what a scene needs, once, and sums it, each step."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from minimd.cell import minimum_image_translations
from minimd.compiling import announce_compilation, kernel
from minimd.errors import NonFiniteError
from minimd.neighbors.closest import closest_pair
from minimd.neighbors.pair_list import PairList
from minimd.potentials.bonded import BondPotential, HarmonicAngle, Triples, add_angle_forces
from minimd.potentials.laws import Scaled
from minimd.potentials.pair import PairPotential
from minimd.potentials.pair_loop import FORCES, PER_ATOM, TOTALS, fixed_pairs, pair_loop_for
from minimd.potentials.parameters import ByPair, BySpecies, SameForAll, from_table
from minimd.system import System, checked_pairs
from minimd.topology import pairs_by_bonds_apart

ALL_PAIRS_UP_TO = 100  # atoms: below, an open scene is faster without a list that has to be rebuilt
SKIN = 0.14  # default skin in units of the cutoff
VOIGT = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # places of xx yy zz yz xz xy in a (3, 3) tensor

Potential = Any  # PairPotential, BondPotential, HarmonicAngle, or an object with bind(system) that returns a Term


class Term(Protocol):
    """One ingredient of a scene."""

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        """Add forces (N, 3), and if detail asks for them energies (N,) and virials (N, 6); see pair_loop."""

    def skipped(self) -> Iterable[str]:
        """What this scene does not pay for, in words."""


class FixedPairs:
    """A law on pairs that never change, each taken at its nearest image."""

    def __init__(self, system: System, pairs: NDArray[np.int64], law: tuple, table: NDArray[np.float64]) -> None:
        self._pairs, order = fixed_pairs(pairs, len(system), system.cell.is_periodic)
        self._first, self._second = pairs[order, 0], pairs[order, 1]
        self._law, self._loop = law, pair_loop_for(law)
        self._parameters = ByPair(from_table(table[order]))

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        cell = system.cell
        if cell.is_periodic:
            lattice = (cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2)
            minimum_image_translations(system.positions, self._first, self._second, *lattice, self._pairs.translations)
        self._loop(system.positions, self._pairs, self._law, self._parameters, detail, forces, energies, virials)

    def skipped(self) -> Iterable[str]:
        return ()


class ListedPairs:
    """Laws on all pairs within their cutoffs, found with one pair list."""

    def __init__(self, system: System, potentials: Sequence[PairPotential], skin: float | None) -> None:
        _check_cutoffs(system, potentials)
        by_bonds = pairs_by_bonds_apart(system.bonds, len(system))
        scale = potentials[0].bonded_scale
        special = [(pairs, factor) for pairs, factor in zip(by_bonds, scale, strict=True) if factor != 1.0 and len(pairs)]
        excluded = np.concatenate([pairs for pairs, _ in special]) if special else np.zeros((0, 2), dtype=np.int64)
        cutoff = max(potential.cutoff for potential in potentials)
        if not system.cell.is_periodic and len(system) <= ALL_PAIRS_UP_TO:
            cutoff = np.inf
        self.list = PairList(len(system), cutoff, _skin(system, cutoff, skin, bool(special)), excluded)
        self._laws = [(potential.law, pair_loop_for(potential.law)) for potential in potentials]
        self._tables = [potential.table(system.species_names) for potential in potentials]
        self._scaled = [
            _scaled_pairs(system, potential, table, pairs, factor)
            for potential, table in zip(potentials, self._tables, strict=True)
            for pairs, factor in special
            if factor != 0.0
        ]
        self._parameters: list[tuple] = []
        n = len(system)
        self._local = (np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty((n, 6)))

    @property
    def _in_users_order(self) -> bool:
        return self.list.cutoff == np.inf

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        if self.list.update(system.positions, system.cell):
            species = system.species_index[self.list.order]
            self._parameters = [_by_species(table, species) for table in self._tables]
        if self._in_users_order:
            self._run_loops(system.positions, detail, forces, energies, virials)
        else:
            positions, local_forces, local_energies, local_virials = self._local
            gather(system.positions, self.list.order, self.list.offsets, positions, local_forces)
            if detail != FORCES:
                local_energies[:], local_virials[:] = 0.0, 0.0
            self._run_loops(positions, detail, local_forces, local_energies, local_virials)
            scatter(local_forces, self.list.order, forces)
            if detail != FORCES:
                energies[self.list.order] += local_energies
                virials[self.list.order] += local_virials
        for scaled in self._scaled:
            scaled.add(system, detail, forces, energies, virials)

    def _run_loops(self, positions: NDArray, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        for (law, loop), parameters in zip(self._laws, self._parameters, strict=True):
            loop(positions, self.list.pairs, law, parameters, detail, forces, energies, virials)

    def skipped(self) -> Iterable[str]:
        if self._in_users_order:
            yield "neighbour list (all pairs)"
        if all(isinstance(parameters, SameForAll) for parameters in self._parameters):
            yield "parameter table"
        if not self.list.has_excluded:
            yield "exclusions"


class Angles:
    """Harmonic angles, each arm taken at its nearest image."""

    def __init__(self, system: System, potential: HarmonicAngle) -> None:
        triples = potential.triples
        for pair in (triples[:, [0, 1]], triples[:, [1, 2]], triples[:, [0, 2]]):
            _check_atoms("triples", triples, pair, len(system))
        first, middle, last = (np.ascontiguousarray(triples[:, k]) for k in range(3))
        self._triples = Triples(first, middle, last, np.zeros((len(triples), 3)), np.zeros((len(triples), 3)))
        self._k, self._angle = potential.k, potential.angle

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        cell, arms = system.cell, self._triples
        if cell.is_periodic:
            lattice = (cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2)
            minimum_image_translations(system.positions, arms.middle, arms.first, *lattice, arms.first_translations)
            minimum_image_translations(system.positions, arms.middle, arms.last, *lattice, arms.last_translations)
        add_angle_forces(system.positions, arms, self._k, self._angle, detail, forces, energies, virials)

    def skipped(self) -> Iterable[str]:
        return ()


class Forces:
    """All forces on the atoms of one system.

    Parameters
    ----------
    system : the System whose positions and cell each call reads.
    potentials : one potential or several.
    skin : of the pair lists [length]; 0.14 of the cutoff if not given.

    Attributes
    ----------
    forces : (N, 3) [energy/length], of the last compute.  n_evaluations : number of calls of compute.

    Raises
    ------
    TypeError, ValueError : for something that is no potential, a species without parameters, a periodic scene without a
        cutoff, bonded terms that name missing atoms.
    """

    def __init__(self, system: System, potentials: Potential | Sequence[Potential], skin: float | None = None) -> None:
        self.system = system
        self.potentials = tuple(potentials) if isinstance(potentials, Sequence) else (potentials,)
        if skin is not None and not (np.isfinite(skin) and skin >= 0.0):
            raise ValueError(f"skin must be finite and not negative; skin = {skin}")
        self.terms = _planned(system, self.potentials, skin)
        self.forces = np.zeros_like(system.positions)
        self.n_evaluations = 0
        self._energies = np.zeros(len(system))
        self._virials = np.zeros((len(system), 6))
        self._detail = FORCES
        self._tail = (None, 0.0, 0.0)

    def compute(self, detail: int = FORCES) -> NDArray[np.float64]:
        """Evaluate the forces at system.positions and return them; TOTALS and PER_ATOM also evaluate energy and virial."""
        self.forces[:] = 0.0
        if detail != FORCES:
            self._energies[:], self._virials[:] = 0.0, 0.0
        if self.n_evaluations == 0:
            with announce_compilation():
                self._sum(detail)
        else:
            self._sum(detail)
        self.n_evaluations += 1
        self._detail = detail
        return self.forces

    def _sum(self, detail: int) -> None:
        for term in self.terms:
            term.add(self.system, detail, self.forces, self._energies, self._virials)

    @property
    def has_energy(self) -> bool:
        """True if the last compute was asked for energy and virial."""
        return self._detail != FORCES

    @property
    def potential_energy(self) -> float:
        """U [energy] of the last compute with TOTALS or PER_ATOM, tail corrections included."""
        return float(self._energies.sum()) + self._tail_corrections()[0]

    @property
    def virial(self) -> NDArray[np.float64]:
        """W = Σ f r_ij ⊗ r_ij [energy], (3, 3), of the last compute with TOTALS or PER_ATOM, tail corrections included."""
        return self._virials.sum(axis=0)[VOIGT] + np.eye(3) * self._tail_corrections()[1] / 3.0

    @property
    def energies(self) -> NDArray[np.float64]:
        """Each atom's share of U [energy], (N,), of the last compute with PER_ATOM; the tail in equal shares."""
        return self._energies + self._tail_corrections()[0] / len(self.system)

    @property
    def virials(self) -> NDArray[np.float64]:
        """Each atom's share of W [energy], (N, 6) as xx yy zz yz xz xy, of the last compute with PER_ATOM."""
        tail = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * self._tail_corrections()[1] / 3.0
        return self._virials + tail / len(self.system)

    @property
    def longest_stride(self) -> float:
        """The largest finite cutoff [length]: an atom that moves farther in one step has passed its neighbours unseen."""
        cutoffs = [p.cutoff for p in self.potentials if isinstance(p, PairPotential) and np.isfinite(p.cutoff)]
        return max(cutoffs, default=np.inf)

    @property
    def n_builds(self) -> int:
        """How often a pair list was built."""
        return sum(term.list.n_builds for term in self.terms if isinstance(term, ListedPairs))

    def skipped(self) -> list[str]:
        """What this scene lacks and therefore does not pay for, in words."""
        absent = [] if self.system.cell.is_periodic else ["periodic images"]
        if not any(isinstance(term, FixedPairs) for term in self.terms):
            absent.append("bond loop")
        return absent + [word for term in self.terms for word in term.skipped()]

    def _tail_corrections(self) -> tuple[float, float]:
        """Energy and virial trace of all tails, computed anew only when the volume has changed."""
        corrected = [p for p in self.potentials if isinstance(p, PairPotential) and p.tail_correction]
        if not corrected:
            return 0.0, 0.0
        volume = self.system.volume
        if volume is None:
            raise ValueError("tail_correction needs a density: a cell that is periodic in all three directions")
        if self._tail[0] != volume:
            counts = np.bincount(self.system.species_index, minlength=len(self.system.species_names))
            tails = [potential.tail(counts, self.system.species_names, volume) for potential in corrected]
            self._tail = (volume, sum(u for u, _ in tails), sum(w for _, w in tails))
        return self._tail[1], self._tail[2]


@dataclass(frozen=True)
class Evaluation:
    """potential_energy : U [energy].  forces : (N, 3) [energy/length].  virial : (3, 3) W = Σ f r_ij ⊗ r_ij [energy].

    energies : (N,) each atom's share of U [energy].
    """

    potential_energy: float
    forces: NDArray[np.float64]
    virial: NDArray[np.float64]
    energies: NDArray[np.float64]


def evaluate(system: System, potentials: Potential | Sequence[Potential]) -> Evaluation:
    """Potential energy, forces, virial and energies per atom of a system as it stands.

    Raises
    ------
    NonFiniteError : if a force or an energy is not finite, as for two atoms on one spot; it names the closest pair.
    ValueError, TypeError : as Forces.
    """
    forces = Forces(system, potentials, skin=0.0)
    forces.compute(PER_ATOM)
    result = Evaluation(forces.potential_energy, forces.forces, forces.virial, forces.energies)
    if not (np.isfinite(result.forces).all() and np.isfinite(result.energies).all()):
        raise NonFiniteError(f"forces or energies are not finite; the closest pair is {closest_pair(system)}: move them apart")
    return result


@kernel
def gather(positions, order, offsets, local_positions, local_forces):
    """local_positions = positions[order] + offsets, local_forces = 0: the copy that the pair loop works on. All (N, 3)."""
    for k in range(order.size):
        for c in range(3):
            local_positions[k, c] = positions[order[k], c] + offsets[k, c]
            local_forces[k, c] = 0.0


@kernel
def scatter(local_forces, order, forces):
    """forces[order] += local_forces, both (N, 3) [energy/length]."""
    for k in range(order.size):
        for c in range(3):
            forces[order[k], c] += local_forces[k, c]


def _planned(system: System, potentials: Sequence[Potential], skin: float | None) -> list[Term]:
    """The terms of a scene: one pair list for all pair potentials with the same bonded_scale, and each bonded term."""
    sharing: dict[tuple, list[PairPotential]] = {}
    terms: list[Term] = []
    for potential in potentials:
        if isinstance(potential, PairPotential):
            sharing.setdefault(potential.bonded_scale, []).append(potential)
        elif isinstance(potential, BondPotential):
            pairs = system.bonds if potential.pairs is None else checked_pairs("pairs", potential.pairs, len(system))
            table = potential.table(len(pairs))
            if len(pairs):
                terms.append(FixedPairs(system, pairs, potential.law, table))
        elif isinstance(potential, HarmonicAngle):
            terms.append(Angles(system, potential))
        elif hasattr(potential, "bind"):
            terms.append(potential.bind(system))
        else:
            raise TypeError(f"potentials must be potentials of minimd, such as LennardJones or HarmonicBond; got {potential!r}")
    return [ListedPairs(system, group, skin) for group in sharing.values()] + terms


def _check_cutoffs(system: System, potentials: Sequence[PairPotential]) -> None:
    for potential in potentials:
        if potential.cutoff == np.inf and system.cell.is_periodic:
            raise ValueError(f"cutoff must be given in a periodic cell; that of {type(potential).__name__} is None")
        if potential.tail_correction and system.volume is None:
            raise ValueError("tail_correction needs a density: a cell that is periodic in all three directions")


def _skin(system: System, cutoff: float, skin: float | None, special: bool) -> float:
    """The given or default skin; none where the nearest image of a scaled pair can change while the list is in use."""
    if cutoff == np.inf:
        return 0.0
    skin = SKIN * cutoff if skin is None else skin
    return 0.0 if special and (cutoff + skin) ** 2 > system.cell.safe_distance2 else skin


def _by_species(table: NDArray[np.float64], species: NDArray[np.int64]) -> SameForAll | BySpecies:
    if len(table) == 1:
        return SameForAll(tuple(table[0, 0].tolist()))
    return BySpecies(from_table(table), species)


def _scaled_pairs(system: System, potential: PairPotential, table: NDArray, pairs: NDArray, factor: float) -> FixedPairs:
    """The law times a factor on pairs one, two or three bonds apart: columns (cutoff², factor, rest)."""
    species = system.species_index[pairs] if potential.depends_on_species else np.zeros_like(pairs)
    rows = table[species[:, 0], species[:, 1]]
    rows = np.column_stack([rows[:, 0], np.full(len(rows), factor), rows[:, 1:]])
    return FixedPairs(system, pairs, Scaled(potential.law), rows)


def _check_atoms(name: str, groups: NDArray[np.int64], pair: NDArray[np.int64], n_atoms: int) -> None:
    wrong = np.flatnonzero(((pair < 0) | (pair >= n_atoms)).any(axis=1) | (pair[:, 0] == pair[:, 1]))
    if wrong.size:
        raise ValueError(f"{name} must name different atoms from 0 to {n_atoms - 1}; {name}[{wrong[0]}] = {groups[wrong[0]].tolist()}")
