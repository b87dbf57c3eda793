"""Cells, crystals, units, and pairs some bonds apart: the same lattice, the nearest image, the shortest path."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from wrong_calls import answered

import minimd as md
from minimd.core.structure.bond_graph import pairs_by_bonds_apart
from minimd.core.structure.cell import Cell, minimum_image_translations

NEIGHBORS = {
    "sc": (6, 1),
    "bcc": (8, 0.75**0.5),
    "fcc": (12, 0.5**0.5),
    "diamond": (4, 3**0.5 / 4),
    "square": (4, 1),
    "triangular": (6, 1),
}
SIDE = [[20.0, 0.0, 0.0], [0.0, 20.0, 0.0], [20.0, 20.0, 0.0]]
SLAB = "pbc=(True, True, False)"
test_messages_about_cells_name_pbc_where_it_is_the_cure = answered(
    (lambda: md.System(np.eye(3), cell=[20, 20, None]), ValueError, "None", SLAB),
    (lambda: md.System(np.eye(3), cell=[20, 20]), ValueError, "(2,)", SLAB),
    (lambda: md.System(np.eye(3), cell=SIDE), ValueError, "linearly independent", SLAB),
    (lambda: md.System(np.eye(3), cell=[20, 20, 0], pbc=True), ValueError, "cell[2]", SLAB),
    (lambda: md.System(np.eye(3), cell=[3, 3, -1]), ValueError, "negative", "-1"),
)


@st.composite
def cells(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    vectors = rng.normal(size=(3, 3))
    for _ in range(draw(st.integers(0, 3))):
        i, j = rng.permutation(3)[:2]
        vectors[i] += draw(st.integers(-6, 6)) * vectors[j]
    assume(abs(np.linalg.det(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))) > 1e-4)
    return Cell.of(vectors, draw(st.tuples(st.booleans(), st.booleans(), st.booleans())))


@given(cells())
def test_reduced_lattice_is_the_same_lattice_with_shorter_vectors(cell):
    pbc, open_rows = cell.pbc, cell.lattice[~cell.pbc]
    assert not pbc.any() or abs(round(np.linalg.det(cell.reduction[np.ix_(pbc, pbc)]))) == 1
    assert np.allclose(cell.reduction[pbc] @ cell.vectors, cell.lattice[pbc])
    before, after = (np.linalg.norm(rows[pbc], axis=1).sum() for rows in (cell.vectors, cell.lattice))
    assert after <= before * (1 + 1e-12)
    assert np.allclose(open_rows @ open_rows.T, np.eye(len(open_rows)))
    assert np.allclose(open_rows @ cell.lattice[pbc].T, 0.0)


def test_a_cell_of_nearly_parallel_vectors_is_reduced_at_once():
    """The longest vector is reduced by combinations of shorter ones that are reduced themselves: not ten million times
    by the difference of two that are nearly parallel."""
    cell = Cell.of(10.0 * np.array([[1.0, 0.0, 0.0], [1.0, 1e-7, 0.0], [0.3, 1.0, 1.0]]))
    assert np.allclose(cell.reduction @ cell.vectors, cell.lattice)
    assert np.allclose(np.sort(np.linalg.norm(cell.lattice, axis=1)), [1e-6, 10.0, 10.0 * 1.09**0.5])


@given(cells(), st.integers(0, 2**32 - 1))
def test_minimum_image_is_the_shortest_of_all(cell, seed):
    vector, translations = np.random.default_rng(seed).normal(size=3) * 3.0, np.zeros((1, 3))
    of_cell = cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2
    minimum_image_translations(np.array([0 * vector, vector]), np.array([0]), np.array([1]), *of_cell, translations)
    around = np.rint(-vector @ cell.inverse) * cell.pbc
    steps = np.array(list(itertools.product(range(-4, 5), repeat=3))) * cell.pbc
    best = np.linalg.norm(vector + (around + steps) @ cell.lattice, axis=1).min()
    assert np.linalg.norm(vector + translations[0]) == pytest.approx(best, abs=1e-9)


@given(cells(), st.integers(0, 2**32 - 1))
def test_wrapping_moves_by_lattice_vectors_into_the_cell(cell, seed):
    positions = np.random.default_rng(seed).normal(size=(5, 3)) * 10
    wrapped, full = cell.wrapped(positions), np.where(cell.pbc[:, None], cell.vectors, cell.lattice)
    fractional, steps = wrapped @ np.linalg.inv(full), (wrapped - positions) @ np.linalg.inv(full)
    assert np.all((fractional[:, cell.pbc] > -1e-8) & (fractional[:, cell.pbc] < 1 + 1e-8))
    assert np.allclose(steps, np.rint(steps), atol=1e-7)
    assert np.allclose(steps[:, ~cell.pbc], 0.0, atol=1e-9)


def test_volume_is_that_of_the_user_s_vectors_and_numbers_have_their_units():
    assert Cell.of([[2, 0, 0], [50, 3, 0], [7, -9, -4]]).volume == pytest.approx(24.0)
    assert Cell.of([2, 3, 4], (True, True, False)).volume is Cell.of(None).volume is None
    assert "(0, 0, 9) σ, open" in str(md.System(np.eye(3), cell=[3.0, 3.0, 9.0], pbc=(True, True, False)))
    argon = md.System(np.eye(3), masses=40.0, cell=4.0, units=md.units.ASE)  # 120 u in 64 Å³
    assert [words for words in ("volume         64 Å³\n", "3.11351 g/cm³") if words not in str(argon)] == []
    assert md.units.ASE.shown(12345600.0 * md.units.fs) == "12345.6 ps"


@pytest.mark.parametrize("lattice", md.lattice.BASES)
def test_every_lattice_has_its_nearest_neighbors_and_the_density_it_was_asked_for(lattice):
    neighbors, distance = NEIGHBORS[lattice]
    planar = lattice in ("square", "triangular")
    repeat = (3, 4) if planar else (3, 4, 5)
    positions, edges = md.lattice.crystal(lattice, repeat, 2.0)
    assert len(positions) == np.prod(repeat) * len(md.lattice.BASES[lattice])
    expected = [6.0, 8.0 * 3**0.5] if lattice == "triangular" else [6.0, 8.0, 10.0][: len(repeat)]
    assert edges == pytest.approx(expected)
    first, d = md.neighbor_list("id", md.System(positions, cell=edges, planar=planar), 2.0 * distance * 1.01)
    assert np.all(np.bincount(first) == neighbors)
    assert d == pytest.approx(2.0 * distance)
    constant = md.lattice.constant_from_density(lattice, density=1.7, mass=3.0)
    positions, edges = md.lattice.crystal(lattice, [2] * len(repeat), constant)
    assert len(positions) * 3.0 / edges.prod() == pytest.approx(1.7)


def test_the_shortest_path_along_bonds_decides_in_any_graph():
    """By powers of the matrix of neighbors, which find it another way; a ring of four has no third neighbors."""
    rng, graphs = np.random.default_rng(5), [(4, np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))]
    for n, density in ((2, 1.0), (6, 0.3), (12, 0.15), (20, 0.1), (8, 0.6)):
        graphs.append((n, np.argwhere(np.triu(rng.random((n, n)) < density, k=1))))
    for n, bonds in graphs:
        adjacency = np.zeros((n, n), dtype=bool)
        adjacency[bonds[:, 0], bonds[:, 1]] = adjacency[bonds[:, 1], bonds[:, 0]] = True
        reached = power = np.eye(n, dtype=bool)
        for pairs in pairs_by_bonds_apart(bonds):
            power = power @ adjacency
            assert pairs.tolist() == np.argwhere(np.triu(power & ~reached, k=1)).tolist()
            reached = reached | power
    assert [len(pairs) for pairs in pairs_by_bonds_apart(graphs[0][1])] == [4, 2, 0]


def test_chains_are_walks_that_do_not_turn_back():
    """Lengths, density, distances of next neighbors but one, and ⟨R²⟩ of 20 000 chains within 4 standard errors."""
    n, beads, b, c = 20_000, 9, 0.97, 0.25
    positions, edges, bonds = md.lattice.chains(n, beads, density=0.85, bond_length=b, seed=3)
    walks = positions.reshape(n, beads, 3)
    assert len(bonds) == n * (beads - 1)
    assert np.linalg.norm(positions[bonds[:, 1]] - positions[bonds[:, 0]], axis=1) == pytest.approx(b, rel=1e-12)
    assert n * beads / edges.prod() == pytest.approx(0.85, rel=1e-12)
    assert np.linalg.norm(walks[:, 2:] - walks[:, :-2], axis=2).min() >= b * (1.0 - 1e-12)
    steps = beads - 1
    expected = b * b * steps * ((1.0 + c) / (1.0 - c) - 2.0 * c * (1.0 - c**steps) / (steps * (1.0 - c) ** 2))
    squares = np.square(walks[:, -1] - walks[:, 0]).sum(axis=1)
    assert squares.mean() == pytest.approx(expected, abs=4.0 * squares.std() / np.sqrt(n))
    assert np.array_equal(positions, md.lattice.chains(n, beads, 0.85, b, seed=3)[0])


def test_chains_can_be_minimized_and_run():
    positions, edges, bonds = md.lattice.chains(8, beads=10, density=0.85)
    laws = [md.LennardJones(1.0, 1.0, cutoff=2 ** (1 / 6), bonded_scale=(0, 1, 1)), md.FENEBond(30.0, 1.5)]
    bath = md.LangevinBAOAB(0.005, 1.0, friction=0.5, seed=1)
    sim = md.Simulation(md.System(positions, cell=edges, bonds=bonds), laws, bath)
    sim.minimize()
    sim.set_temperature(1.0, seed=1)
    assert sim.run(100, every=10).temperature[-1] < 2.0


test_wrong_chains_are_answered = answered(
    (lambda: md.lattice.chains(0, 5, 0.8), ValueError, "n", "0"),
    (lambda: md.lattice.chains(5, 2.5, 0.8), ValueError, "beads", "2.5"),
    (lambda: md.lattice.chains(5, 5, -0.8), ValueError, "density", "-0.8"),
    (lambda: md.lattice.chains(10**6, 10**6, 0.8), ValueError, "atoms", "1000000000000"),
)


BENT = md.System(
    [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]],
    species=["C", "O", "O", "H"],
    masses=[12.0, 16.0, 16.0, 1.0],
    charges=[0.3, -0.1, -0.2, 0.0],
    bonds=[[0, 1], [1, 2], [2, 3]],
    angles=[[0, 1, 2], [1, 2, 3]],
    dihedrals=[[0, 1, 2, 3]],
    impropers=[[1, 0, 2, 3]],
    constraints=[md.DistanceConstraints([[0, 1], [0, 2]], tolerance=1e-9, solver="shake")],
    units=md.units.ASE,
)
NEON = md.System([[7.0, 0.0, 0.0]], species="Ne", masses=20.0, units=md.units.ASE)


def test_packed_molecules_keep_their_distance_through_the_faces_of_the_cell():
    edges = np.array([14.0, 17.0, 20.0])
    distance = 2.1
    mixture = md.lattice.packing([(NEON, 60), (BENT, 90)], edges, distance, seed=2)
    label = np.concatenate([np.arange(60), 60 + np.repeat(np.arange(90), 4)])
    apart = mixture.positions[:, None] - mixture.positions
    apart -= edges * np.rint(apart / edges)
    lengths = np.linalg.norm(apart, axis=2)[label[:, None] != label]
    assert distance <= lengths.min() < 1.01 * distance
    assert np.array_equal(mixture.positions, md.lattice.packing([(NEON, 60), (BENT, 90)], edges, 2.1, 2).positions)
    assert not np.array_equal(mixture.positions, md.lattice.packing([(NEON, 60), (BENT, 90)], edges, 2.1).positions)


def test_packed_molecules_are_those_given_with_all_that_belongs_to_them():
    mixture = md.lattice.packing([(BENT, 3), (NEON, 2), (BENT, 1)], 20.0, 2.0)
    starts = np.array([0, 4, 8, 14])
    assert (mixture.units, mixture.cell.vectors.tolist()) == (md.units.ASE, (20.0 * np.eye(3)).tolist())
    assert mixture.species.tolist() == 3 * BENT.species.tolist() + ["Ne", "Ne"] + BENT.species.tolist()
    for name, of_neon in (("masses", [20.0, 20.0]), ("charges", [0.0, 0.0])):
        of_one = getattr(BENT, name).tolist()
        assert getattr(mixture, name).tolist() == 3 * of_one + of_neon + of_one
    for name in ("bonds", "angles", "dihedrals", "impropers"):
        shifted = [getattr(BENT, name) + start for start in starts]
        assert getattr(mixture, name).tolist() == np.concatenate(shifted).tolist()
    (rigid,) = mixture.constraints
    assert rigid.pairs.tolist() == [[k + first, k + second] for k in starts for first, second in ((0, 1), (0, 2))]
    assert (rigid.lengths.tolist(), rigid.tolerance, rigid.solver) == (4 * [1.0, 2.0**0.5], 1e-9, "shake")
    places = mixture.positions[starts[:, None] + np.arange(4)]
    steps = np.diff(places, axis=1)
    assert steps @ steps.swapaxes(1, 2) == pytest.approx(np.broadcast_to(np.eye(3), (4, 3, 3)), abs=1e-13)  # rounding
    assert np.linalg.det(steps) == pytest.approx(1.0, abs=1e-13)  # not mirrored


def test_packed_molecules_are_turned_evenly_and_stand_everywhere():
    """Means of R_ij are 0, of R_ij² 1/3, of R_ij⁴ 1/5, of places 1/2 of the edge, within 4 standard errors."""
    n = 8000
    box = md.lattice.packing([(BENT, n)], 100.0, 0.5, seed=4)
    turns = np.diff(box.positions.reshape(n, 4, 3), axis=1)
    for power, expected in ((1, 0.0), (2, 1.0 / 3.0), (4, 1.0 / 5.0)):
        error = np.sqrt((1.0 / (2 * power + 1) - expected**2) / n)
        assert np.abs((turns**power).mean(axis=0) - expected).max() < 4.0 * error
    inside = box.positions[::4] % 100.0 / 100.0
    assert np.abs(inside.mean(axis=0) - 0.5).max() < 4.0 / np.sqrt(12.0 * n)


PLANE = md.System([[0.0, 0.0]], planar=True)
SITED = md.System([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.0, 0.0]], sites=md.Sites([2], [[0, 1]], [0.5, 0.5]))
HELD = md.System([[0.0, 0.0, 0.0]], constraints=[md.FixedAtoms([0])])
test_wrong_packings_are_answered = answered(
    (lambda: md.lattice.packing([(BENT, 500), (NEON, 9)], 13.0, 2.5), ValueError, "of 500 copies of molecules[0]"),
    (lambda: md.lattice.packing([(NEON, 5), (BENT, 5)], 3.5, 2.0), ValueError, "edges", "3.87083", "3.5"),
    (lambda: md.lattice.packing([(BENT, 0)], 10.0, 2.0), ValueError, "molecules[0][1]", "0"),
    (lambda: md.lattice.packing((BENT, 5), 10.0, 2.0), TypeError, "molecules[0]", "System"),
    (lambda: md.lattice.packing([(NEON, 10**9)], 10.0, 2.0), ValueError, "molecules", "1000000000"),
    (lambda: md.lattice.packing([], 10.0, 2.0), ValueError, "molecules", "0"),
    (lambda: md.lattice.packing([(NEON, 5)], [10.0, 5.0], 2.0), ValueError, "edges", "(2,)"),
    (lambda: md.lattice.packing([(NEON, 5)], 10.0, -2.0), ValueError, "distance", "-2.0"),
    (lambda: md.lattice.packing([(NEON, 5)], 10.0, 2.0, seed=-1), ValueError, "seed", "-1"),
    (lambda: md.lattice.packing([(NEON, 5), (HELD, 2)], 9.0, 2.0), ValueError, "molecules[1]", "'LJ'"),
    (lambda: md.lattice.packing([(HELD, 2)], 9.0, 2.0), ValueError, "molecules[0]", "FixedAtoms"),
    (lambda: md.lattice.packing([(PLANE, 2)], 9.0, 2.0), ValueError, "molecules[0]", "in space"),
    (lambda: md.lattice.packing([(SITED, 2)], 9.0, 2.0), ValueError, "molecules[0]", "Sites"),
)
