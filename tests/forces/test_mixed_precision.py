"""Mixed precision: pair arithmetic in float32 whose errors are small, do not add up, and push nobody."""

import numpy as np
import pytest
from cluster_scenes import CUTOFF, EQUAL, ONE_SPECIES, clustered, evaluated
from references import liquid
from scenes import LJ, SCENES
from wrong_calls import assert_answered

import minimd as md
from minimd.diagnosis.report import conservation_report

SINGLE = EQUAL["mixed"]
MELT = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")


@pytest.fixture(scope="module")
def melted():
    simulation = SCENES["melt"]().simulation()
    simulation.run(300)
    return simulation.system


def test_forces_in_a_melt_are_as_good_as_float32_and_push_nobody(melted):
    """Σ F = 0 to the rounding of the sum in float64, though each pair of forces in mixed precision is rounded."""
    exact, mixed = (evaluated(clustered(melted, [LJ], precision), melted) for precision in EQUAL)
    error = np.linalg.norm(mixed[0] - exact[0], axis=1)
    rms = np.sqrt((error**2).mean() / (exact[0] ** 2).sum(axis=1).mean())
    # rounding: r⁻¹⁴ of two close pairs, each r to half an ulp of float32
    assert error.max() < 0.2 * SINGLE * np.linalg.norm(exact[0], axis=1).max()
    assert 1e-9 < rms < 1e-6
    assert mixed[1].sum() == pytest.approx(exact[1].sum(), rel=1e-6)
    assert mixed[2].sum(axis=0) == pytest.approx(exact[2].sum(axis=0), rel=1e-5, abs=1e-6 * np.abs(exact[2]).sum())
    for forces in (exact[0], mixed[0]):
        assert np.abs(forces.sum(axis=0)).max() < 1e-14 * np.abs(forces).sum()
    # only what the pairs push all atoms is taken out, not what was there before
    before = np.random.default_rng(1).normal(1.0, 1.0, melted.positions.shape)
    forces = before.copy()
    clustered(melted, [LJ], "mixed").add(melted, 0, forces, np.zeros(len(melted)), np.zeros((len(melted), 6)))
    assert forces.sum(axis=0) == pytest.approx(before.sum(axis=0), abs=1e-14 * np.abs(forces).sum())


@pytest.mark.slow
@pytest.mark.parametrize(("n_steps", "every"), [(1500, 5), (20_000, 10)])
def test_energy_drifts_no_more_than_in_double(melted, n_steps, every):
    """Statistics: four standard errors of the difference. The oscillation differs by 5 % between runs."""
    start, reports = md.Simulation(melted, MELT, md.VelocityVerlet(0.004)), []
    start.run(700)
    for precision in EQUAL:
        simulation = md.Simulation(start.system, MELT, md.VelocityVerlet(0.004), precision=precision)
        reports.append(conservation_report(simulation.run(n_steps, every=every), angular=False))
        slope = reports[-1].energy_drift
        print(f"{precision}: {slope.slope:+.1e} ± {slope.error:.1e}, oscillation {reports[-1].energy_oscillation:.2e}")
    double, mixed = reports
    error = np.hypot(double.energy_drift.error, mixed.energy_drift.error)
    assert abs(double.energy_drift.slope - mixed.energy_drift.slope) < 4.0 * error
    assert mixed.energy_oscillation == pytest.approx(double.energy_oscillation, rel=0.2)


def test_a_scene_too_wide_for_the_grid_is_refused():
    """The grid has 2³² points across the scene; 2000 cutoffs wide, they are a millionth of a cutoff apart."""
    places = np.random.default_rng(1).uniform(0, 1, (200, 3))
    fits, wide = (md.System(width * places, cell=width) for width in (1000.0 * CUTOFF, 2300.0 * CUTOFF))
    assert not evaluated(clustered(fits, ONE_SPECIES, "mixed"), fits)[0].any()
    assert not evaluated(clustered(wide, ONE_SPECIES), wide)[0].any()
    assert_answered(lambda: evaluated(clustered(wide, ONE_SPECIES, "mixed"), wide), ValueError, "precision", "mixed")


FAR = [("double", 1e-9, True), ("mixed", SINGLE, True), ("mixed", SINGLE, False)]


@pytest.mark.parametrize(("precision", "tolerance", "has_cell"), FAR)
def test_atoms_far_from_the_origin_feel_the_same(precision, tolerance, has_cell):
    """Thousands of cells away, or all together in open space: far coordinates are rounded."""
    near = liquid(4)
    moves = np.random.default_rng(2).integers(-4096, 4097, near.positions.shape) @ near.cell.vectors
    cell = near.cell if has_cell else None
    near, far = (md.System(near.positions + move, cell=cell) for move in (0.0, moves if has_cell else 1e6))
    a, b = (evaluated(clustered(system, ONE_SPECIES, precision), system) for system in (near, far))
    assert b[0] == pytest.approx(a[0], abs=tolerance * np.abs(a[0]).max(), rel=0)
    assert b[1].sum() == pytest.approx(a[1].sum(), rel=1e-6)
