"""What a step conserves beyond the energy: its shadow, its way back, and what the report says of jumps, lists and constraints."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from references import liquid, melt_scene
from test_rigid_runs import simulation as rigid_liquid

import minimd as md
from minimd.analysis import check
from minimd.commands import main as cli
from minimd.diagnosis.run_report import cutoff_lines
from minimd.files.h5md_reader import read_file
from minimd.files.h5md_writer import H5MDWriter
from minimd.integrators import SPLITTINGS

VERLETS = ["velocity-verlet", "position-verlet", "leapfrog"]


def oscillator(method, masses=(1.0, 2.5)):
    """Two atoms of unlike mass on a spring along x."""
    system = md.System([[0, 0, 0], [1.3, 0, 0]], masses=masses, bonds=[[0, 1]])
    return md.Simulation(system, md.HarmonicBond(1.0, 1.0), method)


def recorded(simulation, n_steps, every=1):
    simulation.extra_observables = ("shadow_energy",)
    return simulation.run(n_steps, every=every)


@pytest.mark.parametrize("name", VERLETS)
def test_shadow_energy_of_the_oscillator_is_conserved_to_the_fourth_order(name):
    """That of the whole step is known: its deviation falls by 16 where the step is halved, that of the energy by 4."""
    spread = []
    for dt in (0.2, 0.1, 0.05):
        record = recorded(oscillator(SPLITTINGS[name](dt)), round(20.0 / dt))
        spread.append((np.ptp(record.total_energy), np.ptp(record.shadow_energy)))
    slopes = np.diff(np.log(spread), axis=0) / np.log(0.5)
    assert slopes[:, 0] == pytest.approx([2.0, 2.0], abs=0.02)  # truncation
    assert slopes[:, 1] == pytest.approx([4.0, 4.0], abs=0.02)


def shaken(x, y, z, t, k):
    """A trap whose stiffness and center along y change with time."""
    stiff, slope, away = k * (2.0 + np.sin(1.7 * t)), 1.7 * k * np.cos(1.7 * t), y - 0.4 * np.sin(t)
    square = x * x + away * away + z * z
    power = 0.5 * slope * square - 0.4 * stiff * away * np.cos(t)
    return 0.5 * stiff * square, -stiff * x, -stiff * away, -stiff * z, power


TIMED = {"user's": md.Field(shaken, (1.5,)), "steered": md.SteeredSpring(2.0, [0.1, 0, 0], [0.3, 0.2, 0])}


@pytest.mark.parametrize("field", TIMED.values(), ids=TIMED)
@pytest.mark.parametrize("name", VERLETS)
def test_with_forces_that_depend_on_time_the_shadow_energy_minus_their_work_is_conserved(name, field):
    """Time is a coordinate then, and minus the work its momentum. E - W falls by 4 only. The report takes the work off."""
    velocities = [[0.2, 0.1, 0], [-0.3, 0, 0.4]]
    spread = []
    for dt in (0.1, 0.05, 0.025):
        system = md.System([[0.3, 0, 0], [1.5, 0.2, 0]], masses=(1.0, 2.5), velocities=velocities, bonds=[[0, 1]])
        simulation = md.Simulation(system, [md.HarmonicBond(1.0, 1.0), field], SPLITTINGS[name](dt))
        record = recorded(simulation, round(10.0 / dt))
        assert np.ptp(record.work) > 0.1
        shadow = record.shadow_energy - record.work
        spread.append((np.ptp(record.total_energy - record.work), np.ptp(shadow)))
    slopes = np.diff(np.log(spread), axis=0) / np.log(0.5)
    assert slopes[:, 0] == pytest.approx([2.0, 2.0], abs=0.1)  # truncation
    assert slopes[:, 1] == pytest.approx([4.0, 4.0], abs=0.1)
    assert simulation.report().shadow_oscillation < np.ptp(shadow)


def test_shadow_energy_of_the_oscillator_is_its_closed_form():
    """Δt² (1/12 ω² v² − 1/24 ω⁴ x²) of one atom of mass 1 on a spring to a fixed one, ω = 1."""
    dt = 0.3
    system = md.System([[0, 0, 0], [1.4, 0, 0]], velocities=[[0, 0, 0], [0.7, 0, 0]], bonds=[[0, 1]])
    simulation = md.Simulation(system, md.HarmonicBond(1.0, 1.0), md.VelocityVerlet(dt), md.FixedAtoms([0]))
    x, v = 0.4, 0.7
    expected = 0.5 * v * v + 0.5 * x * x + dt**2 * (v * v / 12.0 - x * x / 24.0)
    assert md.shadow_energy(simulation) == pytest.approx(expected, rel=1e-10)  # rounding, over the nudge


@pytest.mark.parametrize("name", VERLETS)
def test_shadow_energy_of_a_liquid_is_conserved_to_the_fourth_order(name):
    spread = []
    for dt in (0.006, 0.003, 0.0015):
        simulation = md.Simulation(
            liquid(3, jitter=0.02), md.LennardJones(1.0, 1.0, 1.85, "smooth"), SPLITTINGS[name](dt)
        )
        simulation.run(round(0.6 / dt), every=round(0.6 / dt))
        record = recorded(simulation, round(1.2 / dt), every=round(0.012 / dt))
        spread.append(record.shadow_energy.std())
    assert np.diff(np.log(spread)) / np.log(0.5) == pytest.approx(
        [4.0, 4.0], abs=0.5
    )  # truncation, measured on one short path


@pytest.mark.slow
def test_shadow_energy_changes_nothing_and_shows_a_smaller_error_of_the_drift(tmp_path):
    made = [
        md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "smooth"), md.VelocityVerlet(0.003)) for _ in range(2)
    ]
    made[0].extra_observables = ("shadow_energy",)
    for simulation in made:
        simulation.run(400, every=10, trajectory=tmp_path / f"{made.index(simulation)}.h5md")
    assert np.abs(made[0].positions - made[1].positions).max() < 1e-9  # rounding, amplified
    report = made[0].report()
    assert report.shadow_is_conserved
    assert report.shadow_oscillation < 0.05 * report.energy_oscillation
    assert report.shadow_drift.error < 0.1 * report.energy_drift.error
    assert "shadow energy  drift" in str(report)
    assert ": none" in str(report)
    assert "shadow" not in str(made[1].report())
    contents = read_file(tmp_path / "0.h5md")
    np.testing.assert_array_equal(contents.record.shadow_energy, made[0].record.shadow_energy)
    assert "shadow energy" in str(check.check_file(tmp_path / "0.h5md"))
    made[0].extra_observables = ()
    with pytest.raises(ValueError, match=r"was begun with simulation\.extra_observables"):
        H5MDWriter.append_to(tmp_path / "0.h5md", made[0].engine)


def test_shadow_energy_sees_a_drift_that_the_energy_hides():
    """Heat of 5e-8 of the velocities every ten steps is far below the oscillation of the energy in so short a run."""
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "smooth"), md.VelocityVerlet(0.003))
    simulation.extra_observables = ("shadow_energy",)

    def heat(sim):
        sim.velocities[:] *= 1.0 + 5e-8

    simulation.run(1000, every=10, observers=[heat])
    report = simulation.report()
    put_in = 1e-7 * report.kinetic_energy / 0.03
    assert report.shadow_drift.is_significant
    assert report.shadow_drift.slope == pytest.approx(put_in, rel=0.2)
    assert abs(report.energy_drift.slope - put_in) > put_in
    assert report.shadow_is_conserved is False


def test_scene_records_the_shadow_energy_and_goes_on_with_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("melt.toml").write_text(melt_scene(3, 40, "[output]\nevery = 5\nshadow_energy = true\n"))
    assert cli.main(["run", "melt.toml", "--quiet"]) == 0
    assert cli.main(["resume", "melt.h5md", "--steps", "20"]) == 0
    assert "shadow energy  drift" in capsys.readouterr().out
    record = read_file("melt.h5md").record
    assert record.step.tolist() == list(range(0, 61, 5))
    assert np.ptp(record.shadow_energy) < 0.2 * np.ptp(record.total_energy)
    Path("bath.toml").write_text(
        Path("melt.toml")
        .read_text()
        .replace("steps = 40", 'steps = 40\nmethod = "langevin-baoab"\nrelaxation_time = 1.0\nseed = 1')
    )
    assert cli.main(["run", "bath.toml", "--quiet"]) == 2
    assert "output.shadow_energy: there is no shadow energy with a thermostat" in capsys.readouterr().err


def test_shadow_energy_is_refused_where_it_is_not_known():
    lj = md.LennardJones(1.0, 1.0, 1.85, "smooth")
    with pytest.raises(ValueError, match="thermostat"):
        md.shadow_energy(md.Simulation(liquid(3), lj, md.LangevinBAOAB(0.003, 1.0, 1.0, seed=1)))
    with pytest.raises(ValueError, match="the method is yoshida-6"):
        md.shadow_energy(md.Simulation(liquid(3), lj, SPLITTINGS["yoshida-6"](0.003)))
    with pytest.raises(ValueError, match="rigid bonds"):
        md.shadow_energy(rigid_liquid(md.VelocityVerlet(0.002)))
    simulation = md.Simulation(liquid(3), lj, md.VelocityVerlet(0.003))
    with pytest.raises(ValueError, match="extra_observables must be"):
        simulation.extra_observables = ("entropy",)


@pytest.mark.parametrize("name", [name for name, method in SPLITTINGS.items() if method.is_symmetric])
def test_symmetric_methods_come_back(name):
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), SPLITTINGS[name](0.003))
    found = simulation.probe_reversibility(60)
    assert found.is_reversible
    assert found.distance < 1e-11
    assert found.way > 0.1


@pytest.mark.parametrize("name", ["symplectic-euler-1", "ruth-3"])
def test_other_methods_do_not(name):
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), SPLITTINGS[name](0.003))
    found = simulation.probe_reversibility(60)
    assert found.is_reversible is False
    assert "NOT REVERSIBLE" in str(found)


def test_probe_restores_the_state_and_what_was_counted():
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.003))
    simulation.run(50, every=10)
    before, cost = simulation.snapshot(), simulation.report().cost
    simulation.probe_reversibility(130)
    assert np.array_equal(simulation.positions, before.positions)
    assert np.array_equal(simulation.velocities, before.velocities)
    assert (simulation.step, simulation.time) == (before.step, before.time)
    report = simulation.report()
    assert (
        replace(report.cost, peak_memory=cost.peak_memory) == cost
    )  # memory is that of the process, of all it has done
    assert "reversibility  130 steps and back" in str(report)


def test_probe_finds_forces_that_remember():
    """A force that depends on how often it was asked for has no way back."""

    class Tired:
        def __init__(self):
            self.calls = 0

        def bind(self, _system):
            return self

        def add(self, system, _detail, forces, _energies, _virials):
            self.calls += 1
            forces[0] += 1e-6 * self.calls
            forces[1] -= 1e-6 * self.calls

        def skipped(self):
            return ()

    simulation = md.Simulation(
        liquid(3), [md.LennardJones(1.0, 1.0, 1.85, "switched"), Tired()], md.VelocityVerlet(0.003)
    )
    assert simulation.probe_reversibility(60).is_reversible is False


def test_probe_of_a_long_way_says_that_it_cannot_tell():
    simulation = md.Simulation(
        liquid(3, temperature=3.0), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.005)
    )
    assert simulation.probe_reversibility(3000).is_reversible is None


@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_probe_of_an_atom_on_which_nothing_acts(speed):
    alone = md.System([[0.0, 0.0, 0.0]], velocities=[[speed, 0.0, 0.0]])
    assert (
        md.Simulation(alone, md.LennardJones(1.0, 1.0), md.VelocityVerlet(0.01)).probe_reversibility(10).is_reversible
    )


def test_minimization_and_equilibration_are_not_counted_among_the_steps_of_a_run():
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.003))
    simulation.run(50, every=10)
    cost = simulation.report().cost
    simulation.minimize(max_steps=5)
    assert (
        replace(simulation.report().cost, peak_memory=cost.peak_memory) == cost
    )  # memory is that of the process, of all it has done
    simulation.equilibrate(30, 1.0)
    assert (simulation.report().cost.n_steps, simulation.report().cost.n_evaluations) == (
        cost.n_steps,
        cost.n_evaluations,
    )


def test_probe_of_rigid_bonds_and_refusals():
    assert rigid_liquid(md.VelocityVerlet(0.002)).probe_reversibility(60).is_reversible
    bath = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85), md.LangevinBAOAB(0.003, 1.0, 1.0, seed=1))
    with pytest.raises(ValueError, match="its noise cannot be undone"):
        bath.probe_reversibility(10)
    for count in (0, 1.5, "ten"):
        with pytest.raises(ValueError, match=f"n_steps must be a whole number, at least 1; n_steps = {count!r}"):
            md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85), md.VelocityVerlet(0.003)).probe_reversibility(
                count
            )


@pytest.mark.parametrize(
    ("truncation", "energy", "force", "words", "is_good"),
    [
        ("truncated", 0.0163169, 0.0389995, "THE ENERGY JUMPS", False),
        ("shifted", 0.0, 0.0389995, "the force jumps", True),
        ("force-shifted", 0.0, 0.0, "are continuous", True),
        ("smooth", 0.0, 0.0, "are continuous", True),
    ],
)
def test_jumps_at_the_cutoff_are_told(truncation, energy, force, words, is_good):
    """4 (2.5⁻¹² − 2.5⁻⁶) ε = −0.0163 ε."""
    (line,) = cutoff_lines(liquid(2), [md.LennardJones(1.0, 1.0, 2.5, truncation)])
    assert f"energy {energy:.1e} ε, force {force:.1e} ε/σ at 2.5 σ" in line.summary.replace(f"{0.0:.1e}", f"{0.0:.1e}")
    assert words in line.verdict
    assert line.is_good == is_good


def test_a_wall_at_the_minimum_does_not_jump():
    """Weeks, Chandler, Andersen: shifted at 2^(1/6) σ, where the force is zero to rounding."""
    (line,) = cutoff_lines(liquid(2), [md.LennardJones(1.0, 1.0, 2 ** (1 / 6))])
    assert line.verdict == "energy and force are continuous"


def test_worst_of_all_pairs_of_species_is_told():
    system = md.System([[0, 0, 0], [1.2, 0, 0]], species=["A", "B"])
    (line,) = cutoff_lines(
        system, [md.LennardJones({"A": (1.0, 1.0), "B": (5.0, 1.0)}, cutoff=2.5, truncation="truncated")]
    )
    assert line.summary.startswith("energy 8.2e-02")


def test_report_tells_of_list_cutoff_and_constraints():
    simulation = rigid_liquid(md.VelocityVerlet(0.002))
    simulation.run(50, every=10)
    text = str(simulation.report())
    for words in (
        "cutoff jump",
        "list margin    skin/2",
        "rebuilt in time",
        "rigid bonds    velocities along them",
        ": obeyed",
        ": kept",
        ": conserved",
    ):
        assert words in text
    stride = np.linalg.norm(simulation.velocities, axis=1).max() * 0.002
    assert f"lasts {0.5 * simulation.skins[0] / stride:.3g} steps" in text


def test_report_tells_of_a_list_without_margin_and_of_momenta_that_change():
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.7), md.VelocityVerlet(0.004), skin=0.01)

    def wind(sim):
        sim.velocities[:, 0] += 1e-6

    simulation.run(100, every=10, observers=[wind])
    text = str(simulation.report())
    assert "rebuilt in time, but at nearly every step" in text
    assert "of the sum of |mv|: NOT CONSERVED" in text


def test_angular_momentum_has_its_verdict():
    simulation = md.Simulation(
        md.System(liquid(2, jitter=0.02).positions),
        md.LennardJones(1.0, 1.0, 2.5, "switched"),
        md.VelocityVerlet(0.002),
    )
    simulation.set_temperature(0.2, seed=3)
    simulation.run(200, every=20)
    assert simulation.report().angular_momentum_is_conserved
    assert "of the sum of m|r||v|: conserved" in str(simulation.report())

    def torque(sim):
        sim.velocities[0] += [0.0, 1e-6, 0.0]
        sim.velocities[-1] -= [0.0, 1e-6, 0.0]

    simulation.run(200, every=20, observers=[torque])
    assert simulation.report().momentum_is_conserved
    assert not simulation.report().angular_momentum_is_conserved
