"""The cluster list does what the pair list does: same forces, energies and virial, in any cell that is large enough."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from references import liquid, melt

import minimd as md
from minimd.cell import Cell
from minimd.clustered import ClusteredPairs
from minimd.options import Options
from minimd.pair_laws import PairLaws
from minimd.potentials.cluster_loop import BLOCK
from minimd.potentials.pair_loop import FORCES, TOTALS
from minimd.terms import ListedPairs

CUTOFF, SKIN = 2.0, 0.3
SKINNED, BARE = Options(skin=SKIN, threads=2), Options(skin=0.0)
EQUAL = 1e-13  # rounding: sums in another order


def soft(r2, height):
    return height * np.exp(-r2), 2.0 * height * np.exp(-r2)


def branching(r2, height):
    return (height, 0.0) if r2 < 1.0 else (height / r2, 2.0 * height / r2**2)


KINDS = {"A": (1.0, 1.0), "B": (0.5, 0.88), "C": (0.2, 1.2)}
CUTOFFS = {(a, b): 1.5 + 0.1 * k for k, (a, b) in enumerate(["AA", "AB", "AC", "BB", "BC", "CC"])}
POTENTIALS = {
    "one species": [md.LennardJones(1.0, 1.0, CUTOFF, "force-shifted")],
    "three species": [md.LennardJones(KINDS, cutoff=CUTOFF, truncation="switched")],
    "cutoffs by pair": [md.LennardJones({"A": (1, 1), "B": (0.5, 0.9), "C": (1, 1)}, cutoff=CUTOFFS)],
    "exclusions": [md.LennardJones(KINDS, cutoff=CUTOFF, bonded_scale=(0.0, 0.3, 0.8))],
    "two laws": [md.LennardJones(1.0, 1.0, 1.6), md.PairPotential(soft, (3.0,), CUTOFF)],
}


@st.composite
def scenes(draw):
    """Atoms on a jittered lattice or a gas, with gaps, in a triclinic cell at least as high as the list reaches; chains of bonds."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.sampled_from([2, 3, 7, 8, 9, 30, 120, 400, 1500]))
    density = draw(st.sampled_from([0.01, 0.3, 1.0]))
    edge = max((n / density) ** (1 / 3), 1.3 * (CUTOFF + SKIN))
    cell = np.eye(3) * edge * rng.uniform(0.9, 1.3, 3) + draw(st.sampled_from([0.0, 0.25])) * edge * rng.uniform(-1, 1, (3, 3))
    pbc = np.array(draw(st.tuples(st.booleans(), st.booleans(), st.booleans())))
    checked = Cell.of(cell, pbc)
    assume(np.all(checked.heights[pbc] >= CUTOFF + SKIN))
    grid = int(np.ceil(n ** (1 / 3)))
    sites = np.stack(np.meshgrid(*[np.arange(grid)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    chosen = np.sort(rng.permutation(len(sites))[:n])
    positions = ((sites[chosen] + 0.5 + 0.15 * rng.uniform(-1, 1, (n, 3))) / grid) @ cell + rng.integers(-2, 3, (n, 3)) @ cell
    positions = positions if pbc.all() else ((sites[chosen] + 0.5 + 0.15 * rng.uniform(-1, 1, (n, 3))) / grid) @ cell
    bonds = [[k, k + 1] for k in range(n - 1) if k % 5]
    return md.System(positions, cell=checked, species=rng.choice(["A", "B", "C"], n), bonds=bonds)


def summed(term, system, detail=TOTALS):
    forces, energies, virials = np.zeros((len(system), 3)), np.zeros(len(system)), np.zeros((len(system), 6))
    term.add(system, detail, forces, energies, virials)
    return forces, energies.sum(), virials.sum(axis=0)


def agree(clustered, listed, system):
    a, b = summed(clustered, system), summed(listed, system)
    for got, expected in zip(a, b, strict=True):
        assert np.abs(got - expected).max() <= EQUAL * max(1.0, np.abs(b[0]).max(), np.abs(expected).max())
    assert np.array_equal(summed(clustered, system, FORCES)[0], a[0])


@pytest.mark.parametrize("name", POTENTIALS)
@given(system=scenes(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_clusters_and_pairs_are_the_same_physics(name, system, seed):
    laws = PairLaws(system, POTENTIALS[name])
    clustered, listed = ClusteredPairs(system, laws, SKINNED), ListedPairs(system, laws, BARE)
    agree(clustered, listed, system)
    rng = np.random.default_rng(seed)
    step = rng.normal(size=system.positions.shape)
    system.positions += 0.499 * SKIN * step / np.linalg.norm(step, axis=1, keepdims=True)
    agree(clustered, listed, system)
    assert clustered.list.n_builds == (1 if clustered.list.skin > 0.0 else 2)
    moved = rng.random(len(system)) < 0.3
    system.positions[moved] += (rng.integers(-2, 3, (moved.sum(), 3)) * system.cell.pbc) @ system.cell.vectors
    agree(clustered, listed, system)


@pytest.mark.parametrize("size", [5, 9])
def test_a_crystal_exactly_on_its_faces_has_no_forces(size):
    sites = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * 1.1
    system = md.System(sites, cell=1.1 * size)
    forces, energy, _ = summed(ClusteredPairs(system, PairLaws(system, POTENTIALS["one species"]), SKINNED), system)
    assert np.abs(forces).max() < 1e-12
    assert energy == pytest.approx(md.evaluate(system, POTENTIALS["one species"]).potential_energy, rel=1e-12)


def test_list_serves_growing_and_shrinking_crowds():
    system = md.System(np.random.default_rng(1).uniform(0, 40, (600, 3)), cell=40.0)
    laws = PairLaws(system, POTENTIALS["two laws"][1:])
    clustered, listed = ClusteredPairs(system, laws, SKINNED), ListedPairs(system, laws, BARE)
    for spread in (40.0, 4.0, 40.0, 1.0, 20.0):
        system.positions[:] = np.random.default_rng(2).uniform(0, spread, (600, 3))
        a, b = summed(clustered, system), summed(listed, system)
        assert a[1] == pytest.approx(b[1], rel=1e-12)
        assert a[0] == pytest.approx(b[0], rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("pbc", [True, (True, True, False), False])
def test_memory_follows_the_number_of_clusters(pbc):
    """Column by column the padding changes from build to build, and with it the number of clusters and ghosts."""
    rng = np.random.default_rng(4)
    system = md.System(rng.uniform(0, 4.4, (64, 3)), cell=4.4, pbc=pbc)
    laws = PairLaws(system, POTENTIALS["two laws"][1:])
    clustered, listed = ClusteredPairs(system, laws, SKINNED), ListedPairs(system, laws, BARE)
    numbers = set()
    for _ in range(60):
        system.positions[:] = rng.uniform(0, 4.4, (64, 3)) * rng.uniform(0.3, 1.0, 3)
        a, b = summed(clustered, system), summed(listed, system)
        assert a[0] == pytest.approx(b[0], rel=1e-11, abs=1e-11)
        memory, needed = clustered.list.memory, len(clustered.list.copies.owner) * BLOCK
        assert (len(memory.coordinates), len(memory.forces)) == (needed, needed)
        numbers.add(needed)
    assert len(numbers) > 1


def test_excluded_pairs_may_sit_on_each_other_in_clusters_too():
    system = liquid(5)
    system.positions[1] = system.positions[0]
    bonded = md.System(system.positions, cell=system.cell, bonds=[[0, 1]])
    laws = PairLaws(bonded, [md.LennardJones(1.0, 1.0, 2.5, bonded_scale=(0, 1, 1))])
    agree(ClusteredPairs(bonded, laws, SKINNED), ListedPairs(bonded, laws, BARE), bonded)


def test_rule_which_list_a_scene_gets():
    def kind(system, potential, **options):
        return type(md.Simulation(system, potential, md.VelocityVerlet(0.001), **options)._forces.terms[0]).__name__

    assert kind(liquid(5), md.LennardJones(1.0, 1.0, 2.5)) == "ClusteredPairs"
    assert kind(liquid(2), md.LennardJones(1.0, 1.0, 1.2)) == "ListedPairs"  # few atoms
    assert kind(liquid(5), md.LennardJones(1.0, 1.0, 8.4)) == "ListedPairs"  # cell too small
    assert kind(liquid(5), md.PairPotential(soft, (1.0,), 2.5)) == "ClusteredPairs"
    assert kind(liquid(5), md.PairPotential(branching, (1.0,), 2.5)) == "ListedPairs"  # cannot run on vectors
    assert kind(md.System(liquid(5).positions), md.LennardJones(1.0, 1.0)) == "ListedPairs"  # no cutoff


def test_report_tells_which_list_a_scene_got():
    for cutoff, words in ((2.5, "cluster list (skin"), (8.4, "pair list (skin")):
        simulation = md.Simulation(liquid(5), md.LennardJones(1.0, 1.0, cutoff), md.VelocityVerlet(0.001))
        simulation.run(5, every=1)
        assert words in str(simulation.report())


def test_dynamics_on_clusters_is_that_of_pairs(monkeypatch):
    potential = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")
    clustered = md.Simulation(liquid(6), potential, md.VelocityVerlet(0.004))
    monkeypatch.setattr(PairLaws, "fit_clusters", lambda *_: False)
    listed = md.Simulation(liquid(6), potential, md.VelocityVerlet(0.004))
    a, b = (simulation.run(100, every=20) for simulation in (clustered, listed))
    assert clustered.positions == pytest.approx(listed.positions, abs=1e-10)
    assert a.total_energy == pytest.approx(b.total_energy, rel=1e-12)
    assert a.pressure == pytest.approx(b.pressure, rel=1e-11)


def test_melt_per_atom_energies_come_from_the_pair_list():
    system = melt()
    forces = md.Forces(system, md.LennardJones(1.0, 1.0, 2.5))
    forces.compute(TOTALS)
    total, virial, vectors = forces.potential_energy, forces.virial, forces.forces.copy()
    result = md.evaluate(system, md.LennardJones(1.0, 1.0, 2.5))
    assert total == pytest.approx(result.energies.sum(), rel=1e-13)
    assert virial == pytest.approx(result.virial, rel=1e-12, abs=1e-9)
    assert vectors == pytest.approx(result.forces, rel=1e-11, abs=1e-11)
