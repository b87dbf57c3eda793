"""Scenes for the cluster list, drawn by Hypothesis, and what two lists must agree on."""

import itertools
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import strategies as st
from references import liquid

import minimd as md
from minimd.forces.pair_laws import PairLaws
from minimd.potentials.term import FORCES, PER_ATOM, TOTALS
from minimd.structure.cell import Cell

CUTOFF, SKIN = 2.0, 0.3
JUST_HIGH_ENOUGH = (CUTOFF + SKIN) * (1.0 + 1e-9)
PERIODICITIES = list(itertools.product([True, False], repeat=3))
STEEP = 8.0  # what the rounding of a coordinate [length] does to a force, relative to the largest
SIZES = [2, 3, 7, 8, 9, 30, 120, 400, 1500]
KINDS = {"A": (1.0, 1.0), "B": (0.5, 0.88), "C": (0.2, 1.2)}
SMOOTH = {
    "one species": [md.LennardJones(1.0, 1.0, CUTOFF, "force-shifted")],
    "three species": [md.LennardJones(KINDS, cutoff=CUTOFF, truncation="switched")],
    "exclusions": [md.LennardJones(KINDS, cutoff=CUTOFF, truncation="force-shifted", bonded_scale=(0.0, 0.3, 0.8))],
    "two known laws": [
        md.LennardJones(1.0, 1.0, 1.6, "force-shifted"),
        md.LennardJones(KINDS, cutoff=CUTOFF, truncation="switched"),
    ],
}


def _edges(draw, volume, rng):
    """A cube, a slab or a rod, as thin as the list allows; any direction may be the long one."""
    shape, thin = draw(st.sampled_from(["cube", "slab", "rod"])), JUST_HIGH_ENOUGH
    if shape == "cube":
        return volume ** (1 / 3) * rng.uniform(0.8, 1.25, 3)
    edges = [thin, thin, volume / thin**2] if shape == "rod" else [thin, (volume / thin) ** 0.5, (volume / thin) ** 0.5]
    return np.roll(np.maximum(edges, thin), draw(st.integers(0, 2)))


def _jittered(n, cell, edges, rng):
    """n atoms on some sites of a lattice that has about as many."""
    counts = np.ceil(edges / (edges.prod() / n) ** (1 / 3)).astype(int)
    sites = np.array(list(np.ndindex(*counts)))
    chosen = np.sort(rng.permutation(len(sites))[:n])
    return ((sites[chosen] + 0.5 + 0.15 * rng.uniform(-1, 1, (n, 3))) / counts) @ cell


@st.composite
def scenes(draw, sizes=SIZES, densities=(0.01, 0.3, 1.0)):
    """Gas to dense, with gaps, in cells from just high enough to long and thin, turned, skewed, left-handed; chains of bonds."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, pbc = draw(st.sampled_from(sizes)), np.array(draw(st.sampled_from(PERIODICITIES)))
    edges = _edges(draw, n / draw(st.sampled_from(densities)), rng)
    tilts = np.eye(3) + draw(st.sampled_from([0.0, 1.0])) * np.tril(rng.uniform(-0.5, 0.5, (3, 3)), -1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if draw(st.booleans()) else np.eye(3)
    cell = tilts @ np.diag(edges) @ turn
    cell *= max(1.0, (JUST_HIGH_ENOUGH / Cell.of(cell, pbc).heights[pbc]).max(initial=0.0))
    positions = _jittered(n, cell, edges, rng)
    if draw(st.booleans()):
        cell[draw(st.integers(0, 2))] *= 1.7
    positions += (rng.integers(-2, 3, (n, 3)) * pbc) @ cell
    bonds = [[k, k + 1] for k in range(n - 1) if k % 5]
    return md.System(positions, cell=Cell.of(cell, pbc), species=rng.choice(["A", "B", "C"], n), bonds=bonds)


def rod(n_cells=16, width=3, seed=1):
    """A liquid of three species in a long cell, with bonds that go along chains of five."""
    unit = liquid(width, seed=seed)
    edge = unit.cell.vectors[0, 0]
    copies = [unit.positions + k * edge * np.eye(3)[0] for k in range(n_cells // width)]
    positions = np.concatenate(copies)
    rng = np.random.default_rng(seed)
    positions += 0.02 * rng.standard_normal(positions.shape)
    bonds = [[k, k + 1] for k in range(len(positions) - 1) if k % 5]
    species = rng.choice(["A", "B", "C"], len(positions))
    return md.System(positions, cell=[edge * len(copies), edge, edge], species=species, bonds=bonds)


@contextmanager
def atoms_per_domain(n):
    """Chunks and teams for scenes much smaller than those that need them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("minimd.neighbors.domains.ATOMS_PER_DOMAIN", n)
        yield


def pair_laws(system, potentials):
    """What the planner makes of pair potentials that share a list."""
    return PairLaws(system, [potential.bind(system).pair_law for potential in potentials])


def n_domains(term):
    return len(term.list.domains.first)


def evaluated(term, system, detail=TOTALS):
    """Forces (N, 3), energies (N,) and virials (N, 6) of a term."""
    forces, energies, virials = np.zeros((len(system), 3)), np.zeros(len(system)), np.zeros((len(system), 6))
    term.add(system, detail, forces, energies, virials)
    return forces, energies, virials


def summed(term, system, detail=TOTALS):
    """Forces, potential energy and virial of a term."""
    forces, energies, virials = evaluated(term, system, detail)
    return forces, energies.sum(), virials.sum(axis=0)


def deviations(clustered, listed, system):
    """Of forces, energies and virials, as sums and for each atom, relative to the largest force or to the largest of their own."""
    pairs = [*zip(summed(clustered, system), summed(listed, system), strict=True)]
    pairs += zip(evaluated(clustered, system, PER_ATOM), evaluated(listed, system, PER_ATOM), strict=True)
    largest = max(1.0, np.abs(pairs[0][1]).max())
    return [float(np.abs(got - expected).max() / max(largest, np.abs(expected).max())) for got, expected in pairs]


def agree(clustered, listed, system, tolerance):
    """Within a tolerance and the rounding of the coordinates, and the same forces whether or not somebody looks at the energies."""
    assert max(deviations(clustered, listed, system)) <= tolerance + STEEP * np.spacing(np.abs(system.positions).max())
    assert np.array_equal(evaluated(clustered, system, FORCES)[0], evaluated(clustered, system)[0])
