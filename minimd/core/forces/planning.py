"""Which terms of a scene run: pair laws share one list, and what that leaves out has terms of its own."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from minimd.core.forces.cluster_term import ClusterTerm
from minimd.core.forces.mesh_sum import charge_sum
from minimd.core.forces.options import FIXED_POINT, Options
from minimd.core.forces.pair_laws import PairLaws
from minimd.core.forces.pair_list_term import PairListTerm
from minimd.core.forces.slab_term import OpenSlabTerm, SlabTerm
from minimd.core.potentials.coulomb import SpecialLaw
from minimd.core.potentials.laws import Scaled
from minimd.core.potentials.links import FixedPairs
from minimd.core.potentials.pair_loop import from_table
from minimd.core.potentials.term import PairLaw, Term
from minimd.core.structure.system import System


def plan(
    terms_bound: Sequence[Term],
    system: System,
    options: Options,
    displacement: float,
    skins: Sequence[float] = (),
) -> list[Term]:
    """The terms to run: those that add their forces themselves, one with a list for all pair laws, others for what
    the list leaves out, and for sums over waves.

    terms_bound : the terms that the potentials were bound to.
    displacement : of the fastest atom in a step [length], 0 if unknown.
    skins : of the lists [length], if they are known.
    """
    terms = [term for term in terms_bound if term.pair_law is None]
    pair_laws = [term.pair_law for term in terms_bound if term.pair_law is not None]
    if pair_laws:
        known = replace(options, skin=skins[0]) if skins else options
        laws = PairLaws(system, pair_laws)
        with_list = ClusterTerm if laws.fit_clusters(system, known, displacement) else PairListTerm
        terms.append(with_list(system, laws, known, displacement))
        terms.extend(special_terms(system, pair_laws, laws))

    is_fixed = options.precision == FIXED_POINT

    for law in pair_laws:
        if law.split is None or law.charges is None:
            continue
        how = law.split, law.method, is_fixed
        if not system.cell.pbc.all():
            terms.append(OpenSlabTerm(system, law.charges, law.slab, *how))
            continue
        terms.append(charge_sum(system, law.charges, *how))
        if law.slab != "none":
            terms.append(SlabTerm(system, law.charges, law.slab))

    return terms


def special_terms(system: System, members: Sequence[PairLaw], laws: PairLaws) -> Iterator[Term]:
    """Terms for the pairs that the list leaves out: each law times its factors."""
    for member, factors in zip(members, laws.factors, strict=True):
        acts = (factors != 0.0) | (member.split is not None)
        if not acts.any():
            continue
        pairs = laws.excluded[acts]
        factors = factors[acts]
        species = system.species_index[pairs] if len(member.table) > 1 else np.zeros_like(pairs)
        rows = member.table[species[:, 0], species[:, 1]]
        products = [] if member.charges is None else [member.charges[pairs].prod(axis=1)]
        if member.split is None:
            columns = [rows[:, 0], factors, *products, rows[:, 1:]]
            law = Scaled(member.law)
        else:
            columns = [np.full(len(pairs), np.inf), *products, factors, rows[:, 0]]
            law = SpecialLaw(member.split.numbers)

        yield FixedPairs(pairs, law, from_table(np.column_stack(columns)))
