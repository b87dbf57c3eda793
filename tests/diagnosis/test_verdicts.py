"""What a report says of a run beside its drift: a time step that is too long, a start out of equilibrium."""

from dataclasses import replace

import pytest
from scenes import Scene

import minimd as md
from minimd.analysis.check import check_file


def test_the_verdict_says_that_the_time_step_is_too_long(tmp_path, argon):
    """Whether the energy drifts or not; in a file too."""
    made, file = argon.simulation(md.VelocityVerlet(0.02)), tmp_path / "run.h5md"
    with pytest.warns(UserWarning, match=r"timestep 0.02 τ .*advise_timestep"):
        record = made.run(20, every=1, trajectory=file)
    report = made.report()
    assert "timestep 0.02 τ" in report.verdict
    assert "timestep 0.02 τ" in check_file(file).report.verdict
    drift = report.energy_drift
    still = replace(report, energy_drift=replace(drift, slope=0.0), energy_range=0.0).verdict
    assert still.startswith("the total energy does not drift, BUT timestep 0.02 τ")
    falling = replace(report, energy_drift=replace(drift, slope=-1.0, error=1e-3, is_unsure=False)).verdict
    assert falling.startswith("THE TOTAL ENERGY DRIFTS: timestep 0.02 τ")
    made.method = md.VelocityVerlet(0.002)
    assert "timestep" not in made.report().verdict
    assert len(record) == 21


def test_a_start_out_of_equilibrium_is_told_beside_a_drift():
    positions, edges = md.lattice.crystal("fcc", [4, 4, 4], 1.68)
    law = md.LennardJones(1.0, 1.0, 2.5, "truncated")
    run = Scene(md.System(positions, cell=edges), [law], timestep=0.02).simulation()
    run.set_temperature(2.0, seed=1)
    run.run(100, every=1)
    report = run.report()
    assert report.is_settling
    assert report.temperatures[0] > 1.1 * report.temperatures[1]
    assert not report.energy_is_conserved
    assert "the temperature went from" in report.verdict
    assert "equilibrate first" in report.verdict


def test_rigid_pairs_are_no_overlap_at_the_start():
    """Dumbbells of an atom and a light one without a well, thrown at each other: their lengths are not the cause."""
    positions, pairs = [[0.0, 0, 0], [0.3, 0, 0], [1.6, 0, 0], [1.9, 0, 0]], [[0, 1], [2, 3]]
    velocities = [[0, 0, 0], [0, 0, 0], [-90.0, 0, 0], [-90.0, 0, 0]]
    system = md.System(positions, species=["A", "B", "A", "B"], velocities=velocities)
    law = md.LennardJones({"A": (1.0, 1.0), "B": (0.0, 1.0)}, cutoff=2.5)
    with pytest.raises((md.NonFiniteError, md.ConstraintError)) as caught:
        md.Simulation(system, law, md.VelocityVerlet(0.01), md.DistanceConstraints(pairs)).run(100)
    assert "Likely cause" in str(caught.value)
    assert "overlap at the start" not in str(caught.value)
