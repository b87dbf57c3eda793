"""The scenes of the benchmark are the ones whose names they carry."""

import numpy as np
import pytest

import minimd as md
from minimd.bench import engines, scenes


def test_scene_is_the_one_that_lammps_calls_melt():
    scene = scenes.melt(5)
    assert len(scene.system) / scene.system.volume == pytest.approx(0.8442, rel=1e-12)
    assert (scene.system.velocities**2).sum() / (3 * len(scene.system) - 3) == pytest.approx(1.44, rel=1e-12)
    assert engines.Minimd(scene).potential_energy() == pytest.approx(-6.7733681 * 500, rel=1e-7)


def test_mixture_is_that_of_kob_and_andersen():
    scene = scenes.kob_andersen(5)
    assert len(scene.system) / scene.system.volume == pytest.approx(1.2, rel=1e-12)
    assert (scene.system.species == "B").sum() == 100
    sizes = {
        pair: scene.potentials[0].pair_energy([cutoff / 2.5, 2.0 ** (1 / 6) * cutoff / 2.5], *pair)
        for pair, cutoff in scene.cutoffs.items()
    }
    for pair, (epsilon, sigma) in {("A", "A"): (1.0, 1.0), ("A", "B"): (1.5, 0.8), ("B", "B"): (0.5, 0.88)}.items():
        assert scene.cutoffs[pair] == pytest.approx(2.5 * sigma)
        shift = 4.0 * epsilon * (2.5**-12 - 2.5**-6)
        assert sizes[pair] == pytest.approx([-shift, -epsilon - shift])


def test_chains_are_whole_and_apart():
    scene = scenes.chains(5)
    system = scene.system
    assert len(system) == 500
    assert len(system) / system.volume == pytest.approx(0.85, rel=1e-12)
    assert len(system.bonds) == 5 * 99
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
