"""The cluster list in its memory: layers, domains, columns, and what a build that failed leaves behind."""

import itertools

import cluster_scenes as cs
import numpy as np
import pytest
from references import liquid

import minimd as md
from minimd.core.compiled.simd.vector import lanes_for
from minimd.core.compiled.threads import MOST_CHUNKS, thread_pool
from minimd.core.neighbors.cluster_list import ClusterList
from minimd.core.neighbors.cluster_store import ClusterStore
from minimd.core.neighbors.clusters import columns_fit, make_columns, region_of
from minimd.core.neighbors.domains import BLOCKS
from minimd.core.potentials.term import PER_ATOM, TOTALS
from minimd.core.structure.system import local_density


@pytest.mark.slow  # compiles a law for both lists
@pytest.mark.parametrize("pbc", [True, (True, True, False), False])
def test_memory_follows_growing_and_shrinking_crowds(pbc):
    """Column by column the padding changes from build to build, and with it the number of clusters and ghosts."""
    rng = np.random.default_rng(4)
    crowds = (64, 4.4, [0.1, *rng.uniform(0.3, 1.0, (20, 3))]), (600, 40.0, [0.025, 0.1, 1.0, 0.025, 0.5])
    for n, edge, spreads in crowds:
        system = md.System(rng.uniform(0, edge, (n, 3)), cell=edge, pbc=pbc)
        clusters, pairs = cs.both_lists(system, cs.SOFT)
        numbers = set()
        for spread in spreads:
            system.positions[:] = rng.uniform(0, edge, (n, 3)) * spread
            a, b = cs.summed(clusters, system), cs.summed(pairs, system)
            assert a[0] == pytest.approx(b[0], rel=1e-10, abs=1e-10)
            assert a[1] == pytest.approx(b[1], rel=1e-12)
            found, block = clusters.list, clusters.list.lanes.size * 3
            n_owned, n_blocks = len(found.ghosts.owner), int(found.domains.numbers[BLOCKS])
            assert (len(found.memory.coordinates), found.n_ghosts <= n_owned) == (n_owned * block, True)
            assert n_blocks * block <= len(found.memory.forces)
            numbers.add(n_owned)
        assert len(numbers) > 1


def test_one_thread_keeps_the_forces_of_few_domains_and_sums_the_same():
    """Forces of a domain take the place of those that are needed no more; two threads keep all."""
    system = cs.rod()
    with cs.atoms_per_domain(40):
        alone, together = (cs.clustered(system, cs.ONE_SPECIES, threads=n) for n in (1, 2))
        for detail in (TOTALS, PER_ATOM):
            pairs = zip(cs.evaluated(alone, system, detail), cs.evaluated(together, system, detail), strict=True)
            assert all(np.array_equal(a, b) for a, b in pairs)
    assert len(alone.list.memory.forces) < len(together.list.memory.forces)


def test_a_build_that_failed_leaves_no_list_behind(monkeypatch):
    """An interrupt or too little memory in the middle of a build: the next look builds anew."""
    system = liquid(4)
    clusters, pairs = cs.both_lists(system, cs.ONE_SPECIES)
    cs.agree(clusters, pairs, system)
    system.positions[:] += np.random.default_rng(1).uniform(-cs.SKIN, cs.SKIN, system.positions.shape)
    clusters.list._store.entry_start[-1] = 0  # no room for entries
    with monkeypatch.context() as broken:
        broken.setattr(ClusterStore, "fit", lambda *of: (_ for _ in ()).throw(MemoryError))
        with pytest.raises(MemoryError):
            cs.summed(clusters, system)
    cs.agree(clusters, pairs, system)


@pytest.mark.parametrize("n", [100, 3000, 8000])
def test_chunks_are_never_more_than_a_team_can_share_out(n):
    positions, cell = np.arange(n)[:, None] * np.array([1.1, 0.0, 0.0]), md.Cell.of(None)
    with cs.atoms_per_domain(1):
        found = ClusterList(n, 1.8, 0.2, np.zeros((0, 2), dtype=np.int64), False, thread_pool(2))
        found.update(positions, cell)
    columns = make_columns(cell, n, 2.0, found.lanes, region_of(cell, positions, 2.0))
    chunks = found.domains
    assert len(chunks.column) - 1 == min(MOST_CHUNKS, columns.counts[0] // columns.reach[0])
    assert np.all(np.diff(chunks.column) >= columns.reach[0])
    assert (chunks.column[0], chunks.column[-1], chunks.cluster[-1]) == (0, columns.counts[0], found.n_clusters)


def lump(edge, pbc=True):
    """A liquid cube of 256 atoms, 6.7 wide, about a corner of a wide cell."""
    return md.System(liquid(4).positions - 3.3, cell=edge, pbc=pbc)


@pytest.mark.parametrize("pbc", [True, (True, False, True), False])
def test_columns_cover_a_droplet_and_go_along_with_it(pbc):
    """Rarely: not with each list. Not across the faces, until an atom stands in the gap. A cluster of half as many
    atoms fills a smaller cube, so there are more columns."""
    system = lump(40.0, pbc)
    clusters, pairs = cs.both_lists(system, cs.ONE_SPECIES)
    found, laid, velocity = clusters.list, [], np.array([0.21, -0.17, 0.08])
    for _ in range(60):
        system.positions += velocity
        cs.agree(clusters, pairs, system)
        laid.append(found._columns_of[1])
    columns, starts = found._columns, len({region.tobytes() for region in laid})
    assert (found.n_builds, found.n_ghosts) == (60, found.n_clusters)
    assert 60 * 0.21 / (cs.CUTOFF + cs.SKIN) < starts < 15
    assert np.all(columns.extent * system.cell.heights < 6.7 + 2.0 * (cs.CUTOFF + cs.SKIN))
    assert set(columns.counts[:2].tolist()) <= {8: {3, 4}, 4: {4, 5, 6}}[lanes_for().size]
    system.positions[0] = system.positions[1:].mean(axis=0) + np.array([20.0, 17.0, 18.5])
    cs.agree(clusters, pairs, system)


def test_columns_fit_atoms_that_are_a_reach_from_their_ends_at_most():
    """The region ends half a reach, 1, beyond the atoms."""
    ends = np.array([[0.0, 0.0, 0.0], [9.0, 9.0, 9.0]])
    for cell in (md.Cell.of(30.0), md.Cell.of(30.0, (False, True, True)), md.Cell.of(None)):
        columns = make_columns(cell, 2, 2.0, lanes_for(), region_of(cell, ends, 2.0))
        assert columns.extent * cell.heights == pytest.approx([11.0] * 3, rel=1e-6)
        for below, above in itertools.product((-1.1, -0.9, 0.0, 0.9, 1.1), repeat=2):
            for lattice_vectors in (0.0, 60.0 * cell.pbc):
                moved = ends + np.array([[below, 0.0, 0.0], [above, 0.0, 0.0]]) + lattice_vectors
                assert columns_fit(moved, columns) == (max(abs(below), abs(above)) < 1.0)


def test_a_gap_that_closes_as_the_cell_is_strained_is_crossed():
    """At first it is a little more than twice as wide as the reach, in the end a little less than once."""
    positions = 1.9 * liquid(4).positions
    system = md.System(positions, cell=np.ptp(positions, axis=0) + 2.04 * (cs.CUTOFF + cs.SKIN))
    clusters, pairs = cs.both_lists(system, cs.ONE_SPECIES)
    for share, is_crossed in ((1.0, False), (0.9, False), (0.52, True)):
        system.positions[:], system.cell = system.positions * share, md.Cell.of(system.cell.vectors * share)
        clusters.list.follow(system.cell)
        cs.agree(clusters, pairs, system)
        assert set(clusters.list._columns.is_crossed) == {is_crossed}


def test_a_list_that_is_built_again_has_the_columns_of_the_first():
    """They may be where atoms were some lists ago, and decide the order of sums."""
    system = lump(40.0)
    first, other, fresh = (cs.clustered(system, cs.ONE_SPECIES) for _ in range(3))
    cs.evaluated(first, system)
    system.positions += 0.3
    cs.evaluated(first, system)
    other.list.build_again(first.list.built(), system.cell)
    results = [cs.evaluated(term, system)[0] for term in (first, other, fresh)]
    assert [np.array_equal(results[0], one) for one in results[1:]] == [True, False]


def test_local_density_is_that_of_the_liquid_wherever_it_is():
    system, rng = lump(6.72), np.random.default_rng(1)
    assert local_density(system.positions, system.cell, 2.5) == pytest.approx(0.8442, rel=0.02)
    for edge in (14.0, 40.0, 1e4):
        for pbc in (True, False, (True, False, True)):
            density = local_density(system.positions, md.Cell.of(edge, pbc), 2.5)
            assert 0.4 * 0.8442 < density < 1.4 * 0.8442  # surfaces cut bins, and open scenes end at the last atom
    gas = rng.uniform(0, 100.0, (20_000, 3))
    assert local_density(gas, md.Cell.of(100.0), 2.5) == pytest.approx(0.02, rel=0.04)  # statistics: pairs of one bin
