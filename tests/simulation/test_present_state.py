"""Observables of the present state of a simulation, and the stress tensor: in memory, in record and file, and in a resumed run."""

import h5py
import numpy as np
import pytest
from references import liquid
from test_rigid_runs import simulation as rigid_liquid

import minimd as md
from minimd.engine.record import Frame

LJ = md.LennardJones(1.0, 1.0, 1.85, "switched")
NAMES = ("potential_energy", "temperature", "pressure")


def simulation():
    return md.Simulation(liquid(3), LJ, md.VelocityVerlet(0.003))


def test_the_present_state_is_measured_whatever_has_changed():
    """After a run, at another place, with other velocities and in another cell."""
    sim = simulation()
    sim.run(5, every=5, progress=False)

    def check():
        result = md.evaluate(sim.system, LJ)
        kinetic, n_dof = 0.5 * (sim.velocities**2).sum(), 3 * len(sim.system) - 3
        assert sim.potential_energy == pytest.approx(result.potential_energy, rel=1e-12)
        assert sim.temperature == pytest.approx(2.0 * kinetic / n_dof, rel=1e-12)
        tensor = -(sim.velocities.T @ sim.velocities + result.virial) / sim.system.volume
        assert sim.stress == pytest.approx(tensor, rel=1e-10, abs=1e-12)
        assert sim.pressure == pytest.approx(-np.trace(sim.stress) / 3.0, rel=1e-12)

    check()
    sim.system.positions[:] += 0.01 * np.sin(np.arange(3 * len(sim.system))).reshape(-1, 3)
    check()
    sim.set_temperature(0.7, seed=2)
    check()
    sim.system.cell = md.Cell.of(1.02 * sim.system.cell.vectors)
    check()


def test_looking_changes_no_bit():
    one, other = simulation(), simulation()
    one.run(3, progress=False)
    assert [getattr(one, name) for name in NAMES]
    assert one.stress.shape == (3, 3)
    one.run(3, progress=False)
    other.run(6, progress=False)
    assert np.array_equal(one.positions, other.positions)


def test_stress_of_ideal_atoms_and_of_a_stretched_crystal():
    """Without forces σ = −μ v ⊗ v / V of two atoms with the relative velocity v; a crystal that is stretched is under tension, σ > 0."""
    gas = md.System([[0, 0, 0], [5, 5, 5]], velocities=[[1, 2, 3], [0, 0, 1]], masses=[2.0, 3.0], cell=10.0)
    sim = md.Simulation(gas, LJ, md.VelocityVerlet(0.001))
    assert sim.stress == pytest.approx(-1.2 * np.outer([1, 2, 2], [1, 2, 2]) / 1000.0, rel=1e-14)
    a = 1.05 * (4.0 / 1.09) ** (1.0 / 3.0)
    corners = a * np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(-1, 1, 3)
    crystal = (corners + a / 2.0 * np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]])).reshape(-1, 3)
    at_rest = md.Simulation(md.System(crystal, cell=3.0 * a), LJ, md.VelocityVerlet(0.001))
    assert at_rest.stress == pytest.approx(at_rest.stress[0, 0] * np.eye(3), abs=1e-10)
    assert at_rest.stress[0, 0] > 0.0
    assert at_rest.pressure < 0.0


def test_stress_is_in_record_and_file_where_asked_for_and_in_the_resumed_run(tmp_path):
    sim, file = simulation(), tmp_path / "a.h5md"
    assert "stress" not in sim.run(2, every=1, progress=False)
    sim.extra_observables = ("stress",)
    record = sim.run(4, every=2, trajectory=file, progress=False)
    assert record.stress.shape == (3, 3, 3)
    assert -np.trace(record.stress, axis1=1, axis2=2) / 3.0 == pytest.approx(record.pressure, rel=1e-12)
    assert np.array_equal(record.stress[-1], sim.stress)
    with h5py.File(file) as h5:
        stored = h5["observables/stress/value"]
        assert np.array_equal(stored[:], record.stress)
        assert stored.attrs["unit"] == md.units.LJ.pressure
    resumed = md.Simulation.resume(file, LJ)
    assert tuple(resumed.extra_observables) == ("stress",)
    resumed.run(4, every=2, trajectory=file, append=True, progress=False)
    other = md.Simulation.resume(file, LJ)
    other.extra_observables = ()
    with pytest.raises(ValueError, match=r"was begun with simulation.extra_observables = \('stress',\)"):
        other.run(2, trajectory=file, append=True, progress=False)


def test_stress_holds_the_forces_of_constraints():
    sim = rigid_liquid(md.VelocityVerlet(0.002))
    sim.run(2, progress=False)
    assert sim.pressure == pytest.approx(-np.trace(sim.stress) / 3.0, rel=1e-12)
    assert isinstance(sim.frame(), Frame)


def test_without_a_volume_there_is_no_stress_and_measured_values_cannot_be_set():
    sim = md.Simulation(md.System([[0.0, 0, 0], [1.2, 0, 0]]), LJ, md.VelocityVerlet(0.001))
    assert sim.potential_energy < 0.0
    for name in ("pressure", "stress"):
        with pytest.raises(
            ValueError,
            match=r"pressure and stress need a volume: a cell that is periodic in all three directions; its pbc = \[False",
        ):
            getattr(sim, name)
    with pytest.raises(ValueError, match="pressure and stress need a volume"):
        sim.extra_observables = ("stress",)
    with pytest.raises(
        ValueError,
        match=r"extra_observables must be a tuple with any of 'stress', 'shadow_energy', or empty; it is \('heat',\)",
    ):
        sim.extra_observables = ("heat",)
    assert sim.extra_observables == ()
    with pytest.raises(
        AttributeError, match="temperature of a Simulation is measured and cannot be set; see set_temperature"
    ):
        sim.temperature = 1.0
