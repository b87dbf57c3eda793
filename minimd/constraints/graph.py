"""The graph of distance constraints: connected components, and an order in which their equations form a narrow band.

Constraints that share an atom are coupled:  A_kl = (r_k · s_l) c_kl  with  c_kk = 1/m_i + 1/m_j, c_kl = ±1/m of the
shared atom. In reverse Cuthill-McKee order the matrix of a chain is tridiagonal, that of a ring or a sheet has a narrow
band, and that of a small cage is full. Elimination fills nothing outside the envelope, so one factorization serves them
all. A. George, J. W. Liu, Computer Solution of Large Sparse Positive Definite Systems (1981), 4.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


class Components(NamedTuple):
    """The components of a graph, and the envelope of their matrices.

    starts : (C + 1,) indices at which the constraints of each component begin.
    atoms, atom_starts : atoms of the components, one after the other, and where each component begins among them.
    begins : (K + 1,) where row k of the lower envelope begins in memory.  lowest : (K,) its first column.
    coupling : c_kl for l = lowest[k] … k, row after row; zero where two constraints share no atom.
    """

    starts: Ints
    atoms: Ints
    atom_starts: Ints
    begins: Ints
    lowest: Ints
    coupling: Floats


class Graph(NamedTuple):
    """Constraints sorted by component and, within one, for a narrow band.

    order : (K,) number, in the order of the user, of the k-th constraint.  first, second : (K,) its atoms.
    """

    order: Ints
    first: Ints
    second: Ints
    components: Components


class Bodies(NamedTuple):
    """Bodies of atoms that constraints connect.

    label : (N,) the body of each atom; an atom without constraints is a body.  last : (B,) the last atom of each body.
    is_free : (B,) whether none of its atoms is held fixed, so that constraints do not change its momentum.
    """

    label: Ints
    last: Ints
    is_free: NDArray[np.bool_]


def bodies_of(pairs: Ints, inverse_masses: Floats) -> Bodies:
    """The bodies formed by (K, 2) pairs of atoms, with (N,) 1/mass, zero for atoms that are held fixed."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(inverse_masses)
    n_bodies, label = connected_components(coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n)), directed=False)
    last, is_free = np.zeros(n_bodies, dtype=np.int64), np.ones(n_bodies, dtype=bool)
    last[label] = np.arange(n)
    is_free[label[inverse_masses == 0.0]] = False
    return Bodies(label, last, is_free)


def graph_of(pairs: Ints, inverse_masses: Floats, ids: Ints) -> Graph:
    """The graph of (K, 2) pairs of atoms, with (N,) 1/mass, zero for fixed atoms.  ids : (K,) numbers of the pairs."""
    from scipy.sparse import coo_array  # loaded only if there are constraints
    from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee

    n = len(inverse_masses)
    apart = n + np.arange(pairs.size).reshape(-1, 2)  # a fixed atom does not couple its constraints
    bodies = np.where(inverse_masses[pairs] > 0.0, pairs, apart)
    graph = coo_array((np.ones(len(pairs)), bodies.T), shape=(n + pairs.size,) * 2)
    component = connected_components(graph, directed=False)[1]
    k, sides = np.repeat(np.arange(len(pairs)), 2), bodies.reshape(-1)
    incidence = coo_array((np.tile([-1.0, 1.0], len(pairs)), (k, sides)), shape=(len(pairs), n + pairs.size)).tocsr()
    weights = np.concatenate([inverse_masses, np.zeros(pairs.size)])
    coupled = (incidence * weights) @ incidence.T
    band_order = reverse_cuthill_mckee(coupled.tocsr(), symmetric_mode=True).astype(np.int64)
    label = component[bodies[band_order, 0]]
    order = band_order[np.argsort(label, kind="stable")]
    label = component[bodies[order, 0]]
    starts = np.flatnonzero(np.diff(label, prepend=-1, append=label[-1] + 1))
    matrix = coupled.tocsr()[order][:, order].tocoo()
    first, second = np.ascontiguousarray(pairs[order, 0]), np.ascontiguousarray(pairs[order, 1])
    return Graph(ids[order], first, second, _enveloped(pairs[order], inverse_masses, starts, matrix))


def _enveloped(pairs: Ints, inverse_masses: Floats, starts: Ints, matrix: Any) -> Components:
    """The envelope of the lower triangle, and the atoms of each component.  pairs : in the order of the matrix."""
    k = np.arange(len(pairs))
    row, column = matrix.coords
    lowest = k.copy()
    np.minimum.at(lowest, row, np.minimum(column, row))
    begins = np.concatenate([[0], np.cumsum(k - lowest + 1)])
    coupling = np.zeros(begins[-1])
    below = column <= row
    coupling[begins[row[below]] + column[below] - lowest[row[below]]] = matrix.data[below]
    moving = [np.unique(pairs[a:b][inverse_masses[pairs[a:b]] > 0.0]) for a, b in pairwise(starts)]
    atom_starts = np.concatenate([[0], np.cumsum([atoms.size for atoms in moving])])
    atoms = np.concatenate(moving) if moving else np.empty(0, dtype=np.int64)
    return Components(starts, atoms, atom_starts, begins, lowest, coupling)
