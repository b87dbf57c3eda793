"""The cluster list does what the pair list does: same forces, energies and virial, in any cell that is large enough."""

import numpy as np
import pytest
from cluster_scenes import (
    CUTOFF,
    KINDS,
    SKIN,
    SMOOTH,
    agree,
    atoms_per_domain,
    evaluated,
    n_domains,
    pair_laws,
    rod,
    scenes,
    summed,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from references import brute_force_pairs, liquid, melt

import minimd as md
from minimd.forces.cluster_term import ClusterTerm
from minimd.forces.options import Options
from minimd.forces.pair_laws import PairLaws
from minimd.forces.pair_list_term import PairListTerm
from minimd.neighbors.cluster_list import ClusterList
from minimd.neighbors.domains import BLOCKS
from minimd.potentials.term import PER_ATOM, TOTALS

SKINNED, BARE = Options(skin=SKIN, threads=2), Options(skin=0.0)
EQUAL = 1e-13  # rounding: sums in another order


def soft(r2, height):
    return height * np.exp(-r2), 2.0 * height * np.exp(-r2)


def branching(r2, height):
    return (height, 0.0) if r2 < 1.0 else (height / r2, 2.0 * height / r2**2)


CUTOFFS = {(a, b): 1.5 + 0.1 * k for k, (a, b) in enumerate(["AA", "AB", "AC", "BB", "BC", "CC"])}
POTENTIALS = SMOOTH | {
    "cutoffs by pair": [md.LennardJones({"A": (1, 1), "B": (0.5, 0.9), "C": (1, 1)}, cutoff=CUTOFFS)],
    "shifted": [md.LennardJones(1.0, 1.0, CUTOFF)],
    "shifted, exclusions": [md.LennardJones(KINDS, cutoff=CUTOFF, bonded_scale=(0.0, 0.3, 0.8))],
    "two laws": [md.LennardJones(1.0, 1.0, 1.6), md.PairPotential(soft, (3.0,), CUTOFF)],
}
ALIKE = (
    "cutoffs by pair",
    "shifted",
    "shifted, exclusions",
    "two laws",
)  # to the kernel these are combinations of the others


def both_lists(system, potentials, options=SKINNED):
    laws = pair_laws(system, potentials)
    return ClusterTerm(system, laws, options), PairListTerm(system, laws, BARE)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in ALIKE else ()) for name in POTENTIALS]
)
@given(system=scenes(), seed=st.integers(0, 2**32 - 1), atoms=st.sampled_from([5, 40, 800]))
@settings(max_examples=40)
def test_clusters_and_pairs_are_the_same_physics(name, system, seed, atoms):
    with atoms_per_domain(atoms):
        clustered, listed = both_lists(system, POTENTIALS[name])
        agree(clustered, listed, system, EQUAL)
        rng = np.random.default_rng(seed)
        step = rng.normal(size=system.positions.shape)
        step *= 0.249 * clustered.list.skin / np.linalg.norm(step, axis=1, keepdims=True)
        n_builds = clustered.list.n_builds
        for _layer in range(2):
            system.positions += step
            agree(clustered, listed, system, EQUAL)
        assert clustered.list.n_builds == n_builds
        moved = rng.random(len(system)) < 0.3
        system.positions[moved] += (rng.integers(-2, 3, (moved.sum(), 3)) * system.cell.pbc) @ system.cell.vectors
        agree(clustered, listed, system, EQUAL)


def test_layers_of_rows_follow_the_motion_and_change_no_bit():
    system = liquid(5)
    clustered, whole = (ClusterTerm(system, pair_laws(system, POTENTIALS["one species"]), SKINNED) for _ in range(2))
    at_first, n_entries = system.positions.copy(), []
    for moved in (0.0, 0.249, 0.251, 0.1, 0.499):
        system.positions[:] = at_first
        summed(whole, system)
        system.positions[7, 0] += 0.499 * SKIN
        summed(whole, system)  # now it needs all layers
        system.positions[:] = at_first
        system.positions[7, 0] += moved * SKIN
        assert np.array_equal(summed(clustered, system)[0], summed(whole, system)[0])
        rows = clustered.list.arrays.rows
        n_slots = clustered.list.n_clusters * clustered.list.lanes.size
        n_entries.append(int((rows.stops[rows.layers[0] - 1] - rows.start)[:n_slots].sum()))
    assert (
        n_entries[0] == n_entries[1] < n_entries[2] == n_entries[3] == n_entries[4]
    )  # once taken into use, a layer is kept
    assert (clustered.list.n_builds, whole.list.n_builds) == (1, 1)


@pytest.mark.parametrize("name", ["three species", "exclusions"])
@given(system=scenes(sizes=[2000, 5000]), atoms=st.sampled_from([40, 800]))
@settings(max_examples=10)
def test_clusters_and_pairs_are_the_same_physics_for_thousands(name, system, atoms):
    with atoms_per_domain(atoms):
        agree(*both_lists(system, POTENTIALS[name]), system, EQUAL)


@pytest.mark.parametrize("size", [5, 9])
def test_a_crystal_exactly_on_its_faces_has_no_forces(size):
    sites = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * 1.1
    system = md.System(sites, cell=1.1 * size)
    forces, energy, _ = summed(ClusterTerm(system, pair_laws(system, POTENTIALS["one species"]), SKINNED), system)
    assert np.abs(forces).max() < 1e-12
    assert energy == pytest.approx(md.evaluate(system, POTENTIALS["one species"]).potential_energy, rel=1e-12)


def test_list_serves_growing_and_shrinking_crowds():
    system = md.System(np.random.default_rng(1).uniform(0, 40, (600, 3)), cell=40.0)
    laws = pair_laws(system, POTENTIALS["two laws"][1:])
    clustered, listed = ClusterTerm(system, laws, SKINNED), PairListTerm(system, laws, BARE)
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
    laws = pair_laws(system, POTENTIALS["two laws"][1:])
    clustered, listed = ClusterTerm(system, laws, SKINNED), PairListTerm(system, laws, BARE)
    numbers = set()
    for _ in range(60):
        system.positions[:] = rng.uniform(0, 4.4, (64, 3)) * rng.uniform(0.3, 1.0, 3)
        a, b = summed(clustered, system), summed(listed, system)
        assert a[0] == pytest.approx(b[0], rel=1e-11, abs=1e-11)
        memory, needed, block = clustered.list.memory, len(clustered.list.ghosts.owner), clustered.list.lanes.size * 3
        n_ghosts, n_blocks = clustered.list.n_ghosts, int(clustered.list.domains.numbers[BLOCKS])
        assert (len(memory.coordinates), n_ghosts <= needed, n_blocks * block <= len(memory.forces)) == (
            needed * block,
            True,
            True,
        )
        numbers.add(needed)
    assert len(numbers) > 1


def test_excluded_pairs_may_sit_on_each_other_in_clusters_too():
    system = liquid(5)
    system.positions[1] = system.positions[0]
    bonded = md.System(system.positions, cell=system.cell, bonds=[[0, 1]])
    laws = pair_laws(bonded, [md.LennardJones(1.0, 1.0, 2.5, bonded_scale=(0, 1, 1))])
    agree(ClusterTerm(bonded, laws, SKINNED), PairListTerm(bonded, laws, BARE), bonded, EQUAL)


def test_rule_which_list_a_scene_gets():
    def kind(system, potential, **options):
        return type(
            md.Simulation(system, potential, md.VelocityVerlet(0.001), **options).engine.interactions.terms[0]
        ).__name__

    assert kind(liquid(5), md.LennardJones(1.0, 1.0, 2.5)) == "ClusterTerm"
    assert kind(liquid(2), md.LennardJones(1.0, 1.0, 1.2)) == "ClusterTerm"
    assert (
        kind(md.System(liquid(2).positions[:-1], cell=liquid(2).cell), md.LennardJones(1.0, 1.0, 1.2)) == "PairListTerm"
    )  # few atoms
    assert kind(liquid(5), md.LennardJones(1.0, 1.0, 8.4)) == "PairListTerm"  # cell too small
    assert kind(liquid(5), md.PairPotential(soft, (1.0,), 2.5)) == "ClusterTerm"
    assert kind(liquid(5), md.PairPotential(branching, (1.0,), 2.5)) == "PairListTerm"  # cannot run on vectors
    assert kind(md.System(liquid(5).positions), md.LennardJones(1.0, 1.0)) == "PairListTerm"  # no cutoff


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


@pytest.mark.parametrize("atoms", [1, 50, 800])
@pytest.mark.parametrize("pbc", [True, (True, False, False), (False, True, True), False])
def test_chunks_change_nothing_but_rounding(atoms, pbc):
    system = rod()
    system = md.System(
        system.positions, cell=md.Cell.of(system.cell.vectors, pbc), species=system.species, bonds=system.bonds
    )
    with atoms_per_domain(atoms):
        clustered, listed = both_lists(system, POTENTIALS["exclusions"])
        agree(clustered, listed, system, EQUAL)
    assert n_domains(clustered) >= (1 if atoms == 800 else 5)


def test_one_thread_keeps_the_forces_of_few_domains_and_sums_the_same():
    """Forces of a domain take the place of those that are needed no more; two threads keep all of them."""
    system = rod()
    with atoms_per_domain(40):
        alone, together = (
            ClusterTerm(system, pair_laws(system, POTENTIALS["exclusions"]), Options(skin=SKIN, threads=n))
            for n in (1, 2)
        )
        for detail in (TOTALS, PER_ATOM):
            for a, b in zip(summed(alone, system, detail), summed(together, system, detail), strict=True):
                assert np.array_equal(a, b)
    kept, needed = (int(term.list.domains.numbers[BLOCKS]) for term in (alone, together))
    assert kept < 0.8 * needed == 0.8 * alone.list.domains.window[-1]
    assert len(alone.list.memory.forces) < len(together.list.memory.forces)


def lennard_jones_by_hand(system, cutoff):
    """Forces, energies and virials of all atoms, shifted Lennard-Jones, each pair from both sides."""
    pairs = np.array(
        sorted(brute_force_pairs(system.positions, system.cell.vectors, system.cell.pbc, cutoff)), dtype=int
    ).reshape(-1, 5)
    first, second, shifts = pairs[:, 0], pairs[:, 1], pairs[:, 2:]
    r = system.positions[second] - system.positions[first] + shifts @ system.cell.vectors
    s6 = (r**2).sum(axis=1) ** -3.0
    f = 24.0 * s6 * (2.0 * s6 - 1.0) / (r**2).sum(axis=1)
    forces, energies, virials = np.zeros((len(system), 3)), np.zeros(len(system)), np.zeros((len(system), 6))
    np.add.at(forces, first, -f[:, None] * r)
    np.add.at(energies, first, 0.5 * (4.0 * s6 * (s6 - 1.0) - 4.0 * (cutoff**-12 - cutoff**-6)))
    np.add.at(virials, first, 0.5 * f[:, None] * r[:, [0, 1, 2, 1, 0, 0]] * r[:, [0, 1, 2, 2, 2, 1]])
    return forces, energies, virials


@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("n", range(1, 20))
def test_padding_has_no_weight(n, precision):
    """Atoms of one column: 1 to 8 lanes of the last cluster are filled, all others repeat its last atom."""
    positions = np.column_stack([0.4 * (-1.0) ** np.arange(n), np.zeros(n), 0.9 * np.arange(n)])
    for pbc in (True, (True, True, False)):
        system = md.System(positions + 0.3, cell=[2.4, 2.4, max(2.4, 0.9 * n)], pbc=pbc)
        potential = md.LennardJones(1.0, 1.0, CUTOFF)
        clustered = ClusterTerm(system, pair_laws(system, [potential]), Options(1, precision, skin=SKIN))
        got, expected = evaluated(clustered, system, PER_ATOM), lennard_jones_by_hand(system, CUTOFF)
        assert (
            clustered.list.clusters.filled[: clustered.list.n_clusters].sum(),
            len(clustered.list.clusters.column_start),
        ) == (n, 2)
        for a, b in zip(got, expected, strict=True):
            assert a == pytest.approx(
                b, abs=(EQUAL if precision == "double" else 1e-5) * max(1.0, np.abs(b).max()), rel=0
            )


def towards_a_partner(system):
    """Unit vectors that lead as many pairs as possible, listed but beyond the cutoff, straight towards each other; their distances."""
    first, second, vectors, distances = md.neighbor_list("ijDd", system, CUTOFF + SKIN)
    directions, free, gaps = np.zeros_like(system.positions), np.ones(len(system), dtype=bool), []
    for p in np.argsort(distances)[::-1]:
        if distances[p] > CUTOFF and first[p] != second[p] and free[first[p]] and free[second[p]]:
            free[[first[p], second[p]]] = False
            directions[first[p]], directions[second[p]] = vectors[p] / distances[p], -vectors[p] / distances[p]
            gaps.append(distances[p])
    return directions, np.array(gaps)


@given(system=scenes(sizes=[8, 120, 400]), atoms=st.sampled_from([5, 800]))
@settings(max_examples=40)
def test_pairs_that_run_into_each_other_are_not_missed(system, atoms):
    """Half the skin each, on the shortest way: those that were almost beyond the list come just within the cutoff."""
    with atoms_per_domain(atoms):
        clustered, listed = both_lists(system, POTENTIALS["shifted"])  # the force jumps at the cutoff
        agree(clustered, listed, system, EQUAL)
        directions, gaps = towards_a_partner(system)
        for away in (0.4999999, -0.4999999):
            moved = md.System(system.positions + away * SKIN * directions, cell=system.cell, species=system.species)
            agree(clustered, listed, moved, EQUAL)
        assert clustered.list.n_builds == 1
        farther = md.System(system.positions + 0.5000001 * SKIN * directions, cell=system.cell, species=system.species)
        agree(clustered, listed, farther, EQUAL)
        assert clustered.list.n_builds == (2 if len(gaps) else 1)
    assert np.all(gaps - 2 * 0.4999999 * SKIN < CUTOFF + 1e-6)


@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("skin", [0.05, 0.3, None])
def test_a_hot_run_has_the_energies_of_fresh_lists(skin, precision):
    system, seen = rod(12, 4), []
    potentials = POTENTIALS["three species"]
    simulation = md.Simulation(system, potentials, md.VelocityVerlet(0.002), skin=skin, precision=precision, threads=2)
    simulation.set_temperature(8.0, 5)

    def compare(running):
        fresh = md.evaluate(running.system, potentials)
        force = np.abs(running.forces - fresh.forces).max() / np.abs(fresh.forces).max()
        energy = abs(running.record.potential_energy[-1] - fresh.potential_energy) / np.abs(fresh.energies).sum()
        seen.append(max(force, energy))

    record = simulation.run(300, every=10, observers=[compare])
    assert simulation.engine.interactions.n_builds > 5
    assert max(seen) < (1e-12 if precision == "double" else 1e-5)
    assert np.ptp(record.total_energy[2:]) < 0.002 * record.kinetic_energy.mean()


@pytest.mark.parametrize("short", [0, 1, 2])
@pytest.mark.parametrize("factor", [1.02, 1.05, 1.08, 1.3])
def test_a_cell_just_high_enough_in_one_direction(short, factor):
    """The skin is cut to the room there is: the list then reaches exactly once through the cell."""
    heights = np.full(3, 2.5 * CUTOFF)
    heights[short] = factor * CUTOFF
    rng = np.random.default_rng(3)
    n = np.floor(heights / 1.1).astype(int)
    sites = (np.stack(np.meshgrid(*map(np.arange, n), indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) / n * heights
    system = md.System(sites + rng.uniform(-0.05, 0.05, sites.shape), cell=heights)
    assert len(system) >= 16
    laws = pair_laws(system, [md.LennardJones(1.0, 1.0, CUTOFF)])
    for options in (Options(), Options(skin=float(heights[short] - CUTOFF))):
        agree(ClusterTerm(system, laws, options), PairListTerm(system, laws, BARE), system, EQUAL)


@pytest.mark.parametrize("pbc", [False, (True, True, False)])
def test_a_flat_layer_has_few_columns(pbc):
    sites = np.stack(np.meshgrid(np.arange(32), np.arange(32), [0], indexing="ij"), axis=-1).reshape(-1, 3) * 1.1
    system = md.System(sites, cell=[35.2, 35.2, 10.0], pbc=pbc)
    laws = pair_laws(system, [md.LennardJones(1.0, 1.0, CUTOFF)])
    clustered = ClusterTerm(system, laws, SKINNED)
    agree(clustered, PairListTerm(system, laws, BARE), system, EQUAL)
    assert len(clustered.list.clusters.column_start) <= len(system)


def test_a_build_that_failed_leaves_no_list_behind(monkeypatch):
    """An interrupt or too little memory in the middle of a build: the next look builds anew."""
    system = liquid(5)
    laws = pair_laws(system, [md.LennardJones(1.0, 1.0, CUTOFF)])
    clustered, listed = ClusterTerm(system, laws, SKINNED), PairListTerm(system, laws, BARE)
    agree(clustered, listed, system, EQUAL)
    system.positions[:] += np.random.default_rng(1).uniform(-SKIN, SKIN, system.positions.shape)
    clustered.list._entry_start[-1] = 0  # no room for entries
    with monkeypatch.context() as broken:
        broken.setattr(ClusterList, "_arrange", lambda found: (_ for _ in ()).throw(MemoryError))
        with pytest.raises(MemoryError):
            summed(clustered, system)
    agree(clustered, listed, system, EQUAL)
