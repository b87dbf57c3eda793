"""The scenes of the benchmark are those whose names they carry; run time against error: fronts, advice, errors."""

import numpy as np
import pytest

import minimd as md
from minimd.bench import engines, scenes, work_precision
from minimd.bench.work_precision import about_line


def test_scene_is_the_one_that_lammps_calls_melt():
    scene = scenes.melt(5)
    assert 500 / scene.system.volume == pytest.approx(0.8442, rel=1e-12)
    assert (scene.system.velocities**2).sum() / (3 * len(scene.system) - 3) == pytest.approx(1.44, rel=1e-12)
    assert engines.Minimd(scene).potential_energy() == pytest.approx(-6.7733681 * 500, rel=1e-7)


def test_mixture_is_that_of_kob_and_andersen():
    scene = scenes.kob_andersen(5)
    assert 500 / scene.system.volume == pytest.approx(1.2, rel=1e-12)
    assert (scene.system.species == "B").sum() == 100
    shift = 4.0 * (2.5**-12 - 2.5**-6)
    for pair, (epsilon, sigma) in {("A", "A"): (1.0, 1.0), ("A", "B"): (1.5, 0.8), ("B", "B"): (0.5, 0.88)}.items():
        assert scene.cutoffs[pair] == pytest.approx(2.5 * sigma)
        energies = scene.potentials[0].pair_energy([sigma, 2.0 ** (1 / 6) * sigma], *pair)
        assert energies == pytest.approx([-epsilon * shift, -epsilon * (1.0 + shift)])


def test_chains_are_whole_and_apart():
    system = scenes.chains(5).system
    assert (len(system), len(system.bonds)) == (500, 5 * 99)
    assert 500 / system.volume == pytest.approx(0.85, rel=1e-12)
    spacing = np.linalg.norm(system.positions[system.bonds[:, 1]] - system.positions[system.bonds[:, 0]], axis=1)
    assert np.ptp(spacing) < 1e-12
    assert md.neighbor_list("d", system, 2.5).min() == pytest.approx(spacing[0])


@pytest.mark.parametrize("name", scenes.SCENES)
def test_pairs_in_range_are_those_of_the_neighbor_list(name):
    scene = scenes.SCENES[name](4)
    scene.system.positions[:] += np.random.default_rng(1).normal(0.0, 0.05, scene.system.positions.shape)
    i, j, d = md.neighbor_list("ijd", scene.system, 2.5)
    species = scene.system.species
    expected = -len(scene.system.bonds)
    for (a, b), cutoff in scene.cutoffs.items():
        together = (species[i] == a) & (species[j] == b) & (d < cutoff)
        expected += together.sum() // 2 if a == b else together.sum()
    assert scenes.pairs_in_range(scene, scene.system.positions) == expected


def test_the_front_of_work_precision_is_what_nothing_beats():
    point = lambda who, *seen: work_precision.Point(who, "verlet", 2, 0.01, 100.0, *seen, 0.0, np.nan)  # noqa: E731
    ours = [point("minimd", *one) for one in ((1.0, 1e-2), (2.0, 1e-3), (3.0, 2e-3), (0.5, np.inf))]
    case = work_precision.Case("case", "text", "τ", [*ours, point("peer", 6.0, 1e-3), point("peer", 3.0, 2e-2)])
    assert case.front("oscillation") == ours[:2]
    assert case.advice("oscillation")[1:] == [
        "for oscillation 1e-02 use verlet, Δt = 0.01 τ, minimd: 1 s",
        "for oscillation 1e-03 use verlet, Δt = 0.01 τ, minimd: 2 s",
    ]
    assert case.beside() == ["peer: 3.00 times the time of minimd at equal oscillation (3.00 to 3.00)"]


def test_a_run_that_fails_has_no_finite_error():
    """Not even the distance, which was measured in a run that was shorter."""
    engine = type("Engine", (), {"run": lambda *_: 1 // 0})
    point = work_precision._point("minimd", scenes.SCENES["melt"](3), md.VelocityVerlet, 20, engine, 2, 1e-3)
    assert (point.seconds, point.oscillation, point.drift, point.distance) == (np.inf,) * 4


def test_errors_are_about_the_line_of_regression():
    time = np.linspace(0.0, 1.0, 41)
    energies = 3.0 + 0.5 * time + 0.1 * np.tile([1.0, -1.0], 21)[:41]
    assert about_line(time, energies) == pytest.approx((0.1, 0.5), rel=1e-2)
    assert about_line(np.array([0.0, 1.0]), np.array([1.0, np.nan])) == (np.inf, np.inf)


@pytest.mark.slow
def test_work_precision_of_minimd_falls_with_the_order_of_the_method(monkeypatch):
    """Errors of velocity Verlet with a few atoms, and of its paths, fall with the square of the time step."""
    settings = {"CELLS_QUICK": 4, "COSTS_QUICK": (100, 200, 400), "QUICK_METHODS": ("velocity-verlet",)}
    for name, value in {**settings, "PEER_NAMES": ()}.items():
        monkeypatch.setattr(work_precision, name, value)
    (case,) = work_precision.run_work_precision(["argon-smooth"], True, 1).cases
    exact = [p for p in case.points if p.who == "minimd, double"]
    assert np.diff(np.log2([p.distance for p in exact])) == pytest.approx([-2.0, -2.0], abs=0.2)
    assert 8.0 < exact[0].oscillation / exact[2].oscillation < 32.0  # seen at twenty moments only
    assert [p.forces for p in exact] == pytest.approx([100, 200, 400])


@pytest.mark.slow
def test_kepler_of_work_precision_counts_forces():
    runs = {name: rest for name, *rest in work_precision.kepler_runs((400,), 1)}
    assert len(runs) == 18
    order, timestep, forces, _, oscillation, _, distance = runs["velocity-verlet"]
    assert (order, forces * timestep) == (2, pytest.approx(1.0, rel=1e-2))
    assert oscillation < 1e-2
    assert runs["blanes-moan-rkn-4"][-1] < 0.1 * distance
