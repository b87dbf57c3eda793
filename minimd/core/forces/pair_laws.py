"""Pair laws that share a list of neighbors: largest cutoff, excluded pairs, skin, the choice of the list, its term."""

from collections.abc import Iterable, Sequence
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.kernels import kernel
from minimd.core.forces.embedding import EmbeddingPasses
from minimd.core.forces.options import Options
from minimd.core.neighbors.cluster_search import LAYERS
from minimd.core.neighbors.pair_list import PairList
from minimd.core.neighbors.verlet_list import LEAST_SKIN, VerletList, best_skin
from minimd.core.potentials.coulomb import with_charges
from minimd.core.potentials.law import evaluate_law, law_at, loop_for, nested, runs_on_vectors
from minimd.core.potentials.laws import LennardJonesLaw
from minimd.core.potentials.links import Lines
from minimd.core.potentials.pair_loop import parameters_of_pair, separation, source_for
from minimd.core.potentials.term import OwnTerm, PairLaw, Target
from minimd.core.structure.bond_graph import among, pairs_by_bonds_apart
from minimd.core.structure.system import System, local_density

CLUSTERS_FROM = 32  # atoms: with fewer, the pair list is as fast
WORK_OF_EMBEDDED = 3.0  # of a pair of embedded atoms: it is visited twice
ROUNDED_DOWN = 1.0 - 1e-9
SOUGHT_AT = np.geomspace(0.2, 1.0, 60).tolist()  # of the cutoff, for the deepest well


class PairLaws:
    """The pair laws of one system.

    members : the laws; that of charges is one with the first other law that reaches as far or less.
    cutoff : their largest cutoff [length].
    excluded : (P, 2) int, pairs on which a law has a factor other than 1: the list leaves out their nearest images.
    factors : (M, P) of the members on them.
    """

    def __init__(self, system: System, members: Sequence[PairLaw]) -> None:
        by_bonds = pairs_by_bonds_apart(system.bonds)
        exclusions = [law.exclusions for law in members]
        pairs = np.unique(np.sort(np.concatenate([*by_bonds, *exclusions])), axis=0)
        factors = np.ones((len(members), len(pairs)))

        for row, law in zip(factors, members, strict=True):
            for factor, bonded in zip(law.bonded_scale, by_bonds, strict=True):
                row[among(pairs, bonded)] = factor
            row[among(pairs, law.exclusions)] = 0.0

        is_special = (factors != 1.0).any(axis=0)
        for law in members if is_special.any() else ():
            if law.embedding is not None:
                raise ValueError(
                    f"{law.name} acts on all pairs of atoms; another potential leaves out or scales those of bonded "
                    "atoms, or exclusions, and both need one list: give the other one bonded_scale=(1, 1, 1) and no "
                    "exclusions"
                )
        self.excluded = pairs[is_special]
        self.factors = factors[:, is_special]
        self.members = merged(members)
        self.cutoff = max(law.cutoff for law in members)

    def skipped(self) -> list[str]:
        """See Term."""
        absent = []
        if all(len(law.table) == 1 for law in self.members):
            absent.append("parameter table")
        if len(self.excluded) == 0:
            absent.append("exclusions")
        return absent

    def fit_clusters(self, system: System, options: Options, displacement: float) -> bool:
        """Whether clusters are used: for CLUSTERS_FROM atoms or more, a finite cutoff, heights ≥ cutoff + skin,
        laws that run on vectors."""
        if len(system) < CLUSTERS_FROM or self.cutoff == np.inf:
            return False
        reach = self.cutoff + skin_for(system, self, options, displacement, LAYERS)
        is_high_enough = bool(np.all(system.cell.heights[system.cell.pbc] >= reach))
        return is_high_enough and all(
            runs_on_vectors(law.law, law.n_parameters) for law in self.members
        )


def merged(members: Sequence[PairLaw]) -> list[PairLaw]:
    """The laws, that of charges put together with another one: a pass over the pairs less."""
    charged = next((law for law in members if law.charges is not None), None)
    if charged is None:
        return [*members]

    for other in members:
        is_plain = other.charges is None and other.embedding is None
        if is_plain and other.cutoff <= charged.cutoff:
            rest = [law for law in members if law is not charged and law is not other]
            return [with_charges(other, charged), *rest]

    return [*members]


@kernel
def add_pulls(positions, pairs, law, parameters, arms, pulls):
    """arms = r_ij of P pairs, (P, 3); pulls (P, 3) += f r_ij, f = −u′(r)/r, of those within the cutoff of a law.

    positions, pairs, law, parameters : as in PairWork.
    """
    for i in range(pairs.start.size - 1):
        at = positions[i, 0], positions[i, 1], positions[i, 2]
        for p in range(pairs.start[i], pairs.start[i + 1]):
            x, y, z, r2 = separation(positions, pairs, at, p)
            arms[p] = x, y, z
            numbers = parameters_of_pair(parameters, i, pairs.second[p])
            if r2 < numbers[0]:
                _, f = evaluate_law(law, r2, numbers[1:])
                pulls[p, 0] += f * x
                pulls[p, 1] += f * y
                pulls[p, 2] += f * z


class ListTerm(OwnTerm):
    """Laws on all pairs within their cutoffs, found with one list."""

    list: VerletList

    def __init__(self, system: System, laws: PairLaws) -> None:
        self._pair_laws = laws
        self._passes = [
            law.embedding and EmbeddingPasses(law.law, law.embedding, system)
            for law in laws.members
        ]
        self.fits_grid = self.has_heat_flux = not any(self._passes)
        self.name = ", ".join(law.name for law in laws.members if law.embedding is not None)
        self.widest_skin = widest_skin(system, laws)

    def suits(self, system: System) -> bool:
        """Whether such a list is what the system needs in its present cell."""
        raise NotImplementedError(f"{type(self).__name__} has no suits")

    def follow(self, system: System) -> bool:
        """See Term."""
        self.widest_skin = widest_skin(system, self._pair_laws)
        if self.list.skin > self.widest_skin or not self.suits(system):
            return False
        self.list.follow(system.cell)
        return True

    def lines(self, system: System) -> Lines:
        """Of the listed pairs, each once, without embedded atoms."""
        laws = self._pair_laws
        pair_list = PairList(len(system), laws.cutoff, 0.0, laws.excluded)
        pair_list.update(system.positions, system.cell)
        pairs = pair_list.pairs
        order = pair_list.order
        positions = system.positions[order] + pair_list.offsets
        starts = np.repeat(positions, np.diff(pairs.start), axis=0)
        arms = np.zeros_like(starts)
        pulls = np.zeros_like(starts)
        for member in laws.members:
            source = source_for(member, system, order, arms)
            loop_for(add_pulls, member.law)(positions, pairs, member.law, source, arms, pulls)
        return starts, arms, pulls

    def collect(self, target: Target) -> None:
        """See Term."""
        for passes in filter(None, self._passes):
            passes.collect(target)

    def skipped(self) -> Iterable[str]:
        """See Term."""
        return self._pair_laws.skipped()


def deepest(law: PairLaw) -> float:
    """The depth of the deepest well of a law, for any pair of species, at some distances below the cutoff [energy]."""
    depth = -np.inf

    for cutoff2, *numbers in law.table.reshape(-1, law.table.shape[-1]).tolist():
        if cutoff2 == np.inf:
            continue
        for x in SOUGHT_AT:
            u = law_at(law.law, x * cutoff2**0.5, (*law.of_atoms, *numbers))[0]
            if isfinite(u):
                depth = max(depth, -u)

    return depth if isfinite(depth) else 0.0


def bare_species(law: PairLaw) -> NDArray[np.bool_]:
    """Which species have no law but that of charges, (S,): the other is Lennard-Jones, with ε = 0 for all of them."""
    beside = getattr(law.law, "law", ())
    is_known = any(isinstance(part, LennardJonesLaw) for part in nested(beside))
    if law.charges is None or not is_known or len(law.table) == 1:
        return np.zeros(len(law.table), dtype=bool)
    return np.asarray((law.table[..., -2] == 0.0).all(axis=1))


def skin_for(
    system: System, laws: PairLaws, options: Options, displacement: float, layers: int = 1
) -> float:
    """The skin that the user gave, or the best one, but not more than fits into the cell [length].

    displacement : of the fastest atom in a step [length], 0 if unknown.
    layers : of the list.
    """
    cutoff = laws.cutoff
    cell = system.cell
    widest = widest_skin(system, laws)
    skin = options.skin
    if skin is None:
        density = local_density(system.positions, cell, cutoff)
        is_embedded = any(law.embedding is not None for law in laws.members)
        work = WORK_OF_EMBEDDED if is_embedded else 1.0
        skin = best_skin(cutoff, density, displacement, len(system), layers, work)
        room = ROUNDED_DOWN * (cell.heights[cell.pbc].min(initial=np.inf) - cutoff)
        skin = min(skin, room) if room > LEAST_SKIN * cutoff else skin

    return min(skin, widest)


def widest_skin(system: System, laws: PairLaws) -> float:
    """The widest skin with which nearest images of laws.excluded cannot change while the list is in use [length];
    infinite without such pairs."""
    if len(laws.excluded) == 0:
        return np.inf
    return max(0.0, ROUNDED_DOWN * (float(np.sqrt(system.cell.safe_distance2)) - laws.cutoff))
