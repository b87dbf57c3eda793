"""The kinetic temperature of rigid molecules in a Langevin bath: exact where nothing acts on them, else off by O(Δt²).

B. Leimkuhler, C. Matthews, Proc. R. Soc. A 472, 20160138 (2016): kick, drift, projected bath, drift, kick.
"""

from itertools import product

import numpy as np
import pytest

import minimd as md
from minimd.constraints.solver import ConstraintSolver
from minimd.integrators import State
from minimd.integrators.splitting.state import Bath, Surroundings

pytestmark = pytest.mark.slow
TRIANGLE = 0.6 * np.array([[0.0, 0.0, 0.0], [0.816, 0.577, 0.0], [-0.816, 0.577, 0.0]])
MOLECULES = {
    "dumbbell": (np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), [1.0, 3.0], [[0, 1]], 0.1),
    "water": (TRIANGLE / 0.6, [16.0, 1.0, 1.0], [[0, 1], [0, 2], [1, 2]], 0.05),
    "triangle": (TRIANGLE / 0.6, [1.0, 1.0, 1.0], [[0, 1], [0, 2], [1, 2]], 0.1),
}


def mean_and_error(values):
    """Of correlated values, from twenty blocks."""
    blocks = np.array(values).reshape(20, -1).mean(axis=1)
    return blocks.mean(), blocks.std(ddof=1) / np.sqrt(20)


@pytest.mark.parametrize("name", MOLECULES)
def test_free_rigid_molecules_have_the_temperature_of_the_bath_at_any_timestep(name):
    """All 3N − K degrees of freedom share it, translation and rotation each; a step is a tenth of a turn."""
    shape, masses, pairs, timestep = MOLECULES[name]
    n, size = 2000, len(shape)
    positions, pairs = np.tile(shape, (n, 1)), np.concatenate([np.array(pairs) + size * k for k in range(n)])
    m = np.tile(masses, n)
    bonds = ConstraintSolver(md.DistanceConstraints(pairs), positions, 1.0 / m)
    velocities = np.random.default_rng(1).normal(size=positions.shape) / np.sqrt(m)[:, None]
    bonds.project_velocities(velocities, positions)
    state = State(positions, velocities, np.zeros_like(positions), 1.0 / m)
    around = Surroundings(bonds, Bath())
    method, whole, inner = md.LangevinBAOAB(timestep, 1.0, friction=2.0, seed=3), [], []
    for _ in range(90):
        method.advance(state, lambda state, with_energy: None, max(1, round(0.4 / timestep)), surroundings=around)
        center = (m[:, None] * velocities).reshape(n, size, 3).sum(axis=1) / sum(masses)
        translation = sum(masses) * (center**2).sum()
        whole.append(translation / (3 * n))
        inner.append(((m[:, None] * velocities**2).sum() - translation) / (3 * size * n - bonds.n_constraints - 3 * n))
    for values in (whole, inner):
        mean, error = mean_and_error(values[10:])
        assert error < 0.003
        assert abs(mean - 1.0) < 4.0 * error  # statistics


def temperature_of_a_liquid_of_triangles(timestep, seed):
    """Mean and error of the kinetic temperature beside that of the bath: 64 rigid triangles of Lennard-Jones atoms."""
    centers = 1.85 * np.array(list(product(range(4), repeat=3)), dtype=float)
    positions = (centers[:, None] + TRIANGLE).reshape(-1, 3)
    pairs = np.concatenate([np.array([[0, 1], [0, 2], [1, 2]]) + 3 * k for k in range(64)])
    system = md.System(positions, cell=7.4, bonds=pairs)
    lj = md.LennardJones(1.0, 1.0, cutoff=2.2, truncation="switched", bonded_scale=(0, 0, 0))
    bath = md.LangevinBAOAB(timestep, 1.0, friction=5.0, seed=seed)
    simulation = md.Simulation(system, lj, bath, md.DistanceConstraints(pairs), threads=1)
    simulation.set_temperature(1.0, seed)
    simulation.equilibrate(round(10.0 / timestep), 1.0)
    return mean_and_error(simulation.run(round(400.0 / timestep), every=round(0.04 / timestep)).temperature[1:])


def test_the_temperature_of_interacting_molecules_is_off_by_the_square_of_the_timestep():
    """T(Δt) = T − c Δt², as for oscillators, where c is ω²/4: extrapolated from two steps it is that of the bath."""
    long, error_long = temperature_of_a_liquid_of_triangles(0.02, 1)
    short, error_short = temperature_of_a_liquid_of_triangles(0.01, 1)
    error = np.hypot(4.0 * error_short, error_long) / 3.0
    assert 1.0 - long > 6.0 * error_long
    assert (4.0 * short - long) / 3.0 == pytest.approx(1.0, abs=4.0 * error)  # statistics
    assert error < 0.004
