"""Argon as ASE sees it, with our calculator and with ASE's."""

import ase.io
import ase.units
import numpy as np
from ase.build import bulk
from ase.calculators.lj import LennardJones

import minimd as md
from minimd.structure.velocities import maxwell_boltzmann

SIGMA, EPSILON, CUTOFF = 3.405, 0.0103, 8.0
TIMESTEP = 4.0 * ase.units.fs
ROUNDING = 1e-12  # of sums over 108 atoms with some 50 neighbors each


def argon(n_cells=3, temperature=188.8, seed=1):
    """Liquid argon on its way from an fcc lattice to 94.4 K: half of the heat melts it. 4 n³ atoms, 1.374 g/cm³."""
    atoms = bulk("Ar", "fcc", a=5.78, cubic=True) * n_cells
    atoms.rattle(0.1, seed=seed)
    velocities = maxwell_boltzmann(atoms.get_masses(), temperature, md.units.ASE.k_B, seed)
    atoms.set_momenta(velocities * atoms.get_masses()[:, None])
    return atoms


def lennard_jones(truncation="shifted", cutoff=CUTOFF):
    return md.LennardJones(EPSILON, SIGMA, cutoff, truncation)


def ase_lennard_jones(**options):
    return LennardJones(sigma=SIGMA, epsilon=EPSILON, rc=CUTOFF, **options)


def with_calculator(atoms, calculator):
    atoms = atoms.copy()
    atoms.calc = calculator
    return atoms


def same(a, b, tolerance=ROUNDING):
    a, b = np.asarray(a), np.asarray(b)
    return np.abs(a - b).max() <= tolerance * max(np.abs(b).max(), 1e-300)
