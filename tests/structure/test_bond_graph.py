"""Pairs one, two and three bonds apart, along the shortest path."""

import numpy as np

from minimd.structure.bond_graph import pairs_by_bonds_apart


def distances_by_matrix_powers(bonds, n):
    adjacency = np.zeros((n, n), dtype=bool)
    for i, j in bonds:
        adjacency[i, j] = adjacency[j, i] = True
    distance, reached, power = np.full((n, n), 9), np.eye(n, dtype=bool), np.eye(n, dtype=bool)
    for apart in (1, 2, 3):
        power = power @ adjacency
        distance[power & ~reached] = apart
        reached |= power
    return distance


def test_shortest_path_decides_in_any_graph():
    rng = np.random.default_rng(5)
    for n, density in ((2, 1.0), (6, 0.3), (12, 0.15), (20, 0.1), (8, 0.6)):
        bonds = np.argwhere(np.triu(rng.random((n, n)) < density, k=1))
        expected = distances_by_matrix_powers(bonds, n)
        for apart, pairs in enumerate(pairs_by_bonds_apart(bonds), start=1):
            assert pairs.tolist() == np.argwhere(np.triu(expected == apart, k=1)).tolist()


def test_ring_of_four_has_no_third_neighbors():
    one, two, three = pairs_by_bonds_apart(np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))
    assert (len(one), len(two), len(three)) == (4, 2, 0)
