"""The neighbor list finds every pair and image once, in any cell, and never goes stale."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from references import brute_force_pairs
from wrong_calls import assert_answered

import minimd as md
from minimd.core.neighbors.pair_list import PairList
from minimd.core.neighbors.queries import closest_pair

NO_PAIRS = np.zeros((0, 2), dtype=np.int64)
FLAT = 0.02  # determinant of the unit vectors below which a brute force would need too many images


@st.composite
def scenes(draw):
    """(positions, cell, cutoff): triclinic, left-handed, partly open, smaller than the cutoff, atoms far away."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 14))
    cell = rng.normal(size=(3, 3)) * draw(st.sampled_from([0.7, 1.5, 4.0]))
    if draw(st.booleans()):
        cell[1] += draw(st.integers(-4, 4)) * cell[0]
    assume(abs(np.linalg.det(cell / np.linalg.norm(cell, axis=1, keepdims=True))) > FLAT)
    pbc = np.array(draw(st.tuples(st.booleans(), st.booleans(), st.booleans())))
    positions = rng.normal(size=(n, 3)) * draw(st.sampled_from([0.5, 2.0, 10.0]))
    cutoff = draw(st.floats(0.2, 2.5))
    heights = 1.0 / np.linalg.norm(np.linalg.inv(cell), axis=0)
    assume(np.prod(np.where(pbc, 2.0 * np.ceil(cutoff / heights) + 3.0, 1.0)) < 1500)
    return positions, md.Cell.of(cell, pbc), cutoff


def brute_force(positions, cell, cutoff):
    return brute_force_pairs(positions, cell.vectors, cell.pbc, cutoff)


def near(pair_list, cutoff, positions):
    pairs, order = pair_list.pairs, pair_list.order
    local = positions[order] + pair_list.offsets
    first = np.repeat(np.arange(len(order)), np.diff(pairs.start))
    vectors = local[pairs.second] - local[first]
    if len(pairs.translations):
        vectors = vectors + pairs.translations[pairs.image]
    distances = np.linalg.norm(vectors, axis=1)
    found = np.sort(np.column_stack([order[first], order[pairs.second]]), axis=1)
    return found[distances < cutoff].tolist(), np.sort(distances[distances < cutoff])


def check(pair_list, cell, cutoff, positions):
    pairs, distances = near(pair_list, cutoff, positions)
    both = [((i, j), np.array(s)) for i, j, *s in brute_force(positions, cell, cutoff)]
    half = [((i, j), s) for (i, j), s in both if i < j or (i == j and tuple(s) > (0, 0, 0))]
    expected = [np.linalg.norm(positions[j] - positions[i] + s @ cell.vectors) for (i, j), s in half]
    assert sorted(map(tuple, pairs)) == sorted(pair for pair, _ in half)
    assert distances == pytest.approx(np.sort(expected), abs=1e-9)


@given(scenes())
@settings(max_examples=80)
def test_neighbor_list_equals_brute_force(scene):
    positions, cell, cutoff = scene
    i, j, shifts, vectors, d = md.neighbor_list("ijSDd", md.System(positions, cell=cell), cutoff)
    listed = list(map(tuple, np.column_stack([i, j, shifts]).tolist()))
    assert (len(set(listed)), set(listed)) == (len(listed), brute_force(positions, cell, cutoff))
    assert np.allclose(vectors, positions[j] - positions[i] + shifts @ cell.vectors, atol=1e-12)
    assert np.array_equal(d, np.linalg.norm(vectors, axis=1))


@given(scenes(), st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_list_misses_no_pair_after_moves_of_half_the_skin_wraps_and_strains(scene, seed):
    (positions, cell, cutoff), rng, skin = scene, np.random.default_rng(seed), 0.4
    pair_list = PairList(len(positions), cutoff, skin, NO_PAIRS)
    direction = rng.normal(size=positions.shape)
    direction *= skin / np.linalg.norm(direction, axis=1, keepdims=True)
    for share, is_new in ((0.0, True), (0.4999, False), (0.5001, True)):
        assert pair_list.update(positions + share * direction, cell) == is_new
        check(pair_list, cell, cutoff, positions + share * direction)
    cells_away = rng.integers(-3, 4, size=positions.shape) * (rng.random((len(positions), 1)) < 0.5) * cell.pbc
    wrapped = positions + cells_away @ cell.vectors
    pair_list.update(wrapped, cell)
    check(pair_list, cell, cutoff, wrapped)
    for share in (0.99, 0.5):  # the list follows the cell; the second strain may be too much for it
        strained = md.Cell.of(share * cell.vectors, cell.pbc)
        moved = wrapped @ cell.inverse @ strained.lattice
        pair_list.follow(strained)
        pair_list.update(moved, strained)
        check(pair_list, strained, cutoff, moved)
    smaller = md.Cell.of(0.6 * cell.vectors, cell.pbc)
    assert pair_list.update(0.6 * wrapped, smaller)
    check(pair_list, smaller, cutoff, 0.6 * wrapped)


def test_list_sees_a_cell_that_only_changes_its_periodicity_and_grows_and_shrinks_by_itself():
    positions, pair_list = np.array([[0.1, 0, 0], [2.9, 0, 0]]), PairList(2, 1.0, 0.1, NO_PAIRS)
    for pbc, n_pairs in ((True, 1), (False, 0), (True, 1)):
        assert pair_list.update(positions, md.Cell.of(3.0, pbc))
        assert len(pair_list.pairs.second) == n_pairs
    rng, pair_list, cell = np.random.default_rng(2), PairList(60, 1.5, 0.1, NO_PAIRS), md.Cell.of(20.0)
    for spread in (20.0, 1.0, 20.0, 0.3):
        positions = rng.uniform(0, spread, (60, 3))
        pair_list.update(positions, cell)
        check(pair_list, cell, 1.5, positions)


@pytest.mark.parametrize("cutoff", [1.0, np.inf])
def test_a_position_that_is_no_number_is_seen_by_a_list_that_was_right(cutoff):
    positions, pair_list = np.eye(3), PairList(3, cutoff, 0.1, NO_PAIRS)
    pair_list.update(positions, md.Cell.of(None))
    positions[1, 2] = np.nan
    assert_answered(lambda: pair_list.update(positions, md.Cell.of(None)), md.NonFiniteError, "1 atoms", "atom 1")


def test_a_million_cells_away_is_still_here_and_empty_space_costs_nothing():
    rng = np.random.default_rng(3)
    positions, far = rng.uniform(0, 5, (20, 3)), rng.integers(-(2**20), 2**20, (20, 3)) * 5.0
    near, away = (md.neighbor_list("id", md.System(at, cell=5.0), 2.0) for at in (positions, positions + far))
    assert np.array_equal(near[0], away[0])
    assert np.sort(near[1]) == pytest.approx(np.sort(away[1]), abs=4e-9)  # rounding of the far coordinates
    system = md.System([[0, 0, 0], [1, 0, 0], [1e6, 0, 0], [0, 1e6, 1e6]])
    assert md.neighbor_list("ij", system, 1.5)[0].tolist() == [0, 1]


@given(scenes())
@settings(max_examples=30)
def test_closest_pair_is_the_closest(scene):
    positions, cell, _ = scene
    closest = closest_pair(md.System(positions, cell=cell))
    if closest is None:
        assert len(positions) == 1
        assert not cell.pbc.any()
        return
    found = brute_force(positions, cell, closest.distance * (1 + 1e-9))
    assert {(i, j) for i, j, *_ in found} >= {(closest.first, closest.second)}
    assert not brute_force(positions, cell, closest.distance * (1 - 1e-9))


def test_closest_pair_is_found_though_others_were_flung_away():
    system = md.System(np.zeros((4, 3)))
    system.positions[1:] = [[1e200, 0.0, -1e180], [0.0, 3.0, 0.0], [0.0, 5.0, 0.0]]
    assert closest_pair(system) == (2, 3, 2.0)
    system.positions[2:] = 1e200 * np.eye(3)[1:]
    assert closest_pair(system) is None
