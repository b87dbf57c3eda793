"""Pair laws that share a list of neighbors: largest cutoff, excluded pairs, skin, the choice of the list, its term."""

from collections.abc import Iterable, Sequence
from math import isfinite

import numpy as np

from minimd.core.forces.options import Options
from minimd.core.neighbors.cluster_search import LAYERS
from minimd.core.neighbors.verlet_list import LEAST_SKIN, VerletList, best_skin
from minimd.core.potentials.coulomb import with_charges
from minimd.core.potentials.law import law_at, runs_on_vectors
from minimd.core.potentials.term import OwnTerm, PairLaw
from minimd.core.structure.bond_graph import among, pairs_by_bonds_apart
from minimd.core.structure.system import System, local_density

CLUSTERS_FROM = 32  # atoms: with fewer, the pair list is as fast
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
        pairs = np.unique(
            np.sort(np.concatenate([*by_bonds, *(one.exclusions for one in members)])), axis=0
        )
        factors = np.ones((len(members), len(pairs)))
        for of_law, one in zip(factors, members, strict=True):
            for factor, some in zip(
                (*one.bonded_scale, 0.0), (*by_bonds, one.exclusions), strict=True
            ):
                of_law[among(pairs, some)] = factor
        is_special = (factors != 1.0).any(axis=0)
        self.excluded = pairs[is_special]
        self.factors = factors[:, is_special]
        self.members = merged(members)
        self.cutoff = max(one.cutoff for one in members)

    def skipped(self) -> list[str]:
        """See Term."""
        is_alike = all(len(one.table) == 1 for one in self.members)
        return (["parameter table"] if is_alike else []) + (
            [] if len(self.excluded) else ["exclusions"]
        )

    def fit_clusters(self, system: System, options: Options, displacement: float) -> bool:
        """Whether clusters are used: for CLUSTERS_FROM atoms or more, a finite cutoff, heights ≥ cutoff + skin,
        laws that run on vectors."""
        if len(system) < CLUSTERS_FROM or self.cutoff == np.inf:
            return False
        reach = self.cutoff + skin_for(system, self, options, displacement, LAYERS)
        high_enough = bool(np.all(system.cell.heights[system.cell.pbc] >= reach))
        return high_enough and all(
            runs_on_vectors(one.law, one.n_parameters) for one in self.members
        )


def merged(members: Sequence[PairLaw]) -> list[PairLaw]:
    """The laws, that of charges put together with another one: a pass over the pairs less."""
    charged = next((one for one in members if one.charges is not None), None)
    other = next(
        (
            one
            for one in members
            if one.charges is None and charged and one.cutoff <= charged.cutoff
        ),
        None,
    )
    if charged is None or other is None:
        return [*members]
    return [
        with_charges(other, charged),
        *(one for one in members if one is not charged and one is not other),
    ]


class ListTerm(OwnTerm):
    """Laws on all pairs within their cutoffs, found with one list."""

    list: VerletList
    fits_grid = True

    def __init__(self, system: System, laws: PairLaws) -> None:
        self._pair_laws, self.widest_skin = laws, widest_skin(system, laws)

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

    def skipped(self) -> Iterable[str]:
        """See Term."""
        return self._pair_laws.skipped()


def deepest(one: PairLaw) -> float:
    """The depth of the deepest well of a law, for any pair of species, at some distances below the cutoff [energy]."""
    product = () if one.charges is None else (-(float(np.abs(one.charges).max()) ** 2),)
    rows = [row for row in one.table.reshape(-1, one.table.shape[-1]).tolist() if row[0] < np.inf]
    sought = (
        (x * cutoff2**0.5, (*product, *numbers)) for cutoff2, *numbers in rows for x in SOUGHT_AT
    )
    energies = [law_at(one.law, r, numbers)[0] for r, numbers in sought]
    return max((-u for u in energies if isfinite(u)), default=0.0)


def skin_for(
    system: System, laws: PairLaws, options: Options, displacement: float, layers: int = 1
) -> float:
    """The skin that the user gave, or the best one, but not more than fits into the cell [length].

    displacement : of the fastest atom in a step [length], 0 if unknown.  layers : of the list.
    """
    cutoff = laws.cutoff
    cell = system.cell
    widest = widest_skin(system, laws)
    skin = options.skin
    if skin is None:
        density = local_density(system.positions, cell, cutoff)
        skin = best_skin(cutoff, density, displacement, len(system), layers)
        room = ROUNDED_DOWN * (cell.heights[cell.pbc].min(initial=np.inf) - cutoff)
        skin = min(skin, room) if room > LEAST_SKIN * cutoff else skin
    return min(skin, widest)


def widest_skin(system: System, laws: PairLaws) -> float:
    """The widest skin with which nearest images of laws.excluded cannot change while the list is in use [length];
    infinite without such pairs."""
    if len(laws.excluded) == 0:
        return np.inf
    return max(0.0, ROUNDED_DOWN * (float(np.sqrt(system.cell.safe_distance2)) - laws.cutoff))
