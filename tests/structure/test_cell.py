"""Cells: the reduced lattice is the same lattice, and the nearest image is the nearest."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from minimd.structure.cell import Cell, minimum_image_translations


@st.composite
def cells(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    vectors = rng.normal(size=(3, 3))
    for _ in range(draw(st.integers(0, 3))):
        i, j = rng.permutation(3)[:2]
        vectors[i] += draw(st.integers(-6, 6)) * vectors[j]
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    assume(abs(np.linalg.det(unit)) > 1e-4)
    return Cell.of(vectors, draw(st.tuples(st.booleans(), st.booleans(), st.booleans())))


@given(cells())
def test_reduced_lattice_is_the_same_lattice_with_shorter_vectors(cell):
    pbc = cell.pbc
    steps = cell.reduction[np.ix_(pbc, pbc)]
    assert abs(round(np.linalg.det(steps))) == 1 if pbc.any() else True
    assert np.allclose(cell.reduction[pbc] @ cell.vectors, cell.lattice[pbc])
    assert np.linalg.norm(cell.lattice[pbc], axis=1).sum() <= np.linalg.norm(cell.vectors[pbc], axis=1).sum() * (
        1 + 1e-12
    )
    open_rows = cell.lattice[~pbc]
    assert np.allclose(open_rows @ open_rows.T, np.eye(len(open_rows)))
    assert np.allclose(open_rows @ cell.lattice[pbc].T, 0.0)


@given(cells(), st.integers(0, 2**32 - 1))
def test_minimum_image_is_the_shortest_of_all(cell, seed):
    vector = np.random.default_rng(seed).normal(size=3) * 3.0
    positions, translations = np.array([np.zeros(3), vector]), np.zeros((1, 3))
    minimum_image_translations(
        positions, np.array([0]), np.array([1]), cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2, translations
    )
    found = np.linalg.norm(vector + translations[0])
    around = np.rint(-vector @ cell.inverse) * cell.pbc
    steps = np.array(list(itertools.product(range(-4, 5), repeat=3))) * cell.pbc
    best = np.linalg.norm(vector + (around + steps) @ cell.lattice, axis=1).min()
    assert found == pytest.approx(best, abs=1e-9)


@given(cells(), st.integers(0, 2**32 - 1))
def test_wrapping_moves_by_lattice_vectors_into_the_cell(cell, seed):
    positions = np.random.default_rng(seed).normal(size=(5, 3)) * 10
    wrapped = cell.wrapped(positions)
    full = np.where(cell.pbc[:, None], cell.vectors, cell.lattice)
    fractional, steps = wrapped @ np.linalg.inv(full), (wrapped - positions) @ np.linalg.inv(full)
    assert np.all((fractional[:, cell.pbc] > -1e-8) & (fractional[:, cell.pbc] < 1 + 1e-8))
    assert np.allclose(steps, np.rint(steps), atol=1e-7)
    assert np.allclose(steps[:, ~cell.pbc], 0.0, atol=1e-9)


def test_volume_is_that_of_the_user_s_vectors():
    assert Cell.of([[2, 0, 0], [50, 3, 0], [7, -9, -4]]).volume == pytest.approx(24.0)
    assert Cell.of([2, 3, 4], (True, True, False)).volume is None
    assert Cell.of(None).volume is None
