"""The terms of a scene: each kind of force, planned for one system, adding itself to the sum."""

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.kernels import kernel
from minimd.forces.cluster_term import ClusteredPairs
from minimd.forces.options import Options
from minimd.forces.pair_laws import PairLaws, skin_for
from minimd.neighbors.pair_list import PairList
from minimd.potentials.bonded import BondPotential, HarmonicAngle, Triples, add_angle_forces
from minimd.potentials.laws import Scaled
from minimd.potentials.pair import PairPotential
from minimd.potentials.pair_loop import FORCES, fixed_pairs, pair_loop_for
from minimd.potentials.parameters import ByPair, BySpecies, SameForAll, from_table
from minimd.structure.bond_graph import checked_groups, checked_pairs
from minimd.structure.cell import minimum_image_translations
from minimd.structure.system import System, number_density

ALL_PAIRS_UP_TO = 100  # atoms: below, an open scene is faster without a list that has to be rebuilt
MOST_PAIRS = 2**30  # 8 bytes each
MOST_IMAGES = 2**22  # 72 bytes each

Potential = Any  # PairPotential, BondPotential, HarmonicAngle, or an object with bind(system) that returns a Term


class Term(Protocol):
    """One ingredient of a scene."""

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        """Add forces (N, 3), and if detail asks for them energies (N,) and virials (N, 6); see pair_loop."""

    def skipped(self) -> Iterable[str]:
        """What this scene does not pay for, in words."""


class FixedPairs:
    """A law on pairs that never change, each taken at its nearest image; planned anew when the cell changes."""

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

    def __init__(self, system: System, laws: PairLaws, options: Options, stride: float = 0.0) -> None:
        cutoff = laws.cutoff
        if not system.cell.is_periodic and len(system) <= ALL_PAIRS_UP_TO:
            cutoff = np.inf
        skin = skin_for(system, laws, options, stride) if cutoff < np.inf else 0.0
        _check_size(system, cutoff, skin)
        self.list = PairList(len(system), cutoff, skin, laws.excluded)
        self._laws, self._loops = laws, [pair_loop_for(law) for law in laws.laws]
        self._parameters: list[tuple] = []
        self._parameters_of = 0  # which build of the list
        n = len(system)
        self._local = (np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty((n, 6)))

    @property
    def summary(self) -> str:
        """The list, for the report."""
        return "all pairs" if self._in_users_order else f"pair list (skin {self.list.skin:.3g})"

    @property
    def _in_users_order(self) -> bool:
        return self.list.cutoff == np.inf

    def add(self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray) -> None:
        """See Term."""
        self.list.update(system.positions, system.cell)
        if self._parameters_of != self.list.n_builds:
            species = system.species_index[self.list.order]
            self._parameters = [_by_species(table, species) for table in self._laws.tables]
            self._parameters_of = self.list.n_builds
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


class Angles:
    """Harmonic angles, each arm taken at its nearest image."""

    def __init__(self, system: System, potential: HarmonicAngle) -> None:
        triples = checked_groups("triples", potential.triples, 3, len(system))
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


def plan(system: System, potentials: Sequence[Potential], options: Options, stride: float) -> list[Term]:
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
        list_kind = ClusteredPairs if laws.fit_clusters(system, options, stride) else ListedPairs
        terms.append(list_kind(system, laws, options, stride))
        terms.extend(_scaled_terms(system, laws))
    return terms


def _by_species(table: NDArray[np.float64], species: NDArray[np.int64]) -> SameForAll | BySpecies:
    if len(table) == 1:
        return SameForAll(tuple(table[0, 0].tolist()))
    return BySpecies(from_table(table), species)


def _scaled_terms(system: System, laws: PairLaws) -> list[Term]:
    """The laws times their factors on pairs a few bonds apart."""
    return [
        _scaled_pairs(system, potential, table, pairs, factor)
        for potential, table in zip(laws.potentials, laws.tables, strict=True)
        for pairs, factor in laws.special
        if factor != 0.0
    ]


def _scaled_pairs(system: System, potential: PairPotential, table: NDArray, pairs: NDArray, factor: float) -> FixedPairs:
    """The law times a factor on pairs one, two or three bonds apart: columns (cutoff², factor, rest)."""
    species = system.species_index[pairs] if potential.depends_on_species else np.zeros_like(pairs)
    rows = table[species[:, 0], species[:, 1]]
    rows = np.column_stack([rows[:, 0], np.full(len(rows), factor), rows[:, 1:]])
    return FixedPairs(system, pairs, Scaled(potential.law), rows)


def _check_size(system: System, cutoff: float, skin: float) -> None:
    """Raise ValueError for more pairs or images than a list can hold: those of a huge reach in a small cell, or of a huge scene without cutoff."""
    n_atoms, reach, cell = len(system), cutoff + skin, system.cell
    n_pairs = 0.5 * n_atoms**2
    if reach < np.inf:
        among_all = 0.5 * n_atoms * number_density(system, reach) * 4.0 / 3.0 * np.pi * reach**3
        n_pairs = among_all if cell.is_periodic else min(n_pairs, among_all)
    n_images = np.prod(2.0 * np.ceil(reach / cell.heights[cell.pbc]) + 1.0)
    for name, number, most in (("pairs", n_pairs, MOST_PAIRS), ("images of the cell", n_images, MOST_IMAGES)):
        if number > most:
            hint = f"reduce the cutoff ({cutoff:g})" if skin < cutoff else f"reduce the skin ({skin:g})"
            raise ValueError(f"pair lists hold up to {most:.1e} {name}, this scene needs about {number:.1e}: {hint}")
