"""What the stress tests share: scenes, and the two ways in which a scene may end."""

import re
from math import sqrt

import numpy as np
from wrong_calls import assert_answered

import minimd as md
from minimd.core.forces.options import Options
from minimd.core.potentials.term import TOTALS

SMOOTH = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")
OPEN = md.LennardJones(1.0, 1.0)
WEAK = md.LennardJones(1e-3, 0.5)
SPRING, STIFF = md.HarmonicBond(1.0, 1.0), md.HarmonicBond(400.0, 1.0)
FREQUENCY = sqrt(2.0)  # of two unit masses on a spring with k = 1
BOTTOM = 2.0 ** (1.0 / 6.0)  # of the well [σ]
CURVATURE = 72.0 / 2.0 ** (1.0 / 3.0)  # u″ there [ε/σ²]
ROUNDING = 1e-12  # of sums over some thousand pairs, relative to the largest
LAST_GOOD = r"The system holds the last good state, that of step \d+"


def solid(n_cells=4, jitter=0.05, cell=True, seed=1, **more):
    """An fcc crystal a little out of order: 4 n³ atoms."""
    positions, edges = md.lattice.crystal("fcc", [n_cells] * 3, 1.68)
    positions = positions + jitter * np.random.default_rng(seed).standard_normal(positions.shape)
    return md.System(positions, cell=edges if cell else None, **more)


def pair_at(distance, velocities=None, bonded=False):
    """Two atoms on the x axis."""
    return md.System([[0, 0, 0], [distance, 0, 0]], velocities=velocities, bonds=[[0, 1]] if bonded else None)


def in_a_row(n_atoms, height=0.0):
    k = np.arange(n_atoms)
    return md.System(np.column_stack([k, height, 0.0 * k]), bonds=np.column_stack([k[:-1], k[1:]]))


def rigid_chain(zigzag):
    bonded = in_a_row(10, zigzag * (-1.0) ** np.arange(10))
    return md.System(bonded.positions), md.DistanceConstraints(bonded.bonds)


def rigid_ring(n_atoms=12):
    k, radius = np.arange(n_atoms), 0.5 / np.sin(np.pi / n_atoms)
    around = radius * np.exp(2.0j * np.pi * k / n_atoms)
    positions = np.column_stack([around.real, around.imag, 0.0 * k])
    return md.System(positions), md.DistanceConstraints(np.column_stack([k, (k + 1) % n_atoms]))


def forces_of(system, potentials, **options):
    """Forces, energy and virial, under some Options."""
    return md.Forces(system, potentials, Options(**options)).compute(TOTALS)


def made(system, potentials, timestep, constraints=None, method=md.VelocityVerlet, temperature=None, **options):
    """A simulation.  method : a class, or a method with its own time step."""
    method = method(timestep) if isinstance(method, type) else method
    simulation = md.Simulation(system, potentials, method, constraints, **options)
    if temperature is not None:
        simulation.set_temperature(temperature, seed=1)
    return simulation


def ran(system, potentials, timestep, n_steps, every=100, **more):
    simulation = made(system, potentials, timestep, **more)
    simulation.run(n_steps, every=every, progress=False)
    return simulation


def scaled(length, energy, mass, n_cells, **options):
    """Positions, forces and total energy of a run, in units of the scales."""
    start = solid(n_cells)
    system = md.System(start.positions * length, cell=start.cell.vectors * length, masses=mass)
    law, timestep = md.LennardJones(energy, length, 2.5 * length, "force-shifted"), 0.004 * length * sqrt(mass / energy)
    simulation = ran(system, law, timestep, 50, temperature=energy, every=10, **options)
    return simulation.positions / length, simulation.forces * length / energy, simulation.record.total_energy / energy


def oscillation(simulation):
    """Largest departure of the total energy from its start, relative to the largest kinetic energy."""
    record = simulation.record
    return float(np.abs(record.total_energy - record.total_energy[0]).max() / record.kinetic_energy.max())


def is_finite(simulation):
    """Whether every number of the state and of the record is one."""
    record = simulation.record
    series = [record.total_energy, record.temperature, record.momentum, record.angular_momentum]
    return all(np.isfinite(values).all() for values in (*series, simulation.positions, simulation.velocities))


def assert_stops(call, error=md.NonFiniteError, *patterns):
    """The run ends with a sentence that names the cause, and one of what was seen: no NaN, nothing from the inside."""
    message = assert_answered(call, error)
    assert not re.search(r"\b(nan|None|Traceback)\b", message) or error is ValueError
    assert [words for words in patterns if not re.search(words, message)] == [], message
    return message
