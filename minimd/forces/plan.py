"""The plan of a scene: which list of neighbors its pair laws share, and the terms that are then run."""

from collections.abc import Iterator, Sequence

import numpy as np

from minimd.forces.cluster_term import ClusterTerm
from minimd.forces.options import Options
from minimd.forces.pair_laws import PairLaws
from minimd.forces.pair_list_term import PairListTerm
from minimd.potentials.laws import Scaled
from minimd.potentials.pair_loop import FixedPairs
from minimd.potentials.term import PairLaw, Term
from minimd.structure.system import System


def plan(bound: Sequence[Term], system: System, options: Options, displacement: float) -> list[Term]:
    """The terms to run: those that add their forces themselves, and one list for all pair laws with the same bonded_scale.

    bound : the terms that the potentials were bound to.  displacement : of the fastest atom in a step [length], 0 if unknown.
    """
    terms = [term for term in bound if term.pair_law is None]
    sharing: dict[tuple, list[PairLaw]] = {}
    for term in bound:
        if term.pair_law is not None:
            sharing.setdefault(term.pair_law.bonded_scale, []).append(term.pair_law)
    for members in sharing.values():
        laws = PairLaws(system, members)
        with_list = ClusterTerm if laws.fit_clusters(system, options, displacement) else PairListTerm
        terms.append(with_list(system, laws, options, displacement))
        terms.extend(scaled_terms(system, laws))
    return terms


def scaled_terms(system: System, laws: PairLaws) -> Iterator[Term]:
    """Each law times its factors on the pairs one, two and three bonds apart, which the list leaves out."""
    for one in laws.members:
        for pairs, factor in laws.special:
            if factor != 0.0:
                species = system.species_index[pairs] if len(one.table) > 1 else np.zeros_like(pairs)
                rows = one.table[species[:, 0], species[:, 1]]
                rows = np.column_stack([rows[:, 0], np.full(len(rows), factor), rows[:, 1:]])  # the factor is the first parameter of Scaled
                yield FixedPairs(system, pairs, Scaled(one.law), rows)
