"""The terms of a scene: each kind of force, planned for one system, adding itself to the sum."""

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from minimd.cell import minimum_image_translations
from minimd.compiling import kernel
from minimd.neighbors.cluster_list import ClusterList
from minimd.neighbors.pair_list import PairList
from minimd.potentials.bonded import BondPotential, HarmonicAngle, Triples, add_angle_forces
from minimd.potentials.cluster_loop import ByLane, cluster_loop_for, runs_on_vectors
from minimd.potentials.laws import Scaled
from minimd.potentials.pair import PairPotential
from minimd.potentials.pair_loop import FORCES, PER_ATOM, fixed_pairs, pair_loop_for
from minimd.potentials.parameters import ByPair, BySpecies, SameForAll, from_table
from minimd.system import System, checked_pairs
from minimd.topology import pairs_by_bonds_apart

ALL_PAIRS_UP_TO = 100  # atoms: below, an open scene is faster without a list that has to be rebuilt
CLUSTERS_FROM = 64  # atoms: below, the pair list is as fast
SKIN = 0.12  # default skin in units of the cutoff

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
        """See Term."""
        cell = system.cell
        if cell.is_periodic:
            lattice = (cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2)
            minimum_image_translations(system.positions, self._first, self._second, *lattice, self._pairs.translations)
        self._loop(system.positions, self._pairs, self._law, self._parameters, detail, forces, energies, virials)

    def skipped(self) -> Iterable[str]:
        """See Term."""
        return ()


class ListedPairs:
    """Laws on all pairs within their cutoffs, found with one pair list."""

    def __init__(self, system: System, laws: "PairLaws", skin: float | None) -> None:
        cutoff = laws.cutoff
        if not system.cell.is_periodic and len(system) <= ALL_PAIRS_UP_TO:
            cutoff = np.inf
        self.list = PairList(len(system), cutoff, _skin(system, cutoff, skin, bool(len(laws.excluded))), laws.excluded)
        self._laws, self._loops = laws, [pair_loop_for(law) for law in laws.laws]
        self._parameters: list[tuple] = []
        n = len(system)
        self._local = (np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty((n, 6)))

    @property
    def _in_users_order(self) -> bool:
        return self.list.cutoff == np.inf

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        """See Term."""
        if self.list.update(system.positions, system.cell):
            species = system.species_index[self.list.order]
            self._parameters = [_by_species(table, species) for table in self._laws.tables]
        if self._in_users_order:
            self._run_loops(system.positions, detail, forces, energies, virials)
            return
        positions, local_forces, local_energies, local_virials = self._local
        gather(system.positions, self.list.order, self.list.offsets, positions, local_forces)
        if detail != FORCES:
            local_energies[:], local_virials[:] = 0.0, 0.0
        self._run_loops(positions, detail, local_forces, local_energies, local_virials)
        scatter(local_forces, self.list.order, forces)
        if detail != FORCES:
            energies[self.list.order] += local_energies
            virials[self.list.order] += local_virials

    def _run_loops(self, positions: NDArray, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        for law, loop, parameters in zip(self._laws.laws, self._loops, self._parameters, strict=True):
            loop(positions, self.list.pairs, law, parameters, detail, forces, energies, virials)

    def skipped(self) -> Iterable[str]:
        """See Term."""
        if self._in_users_order:
            yield "neighbor list (all pairs)"
        yield from self._laws.skipped()


class ClusteredPairs:
    """Laws on all pairs within their cutoffs, eight at a time, found with one cluster list.

    Shares of single atoms are asked for rarely; they come from a pair list that is made when they are.
    """

    def __init__(self, system: System, laws: "PairLaws", skin: float | None) -> None:
        self.list = ClusterList(len(system), laws.cutoff, _skin(system, laws.cutoff, skin, bool(len(laws.excluded))), laws.excluded)
        self._laws, self._loops = laws, [cluster_loop_for(law) for law in laws.laws]
        self._parameters: list[tuple] = []
        self._plain: ListedPairs | None = None
        self._skin = skin

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        """See Term."""
        if detail == PER_ATOM:
            self._plain = self._plain or ListedPairs(system, self._laws, self._skin)
            self._plain.add(system, detail, forces, energies, virials)
            return
        clusters, look = self.list, detail != FORCES
        if clusters.update(system.positions, system.cell):
            self._parameters = [_by_lane(table, system.species_index, clusters) for table in self._laws.tables]
        clusters.gather(system.positions)
        n_slots = len(clusters.atom)
        row_energies, row_virials = np.zeros(n_slots if look else 0), np.zeros((n_slots if look else 0, 6))
        memory = (clusters.on_clusters, clusters.on_atoms, row_energies, row_virials)
        for law, loop, parameters in zip(self._laws.laws, self._loops, self._parameters, strict=True):
            loop(0, n_slots, clusters.rows, clusters.coordinates, law, parameters, look, *memory)
        clusters.scatter(forces)
        if look:
            real = clusters.atom >= 0
            energies[clusters.atom[real]] += row_energies[real]
            virials[clusters.atom[real]] += row_virials[real]

    def skipped(self) -> Iterable[str]:
        """See Term."""
        return self._laws.skipped()


class PairLaws:
    """What pair potentials with one bonded_scale say about a system: laws, parameter tables, the largest cutoff, excluded pairs.

    Attributes
    ----------
    laws, tables : markers, and (S, S, 1 + P) arrays; one for each potential.  cutoff : the largest [length].
    special : pairs (P, 2) that are scaled, with their factors.  excluded : (P, 2) all of them: no list may hold their nearest image.
    """

    def __init__(self, system: System, potentials: Sequence[PairPotential]) -> None:
        _check_cutoffs(system, potentials)
        by_bonds, scale = pairs_by_bonds_apart(system.bonds, len(system)), potentials[0].bonded_scale
        self.special = [(pairs, factor) for pairs, factor in zip(by_bonds, scale, strict=True) if factor != 1.0 and len(pairs)]
        self.excluded = np.concatenate([np.zeros((0, 2), dtype=np.int64), *(pairs for pairs, _ in self.special)])
        self.potentials = potentials
        self.laws = [potential.law for potential in potentials]
        self.tables = [potential.table(system.species_names) for potential in potentials]
        self.cutoff = max(potential.cutoff for potential in potentials)

    def skipped(self) -> Iterable[str]:
        """See Term."""
        if all(len(table) == 1 for table in self.tables):
            yield "parameter table"
        if not len(self.excluded):
            yield "exclusions"

    def scaled(self, system: System) -> "list[Term]":
        """The laws times their factors on pairs a few bonds apart."""
        return [
            _scaled_pairs(system, potential, table, pairs, factor)
            for potential, table in zip(self.potentials, self.tables, strict=True)
            for pairs, factor in self.special
            if factor != 0.0
        ]

    def fit_clusters(self, system: System, skin: float | None) -> bool:
        """The rule which list a scene gets: clusters from a few hundred atoms on, in cells at least as high as the list reaches."""
        if len(system) < CLUSTERS_FROM or self.cutoff == np.inf:
            return False
        reach = self.cutoff + _skin(system, self.cutoff, skin, bool(len(self.excluded)))
        high_enough = bool(np.all(system.cell.heights[system.cell.pbc] >= reach))
        return high_enough and all(runs_on_vectors(law, table.shape[-1] - 1) for law, table in zip(self.laws, self.tables, strict=True))


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
        """See Term."""
        cell, arms = system.cell, self._triples
        if cell.is_periodic:
            lattice = (cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2)
            minimum_image_translations(system.positions, arms.middle, arms.first, *lattice, arms.first_translations)
            minimum_image_translations(system.positions, arms.middle, arms.last, *lattice, arms.last_translations)
        add_angle_forces(system.positions, arms, self._k, self._angle, detail, forces, energies, virials)

    def skipped(self) -> Iterable[str]:
        """See Term."""
        return ()


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


def plan(system: System, potentials: Sequence[Potential], skin: float | None) -> list[Term]:
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
    for group in sharing.values():
        laws = PairLaws(system, group)
        list_kind = ClusteredPairs if laws.fit_clusters(system, skin) else ListedPairs
        terms.extend([list_kind(system, laws, skin), *laws.scaled(system)])
    return terms


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


def _by_lane(table: NDArray[np.float64], species_index: NDArray[np.int64], clusters: ClusterList) -> SameForAll | ByLane:
    if len(table) == 1:
        return SameForAll(tuple(table[0, 0].tolist()))
    species = clusters.by_slot(species_index)
    columns = tuple(np.ascontiguousarray(table[:, species, k]).ravel() for k in range(table.shape[-1]))
    return ByLane(columns, species, len(species))


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
