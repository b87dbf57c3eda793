"""Mixed precision: pair arithmetic in float32 whose errors are small, do not add up, and push nobody."""

import numpy as np
import pytest
from cluster_scenes import CUTOFF, SMOOTH, atoms_per_domain, deviations, evaluated, pair_laws, rod, scenes
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from references import liquid, melt

import minimd as md
from minimd.diagnosis.report import conservation_report
from minimd.forces.cluster_term import ClusterTerm
from minimd.forces.options import Options
from minimd.forces.pair_list_term import PairListTerm

SINGLE = 1e-5  # of the largest force: rounding of r and of r⁻¹⁴ in float32
WIDE = 300.0  # the grid of the coordinates is then 1.4e-7 fine, as float32 near 1
MELT = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")


def clustered(system, potentials, precision="mixed", threads=2, skin=0.3):
    return ClusterTerm(system, pair_laws(system, potentials), Options(threads, precision, skin))


def hot_melt(n_steps=100):
    simulation = md.Simulation(melt(), MELT, md.VelocityVerlet(0.004))
    simulation.run(n_steps)
    return simulation.system


@pytest.fixture(scope="module")
def liquid_melt():
    return hot_melt(1000)


@pytest.mark.parametrize("name", SMOOTH)
@given(system=scenes(sizes=[2, 8, 9, 120, 400, 2000], densities=[0.05, 0.3, 1.0]), atoms=st.sampled_from([5, 800]))
@settings(max_examples=25)
def test_mixed_precision_is_the_same_physics(name, system, atoms):
    assume(np.linalg.norm(system.cell.vectors, axis=1).max() < WIDE)
    with atoms_per_domain(atoms):
        listed = PairListTerm(system, pair_laws(system, SMOOTH[name]), Options(skin=0.0))
        assert max(deviations(clustered(system, SMOOTH[name]), listed, system)) < SINGLE


def test_forces_in_a_melt_are_as_good_as_float32(liquid_melt):
    exact = evaluated(clustered(liquid_melt, [MELT], "double"), liquid_melt)
    mixed = evaluated(clustered(liquid_melt, [MELT]), liquid_melt)
    error = np.linalg.norm(mixed[0] - exact[0], axis=1)
    largest = np.linalg.norm(exact[0], axis=1).max()
    rms = np.sqrt((error**2).mean() / (exact[0] ** 2).sum(axis=1).mean())
    print(f"worst {error.max() / largest:.1e} of the largest force, rms {rms:.1e} of the rms force")
    assert (
        error.max() < 0.2 * SINGLE * largest
    )  # rounding: r⁻¹⁴ of two close pairs, each distance to half an ulp of float32
    assert rms < 1e-6
    assert mixed[1].sum() == pytest.approx(exact[1].sum(), rel=1e-6)
    assert mixed[2].sum(axis=0) == pytest.approx(exact[2].sum(axis=0), rel=1e-5, abs=1e-6 * np.abs(exact[2]).sum())


@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_pairs_push_nobody(liquid_melt, precision):
    """Σ F = 0 to the rounding of the sum in float64, though each pair of forces in mixed precision is rounded to float32."""
    forces = evaluated(clustered(liquid_melt, [MELT], precision), liquid_melt)[0]
    assert np.abs(forces.sum(axis=0)).max() < 1e-14 * np.abs(forces).sum()


def test_the_net_force_of_other_terms_stays(liquid_melt):
    """Only what the pairs push all atoms is taken out, not what was there before."""
    before = np.random.default_rng(1).normal(1.0, 1.0, liquid_melt.positions.shape)
    forces, zeros = before.copy(), (np.zeros(len(liquid_melt)), np.zeros((len(liquid_melt), 6)))
    clustered(liquid_melt, [MELT]).add(liquid_melt, 0, forces, *zeros)
    assert forces.sum(axis=0) == pytest.approx(before.sum(axis=0), abs=1e-14 * np.abs(forces).sum())


@pytest.mark.parametrize("masses", [False, True])
def test_momentum_is_conserved_as_in_double(masses):
    changes = []
    for precision in ("double", "mixed"):
        start = rod(24, 4)
        weights = np.where(start.species_index == 0, 1.0, 20.0) if masses else None
        system = md.System(start.positions, cell=start.cell, species=start.species, masses=weights)
        simulation = md.Simulation(system, SMOOTH["three species"], md.VelocityVerlet(0.002), precision=precision)
        simulation.set_temperature(1.5, 3)
        record = simulation.run(1000, every=50)
        assert simulation.report().momentum_is_conserved
        changes.append(conservation_report(record, angular=False).momentum_change)
    print(f"momentum changes by {changes[0]:.1e} in double, {changes[1]:.1e} in mixed precision")
    assert max(changes) < 1e-14


def drifts(system, n_steps, every):
    reports = []
    for precision in ("double", "mixed"):
        simulation = md.Simulation(system, MELT, md.VelocityVerlet(0.004), precision=precision)
        reports.append(conservation_report(simulation.run(n_steps, every=every), angular=False))
    for name, report in zip(("double", "mixed"), reports, strict=True):
        slope = report.energy_drift
        print(f"{name}: drift {slope.slope:+.1e} ± {slope.error:.1e}, oscillation {report.energy_oscillation:.2e}")
    return reports


def assert_same_drift(double, mixed):
    """Statistics: four standard errors of the difference. The oscillation is that of the method; from run to run it differs by some 5 %."""
    error = np.hypot(double.energy_drift.error, mixed.energy_drift.error)
    assert abs(double.energy_drift.slope - mixed.energy_drift.slope) < 4.0 * error
    assert mixed.energy_oscillation == pytest.approx(double.energy_oscillation, rel=0.2)


@pytest.mark.slow
def test_energy_drifts_no_more_than_in_double(liquid_melt):
    assert_same_drift(*drifts(liquid_melt, 1500, 5))


@pytest.mark.slow
def test_energy_drifts_no_more_than_in_double_in_a_long_run(liquid_melt):
    assert_same_drift(*drifts(liquid_melt, 20_000, 10))


def test_a_scene_too_wide_for_the_grid_is_refused():
    """The grid has 2³² points across the scene; 2000 cutoffs wide, they are a millionth of a cutoff apart."""
    rng = np.random.default_rng(1)
    for width, fits in ((1000.0 * CUTOFF, True), (2300.0 * CUTOFF, False)):
        system = md.System(rng.uniform(0, width, (200, 3)), cell=width)
        if fits:
            assert not evaluated(clustered(system, SMOOTH["one species"]), system)[0].any()
            continue
        with pytest.raises(
            ValueError,
            match=r"precision='mixed' resolves .* in a scene .* wide, coarser than .*; take precision='double'",
        ):
            evaluated(clustered(system, SMOOTH["one species"]), system)
        assert evaluated(clustered(system, SMOOTH["one species"], "double"), system)[0] is not None


@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_atoms_thousands_of_cells_away_feel_the_same(precision):
    near = liquid(5)
    far = near.copy()
    far.positions += np.random.default_rng(2).integers(-4096, 4097, far.positions.shape) @ near.cell.vectors
    a, b = (evaluated(clustered(system, [MELT], precision), system) for system in (near, far))
    assert b[0] == pytest.approx(
        a[0], abs=(1e-9 if precision == "double" else SINGLE) * np.abs(a[0]).max(), rel=0
    )  # far coordinates are rounded
    assert b[1].sum() == pytest.approx(a[1].sum(), rel=1e-6)


def test_atoms_far_from_the_origin_without_a_cell_feel_the_same():
    near = md.System(liquid(5).positions)
    far = md.System(near.positions + 1e6)
    a, b = (evaluated(clustered(system, [MELT]), system) for system in (near, far))
    assert b[0] == pytest.approx(a[0], abs=SINGLE * np.abs(a[0]).max(), rel=0)


def test_parameters_of_species_are_those_of_double():
    """Tables are rounded to float32 once; cutoffs of pairs of species stay their own."""
    system = rod(12, 3)
    for name in ("three species", "exclusions"):
        a, b = (evaluated(clustered(system, SMOOTH[name], precision), system)[0] for precision in ("double", "mixed"))
        assert np.abs(a - b).max() < SINGLE * np.abs(a).max()
        assert not np.array_equal(a, b)
