"""Baths and what they act on, for tests of thermostats."""

import numpy as np
from references import liquid

import minimd as md
from minimd.integrators import Drift, Kick, State
from minimd.integrators.splitting.state import Bath, Surroundings
from minimd.integrators.splitting.substeps import Thermalize

LANGEVIN = md.LangevinBAOAB(0.01, temperature=1.3, friction=2.0, seed=5)
BUSSI = md.StochasticVelocityRescaling(0.01, temperature=1.3, relaxation_time=0.5, seed=5)
SCENE = """
units = "LJ"
[structure]
lattice = "fcc"
repeat = [3, 3, 3]
density = 0.8
[[potential]]
type = "lennard-jones"
epsilon = 1.0
sigma = 1.0
cutoff = 2.0
[dynamics]
method = "{method}"
timestep = 0.004
steps = 40
temperature = 1.2
relaxation_time = 0.3
[output]
every = 10
"""


def state(velocities, masses):
    velocities = np.array(velocities, dtype=float)
    return State(np.zeros_like(velocities), velocities, np.zeros_like(velocities), 1.0 / masses)


def in_contact(**bath):
    return Surroundings(bath=Bath(**bath))


class OBABO(md.LangevinBAOAB):
    """Two contacts with the bath in a step. G. Bussi, M. Parrinello, Phys. Rev. E 75, 056707 (2007)."""

    name = "langevin-obabo"
    substeps = (Thermalize(0.5), Kick(0.5), Drift(1.0), Kick(0.5), Thermalize(0.5))


def simulation(method, seed=3):
    lj = md.LennardJones(1.0, 1.0, cutoff=2.0, truncation="force-shifted")
    sim = md.Simulation(liquid(3), lj, method)
    sim.set_temperature(1.3, seed)
    return sim
