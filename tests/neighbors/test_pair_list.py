"""The neighbor list finds every pair and image once, in any cell, and never goes stale."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from references import brute_force_pairs

import minimd as md
from minimd.neighbors.pair_list import PairList
from minimd.neighbors.queries import closest_pair
from minimd.structure.cell import Cell

NO_PAIRS = np.zeros((0, 2), dtype=np.int64)
FLAT = 0.02  # determinant of the unit vectors below which a brute force would need too many images


@st.composite
def scenes(draw):
    """(positions, cell, pbc, cutoff): triclinic, left-handed, skewed, partly periodic, smaller than the cutoff, far-away atoms."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 14))
    cell = rng.normal(size=(3, 3)) * draw(st.sampled_from([0.7, 1.5, 4.0]))
    if draw(st.booleans()):
        cell[1] += draw(st.integers(-4, 4)) * cell[0]
    unit = cell / np.linalg.norm(cell, axis=1, keepdims=True)
    assume(abs(np.linalg.det(unit)) > FLAT)
    pbc = np.array(draw(st.tuples(st.booleans(), st.booleans(), st.booleans())))
    positions = rng.normal(size=(n, 3)) * draw(st.sampled_from([0.5, 2.0, 10.0]))
    cutoff = draw(st.floats(0.2, 2.5))
    heights = 1.0 / np.linalg.norm(np.linalg.inv(cell), axis=0)
    assume(np.prod(np.where(pbc, 2.0 * np.ceil(cutoff / heights) + 3.0, 1.0)) < 1500)
    return positions, cell, pbc, cutoff


def found_by(pair_list, cell, cutoff, positions):
    """Pairs of the list that are within the cutoff at these positions, in both directions."""
    pairs, order = pair_list.pairs, pair_list.order
    local = positions[order] + pair_list.offsets
    first = np.repeat(np.arange(len(order)), np.diff(pairs.start))
    vectors = local[pairs.second] - local[first]
    if len(pairs.translations):
        vectors = vectors + pairs.translations[pairs.image]
    near = np.linalg.norm(vectors, axis=1) < cutoff
    i, j = order[first[near]], order[pairs.second[near]]
    return sorted(np.round(np.linalg.norm(vectors[near], axis=1), 9).tolist()), sorted(
        zip(np.minimum(i, j), np.maximum(i, j), strict=True)
    )


def expected(positions, cell, cutoff):
    pairs = brute_force_pairs(positions, cell.vectors, cell.pbc, cutoff)
    half = [(i, j, *s) for i, j, *s in pairs if i < j or (i == j and tuple(s) > (0, 0, 0))]
    distances = [np.linalg.norm(positions[j] - positions[i] + np.array(s) @ cell.vectors) for i, j, *s in half]
    return sorted(np.round(distances, 9).tolist()), sorted((i, j) for i, j, *_ in half)


@given(scenes())
@settings(max_examples=250)
def test_neighbor_list_equals_brute_force(scene):
    positions, cell, pbc, cutoff = scene
    i, j, shifts, vectors, d = md.neighbor_list("ijSDd", md.System(positions, cell=cell, pbc=pbc), cutoff)
    listed = list(map(tuple, np.column_stack([i, j, shifts]).tolist()))
    assert len(set(listed)) == len(listed)
    assert set(listed) == brute_force_pairs(positions, cell, pbc, cutoff)
    assert np.allclose(vectors, positions[j] - positions[i] + shifts @ cell, atol=1e-12)
    assert np.array_equal(d, np.linalg.norm(vectors, axis=1))


@given(scenes(), st.integers(0, 2**32 - 1))
@settings(max_examples=150)
def test_list_misses_no_pair_after_moves_of_half_the_skin(scene, seed):
    positions, matrix, pbc, cutoff = scene
    rng, cell, skin = np.random.default_rng(seed), Cell.of(matrix, pbc), 0.4
    pair_list = PairList(len(positions), cutoff, skin, NO_PAIRS)
    pair_list.update(positions, cell)
    direction = rng.normal(size=positions.shape)
    moved = positions + 0.4999 * skin * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    assert not pair_list.update(moved, cell)
    assert found_by(pair_list, cell, cutoff, moved) == expected(moved, cell, cutoff)
    farther = positions + 0.5001 * skin * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    assert pair_list.update(farther, cell)
    assert found_by(pair_list, cell, cutoff, farther) == expected(farther, cell, cutoff)


@given(scenes(), st.integers(0, 2**32 - 1))
def test_list_survives_wraps_and_shrinking_cells(scene, seed):
    positions, matrix, pbc, cutoff = scene
    rng, cell = np.random.default_rng(seed), Cell.of(matrix, pbc)
    pair_list = PairList(len(positions), cutoff, 0.3, NO_PAIRS)
    pair_list.update(positions, cell)
    cells_away = rng.integers(-3, 4, size=positions.shape) * (rng.random((len(positions), 1)) < 0.5) * pbc
    wrapped = positions + cells_away @ matrix
    pair_list.update(wrapped, cell)
    assert found_by(pair_list, cell, cutoff, wrapped) == expected(wrapped, cell, cutoff)
    smaller = Cell.of(0.6 * matrix, pbc)
    assert pair_list.update(0.6 * wrapped, smaller)
    assert found_by(pair_list, smaller, cutoff, 0.6 * wrapped) == expected(0.6 * wrapped, smaller, cutoff)


def test_list_sees_a_cell_that_only_changes_its_periodicity():
    positions, pair_list = np.array([[0.1, 0, 0], [2.9, 0, 0]]), PairList(2, 1.0, 0.1, NO_PAIRS)
    for pbc, n_pairs in ((True, 1), (False, 0), (True, 1)):
        assert pair_list.update(positions, Cell.of(3.0, pbc))
        assert len(pair_list.pairs.second) == n_pairs


def test_list_grows_and_shrinks_by_itself():
    rng, pair_list, cell = np.random.default_rng(2), PairList(200, 1.5, 0.1, NO_PAIRS), Cell.of(20.0)
    for spread in (20.0, 1.0, 20.0, 0.3):
        positions = rng.uniform(0, spread, (200, 3))
        pair_list.update(positions, cell)
        assert found_by(pair_list, cell, 1.5, positions) == expected(positions, cell, 1.5)


def test_a_million_cells_away_is_still_here():
    rng = np.random.default_rng(3)
    positions, far = rng.uniform(0, 5, (20, 3)), rng.integers(-(2**20), 2**20, (20, 3)) * 5.0
    near = md.neighbor_list("ijd", md.System(positions, cell=5.0), 2.0)
    away = md.neighbor_list("ijd", md.System(positions + far, cell=5.0), 2.0)
    assert np.array_equal(near[0], away[0])
    assert np.sort(near[2]) == pytest.approx(np.sort(away[2]), abs=4e-9)  # rounding of the far coordinates


def test_empty_space_costs_nothing():
    system = md.System([[0, 0, 0], [1, 0, 0], [1e6, 0, 0], [0, 1e6, 1e6]])
    assert md.neighbor_list("ij", system, 1.5)[0].tolist() == [0, 1]
    gas = md.System(np.random.default_rng(1).uniform(0, 1e4, (50, 3)), cell=1e4)
    assert len(md.neighbor_list("d", gas, 1e-3)) == 0


def test_excluded_pairs_lose_their_nearest_image_only():
    system = md.System([[0.0, 0, 0], [0.9, 0, 0]], cell=2.0)
    pair_list = PairList(2, 1.5, 0.0, np.array([[0, 1]]))
    pair_list.update(system.positions, system.cell)
    distances, pairs = found_by(pair_list, system.cell, 1.5, system.positions)
    assert distances == pytest.approx([1.1])
    assert pairs == [(0, 1)]


@given(scenes())
@settings(max_examples=60)
def test_closest_pair_is_the_closest(scene):
    positions, cell, pbc, _ = scene
    system = md.System(positions, cell=cell, pbc=pbc)
    closest = closest_pair(system)
    if closest is None:
        assert len(positions) == 1
        assert not pbc.any()
        return
    found = brute_force_pairs(positions, cell, pbc, closest.distance * (1 + 1e-9))
    assert {(i, j) for i, j, *_ in found} >= {(closest.first, closest.second)}
    assert not brute_force_pairs(positions, cell, pbc, closest.distance * (1 - 1e-9))


def test_closest_pair_is_found_though_others_were_flung_away():
    def closest_of(positions):  # past the door, as a run that blows up goes
        system = md.System(np.zeros((len(positions), 3)))
        system.positions[:] = positions
        return closest_pair(system)

    assert closest_of(np.array([[0.0, 0.0, 0.0], [1e200, 0.0, -1e180], [0.0, 3.0, 0.0], [0.0, 5.0, 0.0]])) == (
        2,
        3,
        2.0,
    )
    assert closest_of(1e200 * np.eye(3)[:2]) is None
