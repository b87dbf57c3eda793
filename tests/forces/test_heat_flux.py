"""The flux of energy is d/dt Σ r (K + u) of an open cluster, to the truncation of a central difference."""

import numpy as np
import pytest
from wrong_calls import answered

import minimd as md
from minimd.core.engine.observation import Look

N, STEP = 8, 1e-5
MAP = np.random.default_rng(5).normal(size=(6, 6))
LAWS = {
    "pairs": md.LennardJones(1.0, 0.6, 9.0),
    "charges by pairs": md.Coulomb(20.0, method="shifted-force"),
    "bonds": md.HarmonicBond(30.0, 1.0),
    "angles": md.HarmonicAngle(20.0, 1.9),
    "dihedrals": md.PeriodicDihedral(3.0, 2, 0.4),
    "two dihedrals": md.DihedralMap(MAP, [[0, 1, 2, 3], [1, 2, 3, 4]], [[4, 5, 6, 7], [2, 3, 4, 5]]),
}


def chain(**options):
    rng = np.random.default_rng(3)
    masses, velocities = rng.uniform(1.0, 3.0, N), rng.normal(size=(N, 3))
    groups = [[[k + n for n in range(size)] for k in range(N + 1 - size)] for size in (2, 3, 4)]
    return md.System(
        np.cumsum(rng.normal(size=(N, 3)) * 0.2 + [0.9, 0.2, 0.1], axis=0),
        velocities=velocities - masses @ velocities / masses.sum(),
        masses=masses,
        charges=rng.normal(size=N),
        **dict(zip(("bonds", "angles", "dihedrals"), groups, strict=True)),
        **options,
    )


def flux_of(system, laws, **options):
    return Look(md.Simulation(system, laws, md.VelocityVerlet(1e-3), **options).engine).heat_flux


@pytest.mark.filterwarnings("ignore:the charges of the atoms")
@pytest.mark.parametrize("kind", [*LAWS, "all"])
def test_the_flux_of_energy_is_the_motion_of_its_center(kind):
    laws = [*LAWS.values()] if kind == "all" else [LAWS[kind]]
    system = chain()
    accelerations = md.evaluate(system, laws).forces / system.masses[:, None]

    def moment(time):
        moved = chain()
        moved.positions[:] += time * system.velocities + 0.5 * time**2 * accelerations
        moved.velocities[:] += time * accelerations
        kinetic = 0.5 * moved.masses * np.square(moved.velocities).sum(axis=1)
        return (kinetic + md.evaluate(moved, laws).energies) @ moved.positions

    flux = (moment(STEP) - moment(-STEP)) / (2.0 * STEP)
    scale = np.abs(flux).max()
    np.testing.assert_allclose(flux_of(system, laws), flux, atol=1e-5 * scale)  # truncation, STEP²
    rounded = flux_of(system, laws, precision="fixed-point")
    np.testing.assert_allclose(rounded, flux_of(system, laws), atol=1e-6 * scale)  # steps of the grid
    within = chain(cell=40.0)  # across its faces
    within.positions[:] = (within.positions - within.positions.mean(axis=0)) % 40.0
    np.testing.assert_allclose(flux_of(within, laws), flux_of(system, laws), atol=1e-9 * scale)  # rounding


def test_a_flux_changes_no_bit_of_the_steps():
    """Also of a method whose steps begin with a drift, and which builds its lists later."""
    for method in (md.VelocityVerlet(1e-3), md.StochasticVelocityRescaling(1e-3, 1.0, 1.0, seed=1)):
        watched, alone = (md.Simulation(chain(), [*LAWS.values()], method) for _ in range(2))
        watched.run(60, every=20, observers=[lambda sim: Look(sim.engine).heat_flux])
        alone.run(60, every=20)
        np.testing.assert_array_equal(watched.positions, alone.positions)
        assert watched.engine.interactions.counts == alone.engine.interactions.counts


def looked_at(potentials, method=None, **options):
    sim = md.Simulation(chain(cell=40.0), potentials, method or md.VelocityVerlet(1e-3), **options)
    return md.observers.ThermalConductivity().prepare(sim.engine)


held = md.DistanceConstraints([[0, 1]])
test_what_has_no_heat_flux_is_refused = answered(
    (lambda: looked_at(md.Coulomb(10.0)), ValueError, "heat flux", "waves"),
    (lambda: looked_at([LAWS["pairs"]], constraints=held), ValueError, "heat flux", "rigid bonds"),
    (lambda: looked_at([LAWS["pairs"], md.Gravity(1.0)]), ValueError, "heat flux", "fields"),
    (lambda: looked_at(LAWS["pairs"], md.LangevinBAOAB(1e-3, 1.0, 1.0, seed=1)), ValueError, "heat flux", "baths"),
)


def group_velocities2(sites, edges, stiffness, primitive, n):
    """Σ |v_νν′|² over all waves of a crystal of bonds between nearest neighbors and all pairs of equal frequencies, of
    v = ∂D/∂k /(ω + ω′) between polarizations; D: dynamical matrix of unit masses."""
    reach = 1.01 * np.linalg.norm(primitive[0])
    first, arms = md.neighbor_list("iD", md.System(sites, cell=edges), reach)
    arms = arms[first == 0]
    ways = arms / np.linalg.norm(arms, axis=1, keepdims=True)
    steps = np.stack(np.meshgrid(*[np.arange(2 * n)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    waves = 2.0 * np.pi * steps / edges
    _, different = np.unique(np.round((waves @ primitive.T / (2.0 * np.pi)) % 1.0, 6) % 1.0, axis=0, return_index=True)
    assert len(different) == len(sites)
    total = 0.0
    for k in waves[different]:
        pairs = np.einsum("da,db->dab", ways, ways) * stiffness
        squares, polarizations = np.linalg.eigh(np.einsum("d,dab->ab", 1.0 - np.cos(arms @ k), pairs))
        frequencies = np.sqrt(np.maximum(squares, 0.0))
        if not frequencies.max() > 1e-6:
            continue
        is_same = np.abs(frequencies[:, None] - frequencies) < 1e-7
        for axis in range(3):
            slope = np.einsum("d,dab->ab", np.sin(arms @ k) * arms[:, axis], pairs)
            between = polarizations.T @ slope @ polarizations / (frequencies[:, None] + frequencies)
            total += (between[is_same] ** 2).sum()
    return total


@pytest.mark.slow
def test_the_integral_of_a_harmonic_crystal_grows_as_the_waves_run():
    """∫⟨J(0)·J(t)⟩ dt → (k_B T)² Σ v² t: heat runs with the group velocities, and nothing scatters it."""
    stiffness, constant, heat, n, n_starts = 50.0, 1.5, 1e-6, 3, 120
    sites, edges = md.lattice.crystal("fcc", [n] * 3, constant)
    primitive = 0.5 * constant * (1.0 - np.eye(3))
    length = np.linalg.norm(primitive[0])
    pairs = np.column_stack(md.neighbor_list("ij", md.System(sites, cell=edges), 1.01 * length))
    law = md.HarmonicBond(stiffness, length)
    system = md.System(sites, cell=edges, bonds=pairs[pairs[:, 0] < pairs[:, 1]])
    arms = md.neighbor_list("D", system, 1.01 * length)
    ways = arms / np.linalg.norm(arms, axis=1, keepdims=True)
    hessian = np.zeros((len(sites), 3, len(sites), 3))
    for (i, j), way in zip(pairs, ways, strict=True):
        block = stiffness * np.outer(way, way)
        hessian[i, :, i] += block
        hessian[i, :, j] -= block
    squares, modes = np.linalg.eigh(hessian.reshape(system.positions.size, -1))
    modes, frequencies = modes[:, squares > 1e-6], np.sqrt(squares[squares > 1e-6])

    rng = np.random.default_rng(1)
    simulation = md.Simulation(system, law, md.VelocityVerlet(0.01), threads=1)
    fluxes = []
    for _ in range(n_starts):
        drawn = np.sqrt(heat) * rng.normal(size=(2, len(frequencies)))
        simulation.positions = sites + (modes @ (drawn[0] / frequencies)).reshape(-1, 3)
        simulation.velocities = (modes @ drawn[1]).reshape(-1, 3)
        seen = []
        for _ in range(40):
            simulation.run(37, progress=False)
            seen.append(Look(simulation.engine).heat_flux)
        fluxes.append(np.mean(seen, axis=0))

    squares = (np.array(fluxes) ** 2).sum(axis=1)
    expected = heat**2 * group_velocities2(sites, edges, stiffness, primitive, n)
    assert squares.mean() == pytest.approx(expected, abs=4.0 * squares.std() / n_starts**0.5)  # statistics
