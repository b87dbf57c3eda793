"""The plan of a scene: which terms run, and which list each pair law gets."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from minimd.forces.cluster_term import ClusterTerm
from minimd.forces.options import Options
from minimd.forces.pair_laws import PairLaws
from minimd.forces.pair_list_term import PairListTerm
from minimd.potentials.laws import Scaled
from minimd.potentials.links import FixedPairs
from minimd.potentials.pair_loop import from_table
from minimd.potentials.term import Term
from minimd.structure.system import System


def plan(
    terms_bound: Sequence[Term], system: System, options: Options, displacement: float, skins: Sequence[float] = ()
) -> list[Term]:
    """The terms to run: those that add their forces themselves,
    and one term with a list for all pair laws of one bonded_scale.

    terms_bound : the terms that the potentials were bound to.  displacement : of the fastest atom in a step [length],
        0 if unknown.
    skins : of the lists [length], if they are known.
    """
    terms = [term for term in terms_bound if term.pair_law is None]
    pair_laws = [term.pair_law for term in terms_bound if term.pair_law is not None]
    for k, scale in enumerate(dict.fromkeys(one.bonded_scale for one in pair_laws)):
        known = replace(options, skin=skins[k]) if skins else options
        laws = PairLaws(system, [one for one in pair_laws if one.bonded_scale == scale])
        with_list = ClusterTerm if laws.fit_clusters(system, known, displacement) else PairListTerm
        terms.append(with_list(system, laws, known, displacement))
        terms.extend(scaled_terms(system, laws))
    return terms


def scaled_terms(system: System, laws: PairLaws) -> Iterator[Term]:
    """Terms for the pairs one, two and three bonds apart, which the list leaves out: each law times its factor."""
    for one in laws.members:
        for pairs, factor in laws.special:
            if factor != 0.0:
                species = system.species_index[pairs] if len(one.table) > 1 else np.zeros_like(pairs)
                rows = one.table[species[:, 0], species[:, 1]]
                factors = np.full(len(rows), factor)  # the first parameter of Scaled
                rows = np.column_stack([rows[:, 0], factors, rows[:, 1:]])
                yield FixedPairs(pairs, Scaled(one.law), from_table(rows))
