"""Profiles of films, in layers about their center."""

import numpy as np
import pytest
from wrong_calls import answered

import minimd as md


@pytest.mark.parametrize("move", [7.0, 23.0, -41.0])  # the film of 8 σ is cut by the boundary at ±12 σ, or is an image
def test_layers_about_the_center_move_with_a_film(move):
    places = np.random.default_rng(1).random((200, 3)) * [6.0, 6.0, 8.0]
    found = []
    for shift in (0.0, move):
        film = md.System(places + shift * np.eye(3)[2], masses=np.linspace(1.0, 2.0, 200), cell=[6.0, 6.0, 24.0])
        layers = md.observers.Profile(n_bins=48, center=True)
        md.Simulation(film, [], md.VelocityVerlet(0.004)).run(1, observers=[layers], progress=False)
        found.append(layers.result())
    np.testing.assert_array_equal(found[0].densities, found[1].densities)
    assert (found[0].z[0], found[0].z[-1]) == (-11.75, 11.75)
    occupied = found[0].z[found[0].density > 0.0]
    assert (occupied.min(), occupied.max()) == pytest.approx((-4.0, 4.0), abs=0.5)  # of the center, one bin


def test_a_flow_has_a_velocity_and_no_heat():
    """u = 0.5 z along x, and −1 along y, of thermal atoms of two masses; one frame."""
    rng = np.random.default_rng(2)
    n, thermal = 8000, 0.7
    masses = np.resize([1.0, 3.0], n)
    places = 10.0 * rng.random((n, 3))
    velocities = rng.normal(size=(n, 3)) * np.sqrt(thermal / masses)[:, None]
    velocities += np.column_stack([0.5 * places[:, 2], -np.ones(n), np.zeros(n)])
    gas = md.System(places, masses=masses, velocities=velocities, cell=[10.0, 10.0, 10.0])
    looking = md.observers.Profile(n_bins=20, every=1)
    sim = md.Simulation(gas, [], md.VelocityVerlet(0.004))
    looking.observe(sim.engine)
    result = looking.result()
    flow = np.array([0.5 * result.z, np.full(20, -1.0), np.zeros(20)]) - sim.drift[:, None]
    most = 4.0 * np.sqrt(thermal / masses.mean() / (n / 20))  # statistics
    np.testing.assert_allclose(result.flow, flow, atol=most)
    shear = masses.mean() * 0.5**2 * 0.5**2 / 36.0  # of the slope within a layer, on the three directions
    assert result.temperature.mean() == pytest.approx(thermal + shear, rel=4.0 * np.sqrt(2.0 / (3.0 * n)))  # statistics
    assert result.columns()["flow_y"][3] == result.flow[1, 3]


N_ATOMS = 216
GROUPS = "bonds", "angles", "dihedrals"


def chains():
    """A film of chains of four atoms in a cell that is not upright; some of them are cut by its faces."""
    rng = np.random.default_rng(5)
    places = np.argwhere(np.ones((6, 9, 4))) * [1.3, 1.3, 1.1] + 0.1 * rng.normal(size=(N_ATOMS, 3))
    groups = [[[k + n for n in range(size)] for k in range(0, N_ATOMS, 4)] for size in (2, 3, 4)]
    return md.System(
        places,
        velocities=rng.normal(size=(N_ATOMS, 3)),
        masses=np.resize([1.0, 2.0, 1.5], N_ATOMS),
        cell=[[8.0, 0.0, 0.0], [1.0, 12.0, 0.0], [0.5, -0.7, 24.0]],
        charges=np.resize([0.5, -0.5], N_ATOMS),
        **dict(zip(GROUPS, groups, strict=True)),
    )


LAWS = [
    md.LennardJones(1.0, 1.0, 2.5, bonded_scale=(0.0, 0.0, 0.5)),
    md.Coulomb(3.0, method="shifted-force"),
    md.HarmonicBond(30.0, 1.0),
    md.HarmonicAngle(20.0, 1.9),
    md.PeriodicDihedral(3.0, 2, 0.4),
]
RIGID = {"constraints": md.DistanceConstraints([[k, k + 1] for k in range(0, N_ATOMS, 4)])}


@pytest.mark.parametrize("axis", "abc")
@pytest.mark.parametrize("options", [{}, RIGID, {"precision": "fixed-point"}], ids=["", "rigid", "fixed-point"])
def test_the_mean_over_all_layers_is_the_pressure_of_the_cell(axis, options):
    looking = md.observers.PressureProfile(axis, n_bins=37, every=1)
    sim = md.Simulation(chains(), LAWS, md.VelocityVerlet(1e-4), **options)
    looking.observe(sim.engine)
    result = looking.result()
    scale = np.abs(sim.stress).max()
    k = "abc".index(axis)
    normal = np.cross(*np.delete(sim.system.cell.vectors, k, axis=0))
    across = -(normal @ sim.stress @ normal) / (normal @ normal)
    along = -0.5 * (np.trace(sim.stress) + across)
    assert (result.normal.mean(), result.tangential.mean()) == pytest.approx((across, along), abs=1e-9 * scale)
    height = sim.system.volume / np.linalg.norm(normal)
    assert result.integral == pytest.approx(height * (across - along), abs=1e-9 * scale * height)  # rounding
    assert np.ptp(result.normal) > 0.1 * abs(across)
    assert result.plot().axes[0].get_ylabel() == "pressure profile  [ε/σ³]"  # of both curves


def test_lines_are_shared_by_the_layers_that_they_cross():
    """Of a pair across three layers and the face of the cell, and of one that lies in a layer."""
    lj = md.LennardJones(1.0, 1.0, 3.0)
    pair = md.System([[1.0, 1.0, 11.6], [1.0, 1.0, 13.1]], masses=1.0, cell=[9.0, 9.0, 12.0])
    push = -1.5 * md.evaluate(pair, lj).forces[0, 2]
    looking = md.observers.PressureProfile(n_bins=12, every=1)
    looking.observe(md.Simulation(pair, lj, md.VelocityVerlet(1e-3)).engine)
    expected = np.zeros(12)
    expected[[11, 0, 1]] = np.array([0.4, 1.0, 0.1]) / 1.5 * push / 81.0
    np.testing.assert_allclose(looking.result().normal, expected, atol=1e-12 * abs(push))  # rounding
    np.testing.assert_allclose(looking.result().tangential, 0.0, atol=1e-12 * abs(push))
    flat = md.System([[1.0, 1.0, 5.5], [2.5, 1.0, 5.5]], masses=1.0, cell=[9.0, 9.0, 12.0])
    level = md.observers.PressureProfile(n_bins=12, every=1)
    level.observe(md.Simulation(flat, lj, md.VelocityVerlet(1e-3)).engine)
    np.testing.assert_allclose(level.result().tangential, 0.5 * push / 81.0 * (np.arange(12) == 5), rtol=1e-12)


def film(n_cells):
    """A liquid film, or with as many cells as fit, a liquid; with the law that has no jump."""
    positions, edges = md.lattice.crystal("fcc", [4, 4, n_cells], (4.0 / 0.8) ** (1.0 / 3.0))
    cell = [edges[0], edges[1], 8.0 * edges[0] / 4.0]
    sim = md.Simulation(
        md.System(positions, masses=1.0, cell=cell),
        md.LennardJones(1.0, 1.0, 2.5, "force-shifted"),
        md.StochasticVelocityRescaling.with_relaxation_time(0.005, 0.8, 1.0, seed=4),
    )
    sim.set_temperature(0.8, seed=4)
    sim.run(2000, every=2000, progress=False)
    looking = [md.observers.PressureProfile(n_bins=24, every=10, center=n_cells < 8), md.observers.SurfaceTension()]
    sim.run(4000, every=4000, progress=False, observers=looking)
    return [one.result() for one in looking]


def test_the_integral_of_the_profile_of_a_film_is_its_tension():
    profile, surface = film(4)
    assert profile.integral == pytest.approx(2.0 * surface.tension, rel=1e-9)  # rounding
    assert profile.integral_error == pytest.approx(2.0 * surface.tension_error, rel=1e-6)
    deviations = (profile.normal - surface.normal_pressure) / np.hypot(profile.normal_error, 1e-3)
    assert np.abs(deviations).max() < 4.0  # statistics
    assert (profile.tangential - profile.normal).min() < -0.1  # at a surface


def test_a_liquid_has_its_pressure_in_each_layer():
    profile, surface = film(8)
    for values, errors in ((profile.normal, profile.normal_error), (profile.tangential, profile.tangential_error)):
        assert np.abs((values - surface.normal_pressure) / errors).max() < 4.5  # statistics, 24 layers


def looked_at(potentials, **options):
    looking = md.observers.PressureProfile()
    return looking.prepare(md.Simulation(chains(), potentials, md.VelocityVerlet(1e-3), **options).engine)


test_what_has_no_lines_is_refused = answered(
    (lambda: looked_at([md.Coulomb(3.0)]), ValueError, "pressure profile", "waves"),
    (lambda: looked_at([LAWS[1], md.Gravity(1.0)]), ValueError, "pressure profile", "FieldTerm"),
)
