"""What newcomers stumbled over."""

import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from h5md_runs import simulation
from scene_texts import SMOOTH

import minimd as md
from minimd.commands import main as cli
from minimd.diagnosis.report import conservation_report
from minimd.diagnosis.run_report import cutoff_lines
from minimd.engine.record import Record
from minimd.forces.contacts import contacts

TWO = [[0.0, 0.0, 0.0], [0.36, 0.0, 0.0]]


def test_a_scene_given_to_resume_replaces_that_of_the_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("melt.toml").write_text(SMOOTH)
    Path("slow.toml").write_text(SMOOTH.replace("timestep = 0.004", "timestep = 0.002"))
    cli.main(["run", "melt.toml", "--quiet", "--steps", "4"])
    assert cli.main(["resume", "melt.h5md", "--scene", "slow.toml", "--steps", "4"]) == 0
    told = capsys.readouterr().out
    assert "dynamics.timestep: 0.004 before, 0.002 now" in told
    assert cli.main(["resume", "melt.h5md", "--steps", "4"]) == 0
    told = capsys.readouterr().out
    assert "timestep 0.002 τ" in told
    assert "NOTE" not in told
    sim = md.Simulation.resume("melt.h5md")
    assert sim.method.timestep == 0.002
    sim.method = md.VelocityVerlet(0.001)  # in a script, beside the scene in the file
    sim.run(4, trajectory="melt.h5md", append=True)
    assert cli.main(["resume", "melt.h5md", "--steps", "4"]) == 0
    told = capsys.readouterr().out
    assert "the last steps were made with VelocityVerlet(timestep=0.001)" in told
    assert md.Simulation.resume("melt.h5md").method.timestep == 0.001


def test_other_potentials_of_a_continued_run_are_told_with_both_calls(tmp_path):
    file, made = tmp_path / "run.h5md", simulation()
    made.run(2, trajectory=file)
    with pytest.warns(UserWarning, match=r"LennardJones\(epsilon=1, .* before, .*LennardJones\(epsilon=3, .* now"):
        md.Simulation.resume(file, md.LennardJones(3.0, 1.0, 1.6, truncation="shifted"))
    with warnings.catch_warnings(action="error"):
        md.Simulation.resume(file, made.potentials)


def test_arrays_of_a_simulation_cannot_be_replaced_and_its_time_step_is_the_method_s():
    made = simulation()
    with pytest.raises(AttributeError, match=r"assign into it, sim\.positions\[:\]"):
        made.positions = np.zeros((27, 3))
    before = made.positions.copy()
    made.positions += 0.5
    assert np.array_equal(made.positions, before + 0.5)
    with pytest.raises(AttributeError, match=r"sim\.method = VelocityVerlet"):
        made.timestep = 0.001


def test_atoms_at_rest_are_no_breach_of_momentum():
    steps, tiny = np.arange(5), np.full(5, 1e-28)
    momentum = 1e-14 * np.arange(15.0).reshape(5, 3)
    series = {
        "step": steps,
        "time": 0.1 * steps,
        "potential_energy": np.full(5, -6.0),
        "kinetic_energy": tiny,
        "total_energy": np.full(5, -6.0),
    }
    series |= {"temperature": tiny, "momentum": momentum, "absolute_momentum": np.full(5, 1e-12)}
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
    from minimd.diagnosis.crash_report import bottomless_law

    law, system = md.PairPotential(bottomless, (1000.0, 0.15, 2.0), cutoff=2.5, truncation="truncated"), md.System(TWO)
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


@pytest.mark.parametrize("suffix", ["traj", "xyz", "h5md"])
def test_files_of_reduced_runs_keep_species_masses_and_velocities(tmp_path, suffix):
    from minimd.ase import system_from_file

    made, file = simulation(), tmp_path / f"run.{suffix}"
    system = md.System(
        made.positions, masses=made.system.masses, cell=3.6, species=["1", "Ar", "2"] * 9, velocities=made.velocities
    )
    sim = md.Simulation(system, made.potentials, made.method)
    sim.run(2, every=1, trajectory=file)
    read = system_from_file(file, units=md.units.LJ)
    assert read.units is md.units.LJ
    assert read.species.tolist() == ["1", "Ar", "2"] * 9
    np.testing.assert_allclose(read.masses, system.masses, rtol=1e-7)
    np.testing.assert_allclose(read.velocities, sim.velocities, atol=2e-8)
    if suffix == "h5md":
        assert system_from_file(file).units is md.units.LJ
        with pytest.raises(ValueError, match="states units = 'LJ'"):
            system_from_file(file, units=md.units.ASE)


def test_labels_that_ase_does_not_know_are_told(tmp_path):
    from minimd.ase import system_from_file

    (tmp_path / "ab.xyz").write_text("2\n\nA 0 0 0\nB 1 0 0\n")
    with pytest.raises(ValueError, match="'A' is not a chemical symbol"):
        system_from_file(tmp_path / "ab.xyz")


def test_turned_cells_and_changed_time_steps_are_told_to_users_of_mdanalysis(tmp_path):
    from minimd.mdanalysis import universe

    made = simulation("turned")
    made.run(2, every=1, trajectory=tmp_path / "turned.h5md")
    with pytest.warns(UserWarning, match="the universe of .*turned.h5md. is turned"):
        universe(tmp_path / "turned.h5md").trajectory.close()
    made = simulation()
    made.run(2, every=1, trajectory=tmp_path / "run.h5md")
    made.method = md.VelocityVerlet(0.002)
    made.run(2, every=1, trajectory=tmp_path / "run.h5md", append=True)
    with pytest.warns(UserWarning, match="because the time step changed"):
        universe(tmp_path / "run.h5md").trajectory.close()


def test_what_numba_does_not_know_is_named():
    from minimd.structure.errors import why_not_compiled

    message = "Failed in nopython mode pipeline (step: nopython frontend)\n\x1b[1mUntyped global name 'erfc':\x1b[0m Cannot determine Numba type"
    assert why_not_compiled(message) == "Untyped global name 'erfc': Cannot determine Numba type"


def test_a_calculator_and_rigid_bonds_describe_themselves():
    from minimd.ase import Calculator

    assert "do not exist" in Calculator.__init__.__doc__
    rigid = md.Simulation(
        md.System(TWO),
        md.LennardJones(1.0, 1.0, 1.6, truncation="shifted"),
        md.VelocityVerlet(0.004),
        md.DistanceConstraints([[0, 1]], 0.36),
    )
    assert repr(rigid.rigid_bonds).startswith("ConstraintSolver(1 lengths: 1 in")
