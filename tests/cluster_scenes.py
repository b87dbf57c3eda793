"""Scenes for the cluster list, drawn by Hypothesis, laws for them, and what two lists must agree on."""

import itertools
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import strategies as st
from references import liquid

import minimd as md
from minimd.core.compiled.program import Program
from minimd.core.compiled.threads import thread_pool
from minimd.core.forces.cluster_term import ClusterTerm
from minimd.core.forces.options import Options
from minimd.core.forces.pair_laws import PairLaws
from minimd.core.forces.pair_list_term import PairListTerm
from minimd.core.potentials.term import FORCES, PER_ATOM, TOTALS, Target
from minimd.core.structure.cell import Cell, Images

CUTOFF, SKIN = 2.0, 0.3
JUST_HIGH_ENOUGH = (CUTOFF + SKIN) * (1.0 + 1e-9)
PERIODICITIES = list(itertools.product([True, False], repeat=3))
EQUAL = 1e-13  # of the largest force: rounding of sums in another order
SIZES = [2, 3, 7, 8, 9, 30, 120, 400, 1500]
KINDS = {"A": (1.0, 1.0), "B": (0.5, 0.88), "C": (0.2, 1.2)}
SCALED = {"bonded_scale": (0.0, 0.3, 0.8)}
CUTOFFS = {(a, b): 1.5 + 0.1 * k for k, (a, b) in enumerate(["AA", "AB", "AC", "BB", "BC", "CC"])}


SOFT = [md.PairPotential(lambda r2, height: (height * np.exp(-r2), 2.0 * height * np.exp(-r2)), (3.0,), CUTOFF)]
ONE_SPECIES = [md.LennardJones(1.0, 1.0, CUTOFF, "force-shifted")]
MANY = [  # for the kernel all there is: parameters that are alike, those that are not, two laws; and scaled pairs
    md.LennardJones(1.0, 1.0, 1.6, "force-shifted", **SCALED),
    md.LennardJones(KINDS, cutoff=CUTOFF, truncation="switched", **SCALED),
]
LAWS = {
    "many": MANY, "one species": ONE_SPECIES,
    "three species": [md.LennardJones(KINDS, cutoff=CUTOFF, truncation="switched")],
    "exclusions": [md.LennardJones(KINDS, cutoff=CUTOFF, truncation="force-shifted", **SCALED)],
    "cutoffs by pair": [md.LennardJones({"A": (1, 1), "B": (0.5, 0.9), "C": (1, 1)}, cutoff=CUTOFFS)],
    "shifted, exclusions": [md.LennardJones(KINDS, cutoff=CUTOFF, **SCALED)],
    "two laws": [md.LennardJones(1.0, 1.0, 1.6), *SOFT],
}  # fmt: skip


def _edges(draw, volume, rng):
    """A cube, a slab or a rod, as thin as the list allows; any direction may be the long one."""
    shape, thin = draw(st.sampled_from(["cube", "slab", "rod"])), JUST_HIGH_ENOUGH
    if shape == "cube":
        return volume ** (1 / 3) * rng.uniform(0.8, 1.25, 3)
    edges = [thin, thin, volume / thin**2] if shape == "rod" else [thin, (volume / thin) ** 0.5, (volume / thin) ** 0.5]
    return np.roll(np.maximum(edges, thin), draw(st.integers(0, 2)))


def in_chains(positions, rng, **options):
    bonds = [[k, k + 1] for k in range(len(positions) - 1) if k % 5]
    return md.System(positions, species=rng.choice(["A", "B", "C"], len(positions)), bonds=bonds, **options)


@st.composite
def scenes(draw, sizes=SIZES, densities=(0.01, 0.3, 1.0)):
    """Gas to dense, with gaps and chains, in cells from just high enough to long and thin, skewed, left-handed.
    In wider cells they are slabs, rods and droplets, about faces, edges and corners."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, pbc = draw(st.sampled_from(sizes)), np.array(draw(st.sampled_from(PERIODICITIES)))
    edges = _edges(draw, n / draw(st.sampled_from(densities)), rng)
    tilts = np.eye(3) + draw(st.sampled_from([0.0, 1.0])) * np.tril(rng.uniform(-0.5, 0.5, (3, 3)), -1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if draw(st.booleans()) else np.eye(3)
    cell = tilts @ np.diag(edges) @ turn
    cell *= max(1.0, (JUST_HIGH_ENOUGH / Cell.of(cell, pbc).heights[pbc]).max(initial=0.0))
    counts = np.ceil(edges / (edges.prod() / n) ** (1 / 3)).astype(int)
    sites = np.array(list(np.ndindex(*counts)))
    chosen = np.sort(rng.permutation(len(sites))[:n])
    positions = ((sites[chosen] + 0.5 + 0.15 * rng.uniform(-1, 1, (n, 3))) / counts) @ cell
    positions -= rng.uniform(0, 1, 3) @ cell
    cell *= np.array(draw(st.tuples(*[st.sampled_from([1.0, 1.7, 4.0])] * 3)))[:, None]
    positions += (rng.integers(-2, 3, (n, 3)) * pbc) @ cell
    return in_chains(positions, rng, cell=Cell.of(cell, pbc))


def rod(n_copies=5, width=3, pbc=True):
    """A dense liquid in a long cell: copies of a cube of width cells, one behind the other."""
    unit, rng = liquid(width), np.random.default_rng(1)
    edge = unit.cell.vectors[0, 0]
    positions = np.concatenate([unit.positions + k * edge * np.eye(3)[0] for k in range(n_copies)])
    positions += 0.02 * rng.standard_normal(positions.shape)
    return in_chains(positions, rng, cell=[edge * n_copies, edge, edge], pbc=pbc)


@contextmanager
def atoms_per_domain(n):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("minimd.core.neighbors.domains.ATOMS_PER_DOMAIN", n)
        yield


def pair_laws(system, potentials):
    return PairLaws(system, [potential.bind(system).pair_law for potential in potentials])


def clustered(system, potentials, threads=2, skin=SKIN, precision="double"):
    return ClusterTerm(system, pair_laws(system, potentials), Options(threads, precision, skin))


def both_lists(system, potentials, skin=SKIN):
    bare = PairListTerm(system, pair_laws(system, potentials), Options(skin=0.0))
    return clustered(system, potentials, skin=skin), bare


def evaluated(term, system, detail=TOTALS):
    sums = np.zeros((len(system), 3)), np.zeros(len(system)), np.zeros((len(system), 6))
    target = Target(detail, *sums, np.zeros((0, 3)), Images.of(system.cell))
    term.list.ready(system.positions, system.cell)
    try:
        pool = getattr(term, "pool", thread_pool(1))
        Program(lambda: term.operations(system, target), lambda: term.list.version, pool).run()
    finally:
        term.list.settle()
    term.collect(target)
    term._evaluations = {}  # of this target
    return sums


def summed(term, system, detail=TOTALS):
    forces, energies, virials = evaluated(term, system, detail)
    return forces, energies.sum(), virials.sum(axis=0)


def agree(term, other, system, tolerance=EQUAL):
    """Forces, energies and virials, as sums and for each atom, are the same, relative to the largest of them.
    Within a tolerance and the rounding of coordinates, which changes forces f ~ 48 r⁻¹³ by 13/r of themselves. Forces
    have the same bits whether or not energies are wanted."""
    pairs = [*zip(summed(term, system), summed(other, system), strict=True)]
    pairs += zip(evaluated(term, system, PER_ATOM), evaluated(other, system, PER_ATOM), strict=True)
    largest = max(1.0, np.abs(pairs[0][1]).max())
    worst = max(np.abs(got - expected).max() / max(largest, np.abs(expected).max()) for got, expected in pairs)
    steep = 14.0 * (largest / 48.0) ** (1.0 / 13.0)
    assert worst <= tolerance + steep * np.spacing(np.abs(system.positions).max())
    assert np.array_equal(evaluated(term, system, FORCES)[0], evaluated(term, system)[0])
