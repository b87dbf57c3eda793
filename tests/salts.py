"""A few ions of rock salt, for tests of what becomes of charges."""

import numpy as np

import minimd as md

EDGE = 5.64  # Å, of the cube of eight ions
CUTOFF = 2.7
LAWS = [md.LennardJones(0.1, 2.3, CUTOFF, "force-shifted"), md.Coulomb(CUTOFF, 1e-4)]


def salt(net=0.0, **given):
    """Eight ions, not quite in their places, of ±0.7 e and a share of the net charge."""
    sites = np.stack(np.meshgrid(*[np.arange(2)] * 3, indexing="ij"), -1).reshape(-1, 3)
    positions = 0.5 * EDGE * sites + np.random.default_rng(7).normal(0.0, 0.1, (8, 3))
    is_cation = sites.sum(axis=1) % 2 == 0
    given = {"cell": EDGE, "charges": np.where(is_cation, 0.7, -0.7) + net / 8.0} | given
    kinds = {"masses": np.where(is_cation, 22.99, 35.45), "species": np.where(is_cation, "Na", "Cl")}
    return md.System(positions, units=md.units.ASE, **kinds, **given)


def run_of(system, femtoseconds=1.0):
    """A simulation of ions at 300 K."""
    made = md.Simulation(system, LAWS, md.VelocityVerlet(femtoseconds * md.units.fs))
    made.set_temperature(300.0, seed=2)
    return made
