"""Observables: of the present state, in record and file, where they cost something, and one of one's own."""

import h5py
import numpy as np
import pytest
from scenes import LJ, SCENES
from wrong_calls import assert_answered

import minimd as md
from minimd.core.engine.observation import OBSERVABLES, Observable, register
from minimd.core.engine.record import SERIES
from minimd.core.files.h5md_reader import damage, read_file


def test_the_present_state_is_measured_whatever_has_changed(argon):
    sim = argon.simulation()
    sim.run(5, every=5, progress=False)

    def check():
        result = md.evaluate(sim.system, LJ)
        kinetic, n_dof = 0.5 * (sim.velocities**2).sum(), 3 * len(sim.system) - 3
        assert sim.potential_energy == pytest.approx(result.potential_energy, rel=1e-12)
        assert (sim.kinetic_energy, sim.total_energy - sim.potential_energy) == pytest.approx((kinetic, kinetic))
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
    for scene in (SCENES["dumbbells"](), SCENES["water"]()):  # the stress holds the forces of constraints
        sim = scene.simulation()
        sim.run(2, progress=False)
        assert sim.pressure == pytest.approx(-np.trace(sim.stress) / 3.0, rel=1e-12)


def test_a_record_has_the_start_and_every_few_steps_and_looking_changes_no_bit(argon):
    one, other = argon.simulation(), argon.simulation()
    record = one.run(25, every=10, progress=False)
    assert (one.stress.shape, record.momentum.shape, record.step.tolist()) == ((3, 3), (3, 3), [0, 10, 20])
    assert record.time == pytest.approx([0.0, 0.04, 0.08])
    assert record.total_energy == pytest.approx(record.potential_energy + record.kinetic_energy)
    other.run(25, progress=False)
    assert np.array_equal(one.positions, other.positions)


def test_momenta_of_a_record_are_sums_over_the_atoms(small_molecule):
    sim = small_molecule.simulation()
    sim.velocities[:] = np.random.default_rng(3).normal(0.0, 0.1, sim.velocities.shape)
    record, momenta = sim.run(4, every=4, progress=False), sim.system.masses[:, None] * sim.velocities
    assert record.momentum[-1] == pytest.approx(momenta.sum(axis=0), abs=1e-12)
    assert record.angular_momentum[-1] == pytest.approx(np.cross(sim.positions, momenta).sum(axis=0))


def test_stress_is_in_record_and_file_where_asked_for_and_in_the_resumed_run(tmp_path, argon):
    sim, file = argon.simulation(), tmp_path / "a.h5md"
    assert "stress" not in sim.run(2, every=1, progress=False)
    sim.extra_observables = ("stress",)
    record = sim.run(4, every=2, trajectory=file, progress=False)
    assert -np.trace(record.stress, axis1=1, axis2=2) / 3.0 == pytest.approx(record.pressure, rel=1e-12)
    assert (record.stress.shape, np.array_equal(record.stress[-1], sim.stress)) == ((3, 3, 3), True)
    with h5py.File(file) as h5:
        stored = h5["observables/stress/value"]
        assert np.array_equal(stored[:], record.stress)
        assert stored.attrs["unit"] == md.units.LJ.pressure
    resumed = md.Simulation.resume(file, LJ)
    assert tuple(resumed.extra_observables) == ("stress",)
    resumed.run(4, every=2, trajectory=file, append=True, progress=False)
    resumed.extra_observables = ()
    assert_answered(lambda: resumed.run(2, trajectory=file, append=True), ValueError, "extra_observables", "'stress'")


@pytest.mark.parametrize("every", [20, 500])
def test_energy_is_evaluated_only_where_somebody_looks(every, chain):
    asked = []

    class Noted(md.Term):
        is_checked, bind = False, lambda self, _system: self

        def add(self, system, detail, forces, energies, virials):
            asked.append(detail)

    simulation = chain._replace(laws=[*chain.laws, Noted()]).simulation
    simulation().run(2 * every, every=every)
    assert (len(asked), sum(detail > 0 for detail in asked)) == (2 * every + 1, 3)
    asked.clear()
    simulation().equilibrate(100, 1.0)
    assert sum(detail > 0 for detail in asked) == 1  # the look at the start


def test_what_nobody_asks_for_is_not_paid_and_what_cannot_be_is_told(two_atoms):
    """Without a volume there is no stress, measured values cannot be set, names are used once."""
    sim = two_atoms.simulation()
    record = sim.run(10, every=5)
    assert {"periodic images", "bond loop", "parameter table", "exclusions"} <= set(sim.report().cost.skipped)
    assert sim.potential_energy < 0.0
    extra = "extra_observables"
    for call, error, *shown in [
        (lambda: record.pressure, AttributeError, "pressure", "volume"),
        (lambda: sim.pressure, ValueError, "pressure", "volume", "pbc = [False"),
        (lambda: setattr(sim, extra, ("heat",)), ValueError, extra, "('heat',)"),
        (lambda: register(Observable("pressure", "pressure", abs)), ValueError, "'pressure'"),
        (lambda: register(Observable("fastest", "speed", abs)), ValueError, "unit", "'speed'"),
    ]:
        assert_answered(call, error, *shown)
    assert (sim.extra_observables, "fastest" in {**OBSERVABLES, **SERIES}) == ((), False)


def test_an_observable_of_ones_own_is_in_record_and_file_and_stays_there(tmp_path, monkeypatch, argon):
    """A file keeps its observables: appended to with others, its series would have different lengths."""
    before, file, sim = tmp_path / "before.h5md", tmp_path / "a.h5md", argon.simulation()
    sim.run(2, every=1, trajectory=before)
    with monkeypatch.context() as patch:
        patch.setattr("minimd.core.engine.observation.OBSERVABLES", dict(OBSERVABLES))
        register(Observable("doubled_energy", "energy", lambda look: 2.0 * look.total_energy))
        assert_answered(lambda: sim.run(2, every=1, trajectory=before, append=True), ValueError, "'doubled_energy'")
        record = sim.run(6, every=3, trajectory=file)
        assert np.array_equal(record.doubled_energy, 2.0 * record.total_energy)
    SERIES.pop("doubled_energy")
    with h5py.File(file) as h5:
        stored = h5["observables/doubled_energy/value"]
        assert np.array_equal(stored[:], 2.0 * record.total_energy)
        assert stored.attrs["unit"] == md.units.LJ.energy
    assert_answered(lambda: sim.run(2, every=1, trajectory=file, append=True), ValueError, "'doubled_energy'")
    for one in (before, file):
        assert (damage(one) or None, read_file(one).n_frames) == (None, 3)
