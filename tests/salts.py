"""A few ions of rock salt, for tests of what becomes of charges."""

import charged_scenes
import numpy as np

import minimd as md

EDGE = 5.64  # Å, of the cube of eight ions
CUTOFF = 2.7
LAWS = [md.LennardJones(0.1, 2.3, CUTOFF, "force-shifted"), md.Coulomb(CUTOFF, 1e-4)]


def salt(net=0.0, **given):
    """Eight ions, not quite in their places, of ±0.7 e and a share of the net charge."""
    of = charged_scenes.salt(1, disorder=0.035, seed=7)
    given = {"cell": EDGE, "charges": 0.7 * of.charges + net / 8.0, "species": of.species} | given
    masses = np.where(of.charges > 0.0, 22.99, 35.45)
    return md.System(0.5 * EDGE * of.positions, units=md.units.ASE, masses=masses, **given)


def run_of(system, femtoseconds=1.0):
    """A simulation of ions at 300 K."""
    made = md.Simulation(system, LAWS, md.VelocityVerlet(femtoseconds * md.units.fs))
    made.set_temperature(300.0, seed=2)
    return made
