"""Random scenes, minimd against ASE: triclinic, left-handed, skewed, partly periodic, smaller than the cutoff, open."""

import ase.neighborlist
import numpy as np
import pytest
from ase import Atoms
from ase.calculators.lj import LennardJones
from hypothesis import given, settings
from hypothesis import strategies as st

import minimd as md
from minimd.ase import Calculator

SIGMA, EPSILON = 3.405, 0.010325
# rounding: positions up to 30 cells away (1e-14 of the cell), times the slope of the law, of some hundred pairs
RELATIVE = 1e-10
PROPERTIES = ("energy", "free_energy", "energies", "forces", "stress", "stresses")


def closest(atoms):
    for reach in (2.0, 4.0, 8.0):
        distances = ase.neighborlist.neighbor_list("d", atoms, reach)
        if distances.size:
            return distances.min()
    return np.inf


@st.composite
def scenes(draw):
    """Atoms on a distorted lattice, scaled so that the closest pair is 0.9 to 1.2 σ apart: no overlap, for any cell."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pbc = np.array(draw(st.tuples(st.booleans(), st.booleans(), st.booleans())))
    counts = np.array(draw(st.tuples(st.integers(1, 2), st.integers(1, 2), st.integers(1, 3))))
    cell = np.diag(counts) + 0.25 * rng.standard_normal((3, 3))
    places = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    positions = (places + rng.uniform(-0.2, 0.2, places.shape)) / counts @ cell
    strength = draw(st.sampled_from([0, 1, 4]))
    for _ in range(3):
        i, j = rng.permutation(3)[:2]
        cell[i] += rng.integers(-strength, strength + 1) * cell[j]
    if draw(st.booleans()):
        cell[rng.integers(3)] *= -1.0
    if draw(st.booleans()):
        cell[~pbc] = 0.0
    atoms = Atoms(f"Ar{len(places)}", positions, cell=cell, pbc=pbc)
    distance = closest(atoms)
    scale = SIGMA * draw(st.floats(0.9, 1.2)) / distance if np.isfinite(distance) else SIGMA
    atoms.set_cell(cell * scale, scale_atoms=False)
    n = draw(st.sampled_from([0, 1, 30]))
    away = rng.integers(-n, n + 1, (len(places), 3)) * pbc + rng.uniform(-n, n, 3) * ~pbc
    atoms.positions = positions * scale + away @ (cell * scale)
    return atoms


def scales(atoms, cutoff):
    """What each property is a sum of, with all its terms positive: the scale of its rounding."""
    i, d = ase.neighborlist.neighbor_list("id", atoms, cutoff)
    s6 = (SIGMA / d) ** 6
    energies = np.bincount(i, 4.0 * EPSILON * (s6 + s6**2), len(atoms))
    forces = np.bincount(i, 24.0 * EPSILON * (s6 + 2.0 * s6**2) / d, len(atoms))
    virials = np.bincount(i, 24.0 * EPSILON * (s6 + 2.0 * s6**2), len(atoms))
    stress = virials.sum() / (atoms.get_volume() if atoms.cell.rank == 3 else np.inf)
    sums = energies.sum(), energies.sum(), energies.max(), forces.max(), stress, stress
    return dict(zip(PROPERTIES, sums, strict=True))


def assert_law_of_ase(atoms, cutoff, truncation, start, **options):
    reference = LennardJones(sigma=SIGMA, epsilon=EPSILON, rc=cutoff, ro=start, **options)
    calculator = Calculator(md.LennardJones(EPSILON, SIGMA, cutoff, truncation, switch_start=start))
    reference.calculate(atoms)
    calculator.calculate(atoms, PROPERTIES)
    assert set(calculator.results) == set(reference.results)  # no stress where ASE has none
    size = scales(atoms, cutoff)
    for name, expected in reference.results.items():
        assert np.abs(calculator.results[name] - expected).max() <= RELATIVE * size[name], name


@pytest.mark.parametrize("n", [15, pytest.param(220, marks=pytest.mark.slow)])
def test_laws_are_those_of_ase(n):
    @settings(max_examples=n)
    @given(scenes(), st.floats(1.31, 3.0), st.floats(0.4, 0.95))
    def same_as_ase(atoms, cutoff, start):
        cutoff *= SIGMA
        assert_law_of_ase(atoms, cutoff, "shifted", None)
        assert_law_of_ase(atoms, cutoff, "charmm", start * cutoff, smooth=True)

    same_as_ase()
