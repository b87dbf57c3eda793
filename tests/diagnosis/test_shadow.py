"""What a run conserves beyond the energy: its shadow, and its way back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from references import liquid, melt_scene
from scenes import SCENES
from wrong_calls import answered

import minimd as md
from minimd.analysis.check import check_file
from minimd.commands import main as cli
from minimd.files.h5md_reader import read_file
from minimd.integrators import SPLITTINGS

OTHERS = [pytest.param(name, marks=pytest.mark.slow) for name in ("position-verlet", "leapfrog")]
VERLETS = pytest.mark.parametrize("name", ["velocity-verlet", *OTHERS])
SMOOTH = md.LennardJones(1.0, 1.0, 1.85, "smooth")


def argon(method=None):
    return SCENES["argon"]().simulation(method or md.VelocityVerlet(0.003))


def smooth(name="velocity-verlet", dt=0.003, jitter=0.05):
    simulation = md.Simulation(liquid(3, jitter=jitter), SMOOTH, SPLITTINGS[name](dt))
    simulation.extra_observables = ("shadow_energy",)
    return simulation


@VERLETS
def test_shadow_energy_minus_the_work_of_a_field_is_conserved_to_the_fourth_order(name):
    """Time is a coordinate then, and minus the work its momentum. E − W falls by 4 where Δt is halved, not by 16."""
    spreads, start = [], {"velocities": [[0.2, 0.1, 0], [-0.3, 0, 0.4]], "masses": (1.0, 2.5), "bonds": [[0, 1]]}
    for dt in (0.1, 0.05, 0.025):
        laws = [md.HarmonicBond(1.0, 1.0), md.SteeredSpring(2.0, [0.1, 0, 0], [0.3, 0.2, 0])]
        simulation = md.Simulation(md.System([[0.3, 0, 0], [1.5, 0.2, 0]], **start), laws, SPLITTINGS[name](dt))
        simulation.extra_observables = ("shadow_energy",)
        record = simulation.run(round(10.0 / dt), every=1)
        assert np.ptp(record.work) > 0.1
        spreads.append([np.ptp(series - record.work) for series in (record.total_energy, record.shadow_energy)])
    assert -np.diff(np.log2(spreads), axis=0) == pytest.approx(np.array([[2.0, 4.0]] * 2), abs=0.1)  # truncation
    assert simulation.report().shadow_oscillation < spreads[-1][1]  # the report takes the work off


def test_shadow_energy_of_the_oscillator_is_its_closed_form():
    """Δt² (1/12 ω² v² − 1/24 ω⁴ x²) of one atom of mass 1 on a spring to a fixed one, ω = 1."""
    dt, x, v = 0.3, 0.4, 0.7
    system = md.System([[0, 0, 0], [1.0 + x, 0, 0]], velocities=[[0, 0, 0], [v, 0, 0]], bonds=[[0, 1]])
    simulation = md.Simulation(system, md.HarmonicBond(1.0, 1.0), md.VelocityVerlet(dt), md.FixedAtoms([0]))
    expected = 0.5 * v * v + 0.5 * x * x + dt**2 * (v * v / 12.0 - x * x / 24.0)
    assert md.shadow_energy(simulation) == pytest.approx(expected, rel=1e-10)  # rounding, over the nudge


@VERLETS
def test_shadow_energy_of_a_liquid_is_conserved_to_the_fourth_order(name):
    spreads = []
    for dt in (0.006, 0.003):
        simulation = smooth(name, dt, jitter=0.02)
        simulation.run(round(0.6 / dt), every=round(0.6 / dt))
        spreads.append(simulation.run(round(1.2 / dt), every=round(0.012 / dt)).shadow_energy.std())
    assert np.log2(spreads[0] / spreads[1]) == pytest.approx(4.0, abs=0.5)  # truncation, measured on one short path


@pytest.mark.slow
def test_shadow_energy_changes_nothing_and_shows_a_smaller_error_of_the_drift(tmp_path):
    (shown, plain), file = (smooth(), smooth()), tmp_path / "a.h5md"
    plain.extra_observables = ()
    plain.run(400, every=10)
    shown.run(400, every=10, trajectory=file)
    assert np.abs(shown.positions - plain.positions).max() < 1e-9  # rounding, amplified
    report = shown.report()
    assert report.shadow_is_conserved
    assert report.shadow_oscillation < 0.05 * report.energy_oscillation
    assert report.shadow_drift.error < 0.1 * report.energy_drift.error
    told = [str(one) for one in (report, check_file(file), plain.report())]
    assert ["shadow energy" in one for one in told] == [True, True, False]


def test_shadow_energy_sees_a_drift_that_the_energy_hides():
    """Heat of 5e-8 of the velocities every ten steps is far below the oscillation of the energy in so short a run."""
    simulation = smooth()
    heat = lambda sim: np.multiply(sim.velocities, 1.0 + 5e-8, out=sim.velocities)  # noqa: E731
    simulation.run(1000, every=10, observers=[heat])
    report = simulation.report()
    put_in = 1e-7 * report.kinetic_energy / 0.03
    assert (report.shadow_drift.is_significant, report.shadow_is_conserved) == (True, False)
    assert report.shadow_drift.slope == pytest.approx(put_in, rel=0.2)
    assert abs(report.energy_drift.slope - put_in) > put_in


def test_scene_records_the_shadow_energy_and_goes_on_with_it(here):
    Path("melt.toml").write_text(melt_scene(3, 40, "[output]\nevery = 5\nshadow_energy = true\n"))
    assert cli.main(["run", "melt.toml", "--quiet"]) == 0
    assert cli.main(["resume", "melt.h5md", "--steps", "20"]) == 0
    record = read_file("melt.h5md").record
    assert record.step.tolist() == list(range(0, 61, 5))
    assert np.ptp(record.shadow_energy) < 0.2 * np.ptp(record.total_energy)


@pytest.mark.filterwarnings("ignore:timestep")  # too long for methods of order one
@pytest.mark.parametrize("name", SPLITTINGS)
def test_symmetric_methods_come_back_and_others_do_not(name):
    found = argon(SPLITTINGS[name](0.003)).probe_reversibility(60)
    assert found.is_reversible == SPLITTINGS[name].is_symmetric
    assert found.way > 0.1
    assert found.distance < 1e-11 if found.is_reversible else "NOT REVERSIBLE" in str(found)


def test_probe_restores_the_state_and_nothing_is_counted_among_the_steps_of_a_run():
    """Neither the steps of a probe nor those of minimization and equilibration; the memory is that of the process."""
    simulation = argon()
    simulation.run(50, every=10)
    before, cost = simulation.snapshot(), simulation.report().cost
    simulation.probe_reversibility(130)
    for name in ("positions", "velocities", "step", "time"):
        assert np.array_equal(getattr(simulation, name), getattr(before, name)), name
    simulation.minimize(max_steps=5)
    assert replace(simulation.report().cost, peak_memory=cost.peak_memory) == cost
    simulation.equilibrate(30, 1.0)
    after = simulation.report().cost
    assert (after.n_steps, after.n_evaluations) == (cost.n_steps, cost.n_evaluations)


def test_probes_of_a_long_way_of_rigid_bonds_and_of_an_atom_on_which_nothing_acts():
    far = argon(md.VelocityVerlet(0.005))
    far.set_temperature(3.0, seed=1)
    assert far.probe_reversibility(3000).is_reversible is None  # it cannot tell
    assert SCENES["dumbbells"]().simulation().probe_reversibility(60).is_reversible
    for speed in (0.0, 1.0):
        alone = md.System([[0.0, 0.0, 0.0]], velocities=[[speed, 0.0, 0.0]])
        simulation = md.Simulation(alone, md.LennardJones(1.0, 1.0), md.VelocityVerlet(0.01))
        assert simulation.probe_reversibility(10).is_reversible


BATH = md.LangevinBAOAB(0.003, 1.0, 1.0, seed=1)
test_what_is_not_known_or_cannot_be_undone_is_refused = answered(
    (lambda: md.shadow_energy(argon(BATH)), ValueError, "thermostat"),
    (lambda: md.shadow_energy(argon(SPLITTINGS["yoshida-6"](0.003))), ValueError, "the method is yoshida-6"),
    (lambda: md.shadow_energy(SCENES["dumbbells"]().simulation()), ValueError, "rigid bonds"),
    (lambda: setattr(argon(), "extra_observables", ("entropy",)), ValueError, "extra_observables", "entropy"),
    (lambda: argon(BATH).probe_reversibility(10), ValueError, "noise"),
    *((lambda n=n: argon().probe_reversibility(n), ValueError, "n_steps", repr(n)) for n in (0, 1.5, "ten")),
)
