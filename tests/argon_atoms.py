"""Argon as ASE sees it, with minimd's calculator and with ASE's; copper; minimd's format of files made known to ASE."""

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import ase.units
import numpy as np
from ase.build import bulk
from ase.calculators.emt import EMT
from ase.calculators.lj import LennardJones
from ase.io.formats import define_external_io_format, ioformats

import minimd as md
from minimd.ase import Calculator
from minimd.core.structure.observables import maxwell_boltzmann

REPOSITORY = Path(__file__).parents[1]
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


def liquid(calculator=None, n_cells=2):
    return with_calculator(argon(n_cells), calculator or Calculator(lennard_jones()))


def copper(calculator=None):
    atoms = with_calculator(bulk("Cu", cubic=True), calculator or EMT())
    atoms.rattle(0.05, seed=1)
    atoms.set_momenta(np.random.default_rng(2).normal(0.0, 1.5, (4, 3)))
    return atoms


def same(a, b, tolerance=ROUNDING):
    a, b = np.asarray(a), np.asarray(b)
    return np.abs(a - b).max() <= tolerance * max(np.abs(b).max(), 1e-300)


def entry_points():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    return {group: project["entry-points"][group] for group in ("ase.ioformats", "ase.plugins")}


def define():
    if "minimd-h5md" not in ioformats:
        target = entry_points()["ase.ioformats"]["minimd-h5md"]
        define_external_io_format(EntryPoint("minimd-h5md", target, "ase.ioformats"))
