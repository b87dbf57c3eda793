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
