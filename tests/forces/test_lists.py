"""All lists do the same physics: forces, energies and virials of clusters, of pairs and of brute force, in any cell."""

import cluster_scenes as cs
import numpy as np
import pytest
from ase.build import bulk
from hypothesis import given, settings, strategies as st
from references import brute_force_pairs, liquid
from scenes import BONDED, LJ
from wrong_calls import assert_answered

import minimd as md
from minimd.ase import Calculator, VelocityVerlet
from minimd.core.forces.cluster_term import ClusterTerm
from minimd.core.forces.options import Options
from minimd.core.forces.pair_laws import skin_for
from minimd.core.forces.pair_list_term import PairListTerm
from minimd.core.potentials.term import PER_ATOM

TABLE = [pytest.param(name, marks=() if name == "many" else pytest.mark.slow) for name in cs.LAWS]


@pytest.mark.parametrize("name", TABLE)
@given(system=cs.scenes([*cs.SIZES, 3000]), seed=st.integers(0, 2**32 - 1), atoms=st.sampled_from([5, 40, 800]))
@settings(max_examples=40)
def test_clusters_and_pairs_are_the_same_physics(name, system, seed, atoms):
    """Also after moves of half the skin, for which no list is built, and after moves by lattice vectors."""
    with cs.atoms_per_domain(atoms):
        clusters, pairs = cs.both_lists(system, cs.LAWS[name])
        cs.agree(clusters, pairs, system)
        rng, n_builds = np.random.default_rng(seed), clusters.list.n_builds
        step = rng.normal(size=system.positions.shape)
        step *= 0.249 * clusters.list.skin / np.linalg.norm(step, axis=1, keepdims=True)
        for _layer in range(2):
            system.positions += step
            cs.agree(clusters, pairs, system)
        assert clusters.list.n_builds == n_builds
        moved = rng.random(len(system)) < 0.3
        system.positions[moved] += (rng.integers(-2, 3, (moved.sum(), 3)) * system.cell.pbc) @ system.cell.vectors
        cs.agree(clusters, pairs, system)


def towards_a_partner(system):
    """Unit vectors that lead pairs, listed but beyond the cutoff, straight towards each other; their distances."""
    first, second, vectors, distances = md.neighbor_list("ijDd", system, cs.CUTOFF + cs.SKIN)
    directions, free, gaps = np.zeros_like(system.positions), np.ones(len(system), dtype=bool), []
    for p in np.argsort(distances)[::-1]:
        if distances[p] > cs.CUTOFF and first[p] != second[p] and free[first[p]] and free[second[p]]:
            free[[first[p], second[p]]] = False
            directions[first[p]], directions[second[p]] = vectors[p] / distances[p], -vectors[p] / distances[p]
            gaps.append(distances[p])
    return directions, np.array(gaps)


@given(system=cs.scenes(sizes=[8, 120, 400]), atoms=st.sampled_from([5, 800]))
@settings(max_examples=20)
def test_pairs_that_run_into_each_other_are_not_missed(system, atoms):
    """Half the skin each, on the shortest way: those that were almost beyond the list come just within the cutoff."""
    with cs.atoms_per_domain(atoms):
        clusters, pairs = cs.both_lists(system, cs.ONE_SPECIES)
        cs.agree(clusters, pairs, system)
        directions, gaps = towards_a_partner(system)
        for away in (0.4999999, -0.4999999):
            cs.agree(clusters, pairs, md.System(system.positions + away * cs.SKIN * directions, cell=system.cell))
        assert clusters.list.n_builds == 1
        cs.agree(clusters, pairs, md.System(system.positions + 0.5000001 * cs.SKIN * directions, cell=system.cell))
        assert clusters.list.n_builds == (2 if len(gaps) else 1)
    assert np.all(gaps - 2 * 0.4999999 * cs.SKIN < cs.CUTOFF + 1e-6)


@pytest.mark.parametrize("kind", [ClusterTerm, PairListTerm])
def test_a_list_that_follows_a_strain_misses_no_pair(kind):
    system, strain = liquid(4), np.array([[0.97, 0.01, 0.0], [0.0, 0.98, 0.0], [0.0, 0.0, 1.01]])
    laws = cs.pair_laws(system, cs.ONE_SPECIES)
    term, bare = kind(system, laws, Options(1, skin=cs.SKIN)), PairListTerm(system, laws, Options(skin=0.0))
    cs.agree(term, bare, system)
    system.positions[:], system.cell = system.positions @ strain, md.Cell.of(system.cell.vectors @ strain)
    term.list.follow(system.cell)
    strained, (directions, _) = system.positions.copy(), towards_a_partner(system)
    for share, n_builds in ((0.0, 1), (0.36, 1), (0.45, 2)):
        system.positions[:] = strained + share * cs.SKIN * directions
        cs.agree(term, bare, system)
        assert term.list.n_builds == n_builds


def by_hand(system):
    """Forces, energies and virials of all atoms for cs.ONE_SPECIES, each pair from both sides."""
    found = sorted(brute_force_pairs(system.positions, system.cell.vectors, system.cell.pbc, cs.CUTOFF))
    first, second, *shifts = np.array(found, dtype=int).reshape(-1, 5).T
    d = system.positions[second] - system.positions[first] + np.transpose(shifts) @ system.cell.vectors
    r = np.linalg.norm(d, axis=1)
    u, slope = (lambda x: 4.0 * (x**-12.0 - x**-6.0)), lambda x: -24.0 * (2.0 * x**-13.0 - x**-7.0)
    f = (slope(cs.CUTOFF) - slope(r)) / r
    forces, energies, virials = np.zeros((len(system), 3)), np.zeros(len(system)), np.zeros((len(system), 6))
    np.add.at(forces, first, -f[:, None] * d)
    np.add.at(energies, first, 0.5 * (u(r) - u(cs.CUTOFF) - (r - cs.CUTOFF) * slope(cs.CUTOFF)))
    np.add.at(virials, first, 0.5 * f[:, None] * d[:, [0, 1, 2, 1, 0, 0]] * d[:, [0, 1, 2, 2, 2, 1]])
    return forces, energies, virials


def test_lists_find_what_brute_force_finds_and_padding_has_no_weight():
    """Atoms of one column: 1 to 8 lanes of the last cluster are filled, all others repeat its last atom."""
    for n, pbc in [(n, pbc) for n in range(1, 10) for pbc in (True, (True, True, False))]:
        positions = np.column_stack([0.4 * (-1.0) ** np.arange(n), np.zeros(n), 0.9 * np.arange(n)])
        system = md.System(positions + 0.3, cell=[2.4, 2.4, max(2.4, 0.9 * n)], pbc=pbc)
        clusters, pairs = cs.both_lists(system, cs.ONE_SPECIES)
        expected = by_hand(system)
        for term in (clusters, pairs):
            for a, b in zip(cs.evaluated(term, system, PER_ATOM), expected, strict=True):
                assert a == pytest.approx(b, abs=cs.EQUAL * max(1.0, np.abs(b).max()), rel=0)
        found = clusters.list.clusters
        assert (found.filled[: clusters.list.n_clusters].sum(), len(found.column_start)) == (n, 2)


def test_a_crystal_exactly_on_its_faces_has_no_forces_and_excluded_pairs_may_sit_on_each_other():
    for size in (5, 9):
        system = md.System(1.1 * np.array([*np.ndindex(size, size, size)]), cell=1.1 * size)
        forces, energy, _ = cs.summed(cs.both_lists(system, cs.ONE_SPECIES)[0], system)
        assert np.abs(forces).max() < 1e-12
        assert energy == pytest.approx(md.evaluate(system, cs.ONE_SPECIES).potential_energy, rel=1e-12)
    system = liquid(4)
    system.positions[1] = system.positions[0]
    bonded = md.System(system.positions, cell=system.cell, bonds=[[0, 1]])
    cs.agree(*cs.both_lists(bonded, [BONDED]), bonded)
    assert_answered(lambda: md.LennardJones(1.0, 1.0, 2.0, bonded_scale=0), ValueError, "bonded_scale", "0")


@pytest.mark.parametrize("atoms", [1, 50])
@pytest.mark.parametrize("pbc", [True, (True, False, False), (False, True, True), False])
def test_chunks_change_nothing_but_rounding(atoms, pbc):
    system = cs.rod(pbc=pbc)
    with cs.atoms_per_domain(atoms):
        clusters, pairs = cs.both_lists(system, cs.MANY)
        cs.agree(clusters, pairs, system)
    assert len(clusters.list.domains.first) >= 5


@pytest.mark.parametrize("skin", [0.05, pytest.param(None, marks=pytest.mark.slow)])
def test_a_hot_run_has_the_energies_of_fresh_lists(skin):
    with cs.atoms_per_domain(100):
        simulation = md.Simulation(cs.rod(), cs.MANY, md.VelocityVerlet(0.002), skin=skin, threads=2)
    simulation.set_temperature(8.0, 5)
    seen = []

    def compare(running):
        fresh = md.evaluate(running.system, cs.MANY)
        force = np.abs(running.forces - fresh.forces).max() / np.abs(fresh.forces).max()
        energy = abs(running.record.potential_energy[-1] - fresh.potential_energy) / np.abs(fresh.energies).sum()
        seen.append(max(force, energy))

    record = simulation.run(120, every=10, observers=[compare])
    assert simulation.engine.interactions.n_builds > 5
    assert max(seen) < 1e-12
    assert np.ptp(record.total_energy[2:]) < 0.002 * record.kinetic_energy.mean()


def test_a_calculator_passes_its_choices_on():
    atoms = bulk("Ar", "fcc", a=5.4, cubic=True) * 2
    for precision in ("double", "fixed-point"):
        chosen = {"threads": 2, "precision": precision, "skin": 1.25}
        atoms.calc = Calculator(md.LennardJones(0.0103, 3.405, 6.2, "force-shifted"), **chosen)
        atoms.get_forces()
        dynamics = VelocityVerlet(atoms.copy(), 1.0)
        dynamics.atoms.calc = atoms.calc
        dynamics.run(1)
        assert atoms.calc._plan[1].options == dynamics._guard.engine.interactions.options == Options(**chosen)


@settings(max_examples=50)
@given(st.floats(1.001, 3.0), st.floats(0.0, 0.3), st.tuples(*[st.booleans()] * 3), st.booleans())
def test_a_skin_is_never_wider_than_the_cell_has_room_for(height, stride, pbc, has_excluded):
    rng = np.random.default_rng(1)
    cell = np.array([height, 1.3 * height, 2.0 * height]) * LJ.cutoff
    system = md.System(rng.uniform(0, 1, (300, 3)) * cell, cell=cell, pbc=pbc, bonds=[[0, 1]] if has_excluded else None)
    laws = cs.pair_laws(system, [md.LennardJones(1.0, 1.0, 1.8, bonded_scale=(0.0, 1.0, 1.0))])
    skin, narrowest = skin_for(system, laws, Options(), stride), cell[np.array(pbc)].min(initial=np.inf)
    assert skin <= laws.cutoff
    if laws.fit_clusters(system, Options(), stride):
        assert laws.cutoff + skin <= narrowest
    if has_excluded and skin > 0.0:
        assert laws.cutoff + skin <= 0.5 * narrowest


def test_atoms_far_from_the_origin_feel_the_same():
    """Thousands of cells away: far coordinates are rounded."""
    near = liquid(4)
    moves = np.random.default_rng(2).integers(-4096, 4097, near.positions.shape) @ near.cell.vectors
    far = md.System(near.positions + moves, cell=near.cell)
    a, b = (cs.evaluated(cs.clustered(system, cs.ONE_SPECIES), system) for system in (near, far))
    assert b[0] == pytest.approx(a[0], abs=1e-9 * np.abs(a[0]).max(), rel=0)
    assert b[1].sum() == pytest.approx(a[1].sum(), rel=1e-6)
