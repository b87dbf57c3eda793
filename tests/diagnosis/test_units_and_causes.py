"""What is said of a run and of its failure is right: units, causes, momentum at rest, cutoffs, other potentials."""

import re
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from h5md_runs import simulation
from references import liquid
from wrong_calls import assert_answered

import minimd as md
from minimd.analysis.check import liquid as lines_of
from minimd.diagnosis.crash_report import bottomless_law
from minimd.diagnosis.report import conservation_report
from minimd.diagnosis.run_report import cutoff_lines
from minimd.engine.record import Record
from minimd.forces.contacts import contacts
from minimd.mdanalysis import universe

TWO = [[0.0, 0.0, 0.0], [0.36, 0.0, 0.0]]
LJ = md.LennardJones(1.0, 1.0, 1.85, "switched")


@pytest.mark.filterwarnings("ignore:timestep")
def test_times_and_lengths_of_a_replay_have_units(tmp_path):
    system = md.System([[0, 0, 0], [1.12, 0, 0]], masses=14.0, bonds=[[0, 1]], units=md.units.ASE, cell=20.0)
    sim = md.Simulation(system, md.HarmonicBond(100.0, 1.1), md.VelocityVerlet(2.0004 * (0.07**0.5)))
    file = tmp_path / "a.crash.h5md"
    with pytest.raises(md.NonFiniteError) as caught:
        sim.run(3000, crash_report=file)
    assert re.search(r"atoms 0 and 1, \S+ Å apart", str(caught.value))
    assert "eV/Å on atom" in str(caught.value.crash_report)
    seen = md.replay(file, sim.potentials)
    lines = str(seen).splitlines()
    last = next(line for line in lines if line.startswith(f"{sim.step:>8}"))
    assert lines[1].split() == ["ps", "eV", "Å", "eV/Å", "Å/ps"]
    assert float(last.split()[1]) == pytest.approx(sim.step * sim.method.timestep / md.units.ps, rel=1e-4)
    assert np.isfinite(seen.rows[-1].energy)
    assert "/ ps, period" in str(md.advise_timestep(system, sim.potentials))
    assert_answered(lambda: md.replay(file, sim.potentials), FileExistsError, "--overwrite")
    assert_answered(lambda: md.replay(file, overwrite=True), ValueError, "minimd.replay(file, [...])", "--scene")


def test_atoms_at_rest_are_no_breach_of_momentum():
    tiny, potential = np.full(5, 1e-28), np.full(5, -6.0)
    series = {"step": np.arange(5), "time": 0.1 * np.arange(5), "potential_energy": potential, "temperature": tiny}
    series |= {"kinetic_energy": tiny, "total_energy": potential, "absolute_momentum": np.full(5, 1e-12)}
    series |= {"momentum": 1e-14 * np.arange(15.0).reshape(5, 3)}
    report = conservation_report(Record.of(md.units.LJ, 4, series), angular=False)
    assert report.momentum_is_conserved
    assert "NOT CONSERVED" not in str(report)
    assert "the atoms are at rest: set_temperature" in report.verdict
    warm = conservation_report(Record.of(md.units.LJ, 4, series | {"kinetic_energy": np.ones(5)}), angular=False)
    assert not warm.momentum_is_conserved


def bottomless(r2, a, rho, c):
    r, i6 = r2**0.5, 1.0 / r2**3
    pushes = a * np.exp(-r / rho)
    return pushes - c * i6, pushes / (rho * r) - 6.0 * c * i6 / r2


def test_a_law_without_a_bottom_is_named():
    law = md.PairPotential(bottomless, (1000.0, 0.15, 2.0), cutoff=2.5, truncation="truncated")
    system = md.System(TWO)
    (pair,) = contacts(system, [law], np.ones(2), [0])
    verdict = bottomless_law(SimpleNamespace(strongest=pair, system=system))
    assert "u = -828 ε there" in verdict.cause
    assert "repulsive core" in verdict.advice
    (apart,) = contacts(md.System([[0.0, 0, 0], [1.5, 0, 0]]), [md.LennardJones(1.0, 1.0, 2.5)], np.ones(2), [0])
    assert apart.force < 0.0
    assert bottomless_law(SimpleNamespace(strongest=apart, system=system)) is None


def test_the_jump_at_the_cutoff_names_the_cutoff_of_the_worst_pair():
    own, cutoffs = {"A": (1.0, 1.0), "B": (0.5, 0.88)}, {("A", "A"): 2.5, ("A", "B"): 2.0, ("B", "B"): 2.2}
    mixture = md.LennardJones(own, cutoff=cutoffs, pairs={("A", "B"): (1.5, 0.8)}, truncation="truncated")
    (line,) = cutoff_lines(md.System(TWO, species=["A", "B"]), [mixture])
    assert line.summary.endswith("ε/σ at 2 σ")


def test_diffusion_of_langevin_dynamics_is_called_that(tmp_path):
    start = liquid(3)
    for method, told in ((md.LangevinBAOAB(0.004, 3.0, 0.1, seed=1), True), (md.VelocityVerlet(0.004), False)):
        sim = md.Simulation(md.System(start.positions, cell=start.cell), LJ, method)
        sim.set_temperature(3.0, seed=1)
        sim.run(1000, every=10, trajectory=tmp_path / "a.h5md", overwrite=True)
        (found,) = [line for line in lines_of(tmp_path / "a.h5md") if line.startswith("diffusion")]
        assert ("of Langevin dynamics" in found) is told


def test_other_potentials_of_a_continued_run_are_told_with_both_calls(tmp_path):
    file, made = tmp_path / "run.h5md", simulation()
    made.run(2, trajectory=file)
    with pytest.warns(UserWarning, match=r"LennardJones\(epsilon=1, .* before, .*LennardJones\(epsilon=3, .* now"):
        md.Simulation.resume(file, md.LennardJones(3.0, 1.0, 1.6, truncation="shifted"))
    with warnings.catch_warnings(action="error"):
        md.Simulation.resume(file, made.potentials)


def test_turned_cells_and_changed_time_steps_are_told_to_users_of_mdanalysis(tmp_path):
    simulation("turned").run(2, every=1, trajectory=tmp_path / "turned.h5md")
    with pytest.warns(UserWarning, match=r"the universe of .*turned\.h5md. is turned"):
        universe(tmp_path / "turned.h5md").trajectory.close()
    made = simulation()
    made.run(2, every=1, trajectory=tmp_path / "run.h5md")
    made.method = md.VelocityVerlet(0.002)
    made.run(2, every=1, trajectory=tmp_path / "run.h5md", append=True)
    with pytest.warns(UserWarning, match="because the time step changed"):
        universe(tmp_path / "run.h5md").trajectory.close()
