"""Scenes in two dimensions: what is counted, forces and pressures, baths that stay in the plane, observers, files."""

import numpy as np
import pytest
from wrong_calls import assert_answered

import minimd as md

LAW = md.LennardJones(1.0, 1.0, 2.5, truncation="switched")
BATHS = {
    "langevin": md.LangevinBAOAB(0.005, 0.7, 1.0, seed=1),
    "gjf": md.LangevinGJF(0.005, 0.7, 1.0, seed=1),
    "rescaling": md.StochasticVelocityRescaling(0.005, 0.7, 0.5, seed=1),
    "brownian": md.BrownianDynamics(1e-4, 0.7, 1.0, seed=1),
}


def triangular(repeat=(8, 5), density=0.8, **options):
    constant = md.lattice.constant_from_density("triangular", density)
    positions, edges = md.lattice.crystal("triangular", repeat, constant)
    return md.System(positions, cell=edges, planar=True, **options)


def disks(method=None, **options):
    sim = md.Simulation(triangular(), LAW, method or md.VelocityVerlet(0.005), threads=1, **options)
    sim.set_temperature(0.7, seed=2)
    return sim


def gas(n=400, area=1000.0):
    places = np.random.default_rng(4).uniform(0.0, area**0.5, (n, 2))
    return md.System(places, cell=area**0.5, planar=True)


def test_a_plane_has_two_directions_and_an_area():
    system = triangular(velocities=np.zeros((80, 2)))
    assert system.positions.shape == (80, 3)
    assert system.volume == pytest.approx(100.0, rel=1e-14)
    assert (system.dimensions, system.units.pressure) == (2, "ε/σ²")
    assert "area           100 σ²" in str(system)
    assert disks().n_dof == 2 * 80 - 2
    assert disks(BATHS["langevin"]).n_dof == 2 * 80
    assert disks().temperature == pytest.approx(0.7, rel=1e-14)
    turned = md.System(np.zeros((3, 2)), cell=[[5.0, 0.0], [1.0, 4.0]], planar=True)
    assert turned.volume == pytest.approx(20.0)


def test_the_pressure_is_the_change_of_the_energy_with_the_area():
    sim = disks()
    sim.run(50, progress=False)
    energies = []
    for size in (1.0 - 1e-5, 1.0 + 1e-5):
        cell = sim.system.cell.with_vectors(size * sim.system.cell.vectors)
        strained = md.System(size * sim.positions, cell=cell)
        energies.append(md.evaluate(strained, LAW).potential_energy)
    of_virial = np.trace(md.evaluate(sim.system, LAW).virial) / (2.0 * sim.system.volume)
    area = sim.system.volume
    assert of_virial == pytest.approx(-np.diff(energies)[0] / (4e-5 * area), rel=1e-6)  # truncation


def test_an_ideal_gas_has_the_pressure_of_its_area():
    sim = md.Simulation(gas(), [], md.VelocityVerlet(0.01))
    sim.set_temperature(1.5, seed=1)
    record = sim.run(10, every=1, progress=False)
    assert record.pressure == pytest.approx(2 * 399 * 1.5 / (2 * 1000.0), rel=1e-12)


@pytest.mark.slow
def test_a_thin_gas_has_its_virial_coefficients():
    """P/ρk_BT = 1 + B₂ρ + B₃ρ², with B₂ = −π ∫ f r dr, B₃ = −⅓ ∫∫ f₁₂ f₁₃ f₂₃ dr₂ dr₃, f = e^(−u/k_BT) − 1."""
    heat, density, cutoff = 2.0, 0.05, 2.5
    bond = lambda r: np.exp(-np.where(r < cutoff, 4 * (r**-12 - r**-6) - shift, 0.0) / heat) - 1.0  # noqa: E731
    shift = 4 * (cutoff**-12 - cutoff**-6)
    r = (np.arange(200) + 0.5) * cutoff / 200
    turn = (np.arange(120) + 0.5) * np.pi / 120
    third = (r[:, None] ** 2 + r**2 - 2 * r[:, None] * r * np.cos(turn[:, None, None])) ** 0.5
    inside = (bond(third).mean(axis=0) * (bond(r) * r)[:, None] * (bond(r) * r)).sum() * (cutoff / 200) ** 2
    expected = -np.pi * (bond(r) * r).sum() * cutoff / 200 * density - 4 / 3 * np.pi**2 * inside * density**2

    positions, edges = md.lattice.crystal("square", (32, 32), (1 / density) ** 0.5)
    law = md.LennardJones(1.0, 1.0, cutoff, truncation="shifted")
    bath = md.StochasticVelocityRescaling(0.004, heat, 1.0, seed=1)
    sim = md.Simulation(md.System(positions, cell=edges, planar=True), law, bath)
    sim.set_temperature(heat, seed=1)
    sim.run(3000, progress=False)
    record = sim.run(60_000, every=20, progress=False)
    mean, error = md.mean_and_error(record.pressure / (density * record.temperature) - 1.0)
    assert error < 0.03 * expected
    assert mean == pytest.approx(expected, abs=4.0 * error)


@pytest.mark.parametrize("precision", ["double", pytest.param("fixed-point", marks=pytest.mark.slow)])
@pytest.mark.parametrize("bath", BATHS)
def test_baths_stay_in_the_plane_and_keep_its_temperature(bath, precision):
    sim = disks(BATHS[bath], precision=precision)
    sim.run(1000, progress=False)
    record = sim.run(8000, every=10, progress=False)
    assert not sim.positions[:, 2].any()
    assert not sim.velocities[:, 2].any()
    # statistics: 4 errors, of 80 correlation times
    assert record.temperature.mean() == pytest.approx(0.7, abs=0.035)


def test_energy_is_conserved_and_steps_of_fixed_point_return():
    sim = disks(precision="fixed-point")
    start = sim.positions.tobytes()
    record = sim.run(2000, every=100, progress=False)
    assert np.ptp(record.total_energy) < 2e-3 * 80  # truncation
    sim.run_back(2000)
    assert sim.positions.tobytes() == start


def test_disks_in_a_trap_have_the_spread_of_two_directions():
    trap = md.Restraint(4.0, np.zeros((4000, 3)))
    system = md.System(np.zeros((4000, 2)), planar=True)
    sim = md.Simulation(system, trap, md.LangevinBAOAB(0.2, 0.5, 2.0, seed=3))
    sim.run(200, progress=False)
    assert (sim.positions**2).sum(axis=1).mean() == pytest.approx(2 * 0.5 / 4.0, rel=0.07)  # 4/√4000


@pytest.mark.parametrize("reorientation", ["diffusion", "tumble", "ornstein-uhlenbeck"])
def test_active_disks_diffuse_as_theory_says(reorientation):
    """⟨Δr²⟩ = 4Dt + 2v²τ(t − τ(1 − e^(−t/τ)))."""
    push = md.ActiveForce(3.0, 0.5, 1, reorientation=reorientation)
    system = md.System(np.zeros((6000, 2)), planar=True)
    sim = md.Simulation(system, push, md.BrownianDynamics(0.01, 0.4, 1.0, seed=5))
    sim.run(200, progress=False)
    expected = 4 * 0.4 * 2.0 + 2.0 * 9.0 * 0.5 * (2.0 - 0.5 * (1.0 - np.exp(-4.0)))
    assert (sim.positions**2).sum(axis=1).mean() == pytest.approx(expected, rel=0.06)  # 4/√6000, truncation
    assert not sim.positions[:, 2].any()


def test_observers_know_the_plane():
    sim = md.Simulation(gas(), [], md.BrownianDynamics(0.05, 1.0, 1.0, seed=2), threads=1)
    pairs = md.observers.RadialDistribution(r_max=4.0, n_bins=20, every=2)
    moved = md.observers.MeanSquareDisplacement(every=1)
    speeds = md.observers.Profile("a", n_bins=4, every=2)
    scattered = md.observers.StructureFactor(q_max=3.0, n_bins=6, every=2)
    sim.run(400, observers=[pairs, moved, speeds, scattered], progress=False)
    assert pairs.result().g == pytest.approx(1.0, abs=0.12)
    assert moved.result().msd[10] == pytest.approx(4.0 * 0.05 * 9.5, rel=0.1)  # see BrownianDynamics
    assert moved.result().diffusion == pytest.approx(1.0, rel=0.15)
    assert speeds.result().density.mean() == pytest.approx(0.4, rel=1e-12)
    assert speeds.result().temperature == pytest.approx(1.0, abs=0.05)
    assert scattered.result().s.mean() == pytest.approx(1.0, abs=0.15)
    assert "σ²" in str(speeds.result())


def test_a_triangular_lattice_has_its_order():
    pytest.importorskip("freud")
    sim = disks(md.LangevinBAOAB(0.005, 0.05, 1.0, seed=1))
    order = md.observers.BondOrder("psi6", every=10)
    sim.run(0, observers=[order], progress=False)
    assert order.result().numbers()["psi6"] == pytest.approx(1.0, abs=1e-6)


def test_a_plane_goes_on_from_its_file_to_the_same_bits(tmp_path):
    bath = md.StochasticCellRescaling(1.0, 0.3, 1.0, seed=4, coupling="triclinic", every=10)
    ends = []
    for parts in ((200,), (90, 110)):
        path = tmp_path / f"{len(parts)}.h5md"
        sim = disks(BATHS["langevin"], barostat=bath)
        sim.run(parts[0], every=10, trajectory=path, progress=False)
        for n_steps in parts[1:]:
            sim = md.Simulation.resume(path, LAW)
            assert sim.system.dimensions == 2
            sim.run(n_steps, every=10, trajectory=path, append=True, progress=False)
        ends.append(sim.positions.tobytes() + sim.system.cell.vectors.tobytes())
    assert ends[0] == ends[1]
    record = md.read_record(path)
    assert np.ptp(record.volume) > 0.1


def test_a_file_of_another_program_becomes_a_plane():
    space = triangular().to_ase()
    assert md.System.from_ase(space).dimensions == 3
    system = md.System.from_ase(space).in_plane()
    assert system.dimensions == 2
    assert system.volume == pytest.approx(100.0)


def test_what_leaves_the_plane_is_refused():
    sim = disks()
    sim.velocities[3, 2] = 0.1
    assert_answered(lambda: sim.run(1), ValueError, "velocities of atom 3", "0.1")
    away = md.Simulation(triangular(), md.ConstantForce([0.0, 0.0, 1.0]), md.VelocityVerlet(0.005))
    assert_answered(lambda: away.run(1), ValueError, "forces of atom", "plane")
    assert_answered(lambda: md.System(np.ones((2, 3)), planar=True), ValueError, "positions of atom 0")
    closed = {"cell": [3.0, 3.0, 3.0], "pbc": (True, True, True), "planar": True}
    assert_answered(lambda: md.System(np.zeros((2, 2)), **closed), ValueError, "third direction", "open")


class Spilling(md.LangevinBAOAB):
    """A bath of somebody's who thinks of three directions."""

    def thermalize(self, state, duration, around):
        state.velocities[:] = self.noise(around.bath).standard_normal(state.velocities.shape)


def test_a_bath_that_leaves_the_plane_is_refused():
    sim = md.Simulation(gas(50), [], Spilling(0.01, 1.0, 1.0, seed=1))
    assert_answered(lambda: sim.run(20), ValueError, "plane", "positions of atom")


def test_a_file_in_a_plane_is_a_structure_in_its_units(tmp_path):
    sim = disks()
    sim.run(2, every=1, trajectory=tmp_path / "a.h5md", progress=False)
    again = md.ase.system_from_file(tmp_path / "a.h5md", units=md.units.LJ)
    assert (again.dimensions, again.units) == (2, md.units.LJ.in_plane)


def test_what_a_plane_has_not_is_refused():
    tailed = md.LennardJones(1.0, 1.0, 2.5, "truncated", tail_correction=True)
    assert_answered(lambda: md.evaluate(triangular(), tailed), ValueError, "tail_correction", "plane")
    ions = triangular(charges=np.tile([1.0, -1.0], 40))
    assert_answered(lambda: md.evaluate(ions, md.Coulomb(2.0)), ValueError, "plane", "shifted-force")
    with_z = md.StochasticCellRescaling(1.0, 0.3, 1.0, seed=4, coupling="z")
    assert_answered(lambda: disks(BATHS["langevin"], barostat=with_z), ValueError, "'z'", "plane")
    looking = md.observers.Viscosity()
    assert_answered(lambda: disks().run(10, observers=[looking]), ValueError, "viscosity", "plane")
    assert_answered(lambda: setattr(disks().system, "cell", md.Cell.of(10.0)), ValueError, "2 dimensions")
