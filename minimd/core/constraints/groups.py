"""Groups of constraints of one shape, each with the solver that suits it, on several threads: no two components share
an atom.

A solver is a function solver(first, last, *arguments) that treats components first to last − 1. It is named by a
marker, a NamedTuple class that type_of(solver) ties to it, so that the next process finds the compiled kernel.

Constraints that share an atom are coupled:  A_kl = (r_k · s_l) c_kl  with  c_kk = 1/m_i + 1/m_j, c_kl = ±1/m of the
shared atom. In the order of the distance to an end, the farthest first (of the user where it is the same, the last
first), the matrix of a chain is tridiagonal, that of a ring or a sheet has a narrow band, and that of a small cage is
full. Elimination fills nothing outside the envelope, so one factorization serves them all. A. George, J. W. Liu,
Computer Solution of Large Sparse Positive Definite Systems (1981), 4.
"""

from collections import defaultdict, namedtuple
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, by_type, filling_kernel
from minimd.core.compiled.program import CANNOT_KEEP, GO_ON, Operation, operation, share_of
from minimd.core.compiled.simd.vector import lanes_for
from minimd.core.compiled.threads import MOST_CHUNKS
from minimd.core.constraints import closed_forms, networks
from minimd.core.constraints.closed_forms import Atoms, Bonds, TriatomicMolecules
from minimd.core.constraints.networks import NetworkScratch, dependent_constraint
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import connected


class Components(NamedTuple):
    """The components of a graph, and the envelope of their matrices.
    starts : (C + 1,) indices at which the constraints of each component begin.
    atoms, atom_starts : atoms of the components, one after the other, and where each component begins among them.
    origins : (K,) in memory, where column 0 of each row would be: c_kl and A_kl have the place origins[k] + l.
    lowest : (K,) first column of each row of the lower envelope.
    coupling : c_kl for l = lowest[k] … k, row after row; zero where two constraints share no atom."""

    starts: Indices
    atoms: Indices
    atom_starts: Indices
    origins: Indices
    lowest: Indices
    coupling: Array


class Graph(NamedTuple):
    """Constraints sorted by component and, within one, for a narrow band.
    order : (K,) number, in the order of the user, of the k-th constraint.
    first, second : (K,) its atoms."""

    order: Indices
    first: Indices
    second: Indices
    components: Components


class Bodies(NamedTuple):
    """Bodies of atoms that constraints connect.
    label : (N,) the body of each atom; an atom without constraints is a body.
    last : (B,) the last atom of each body, in the order of its pairs, which the numbers of atoms do not change.
    is_free : (B,) whether none of its atoms is held fixed, so that constraints do not change its momentum."""

    label: Indices
    last: Indices
    is_free: NDArray[np.bool_]


def bodies_of(pairs: Indices, inverse_masses: Array) -> Bodies:
    """The bodies formed by pairs of atoms.

    pairs : (K, 2).
    inverse_masses : (N,) [1/mass], zero for atoms that are held fixed."""
    n = len(inverse_masses)
    label = connected(pairs, n)
    n_bodies = 1 + label.max()
    last = np.zeros(n_bodies, dtype=np.int64)
    is_free = np.ones(n_bodies, dtype=bool)
    last[label] = np.arange(n)
    last[label[pairs[:, 1]]] = pairs[:, 1]
    is_free[label[inverse_masses == 0.0]] = False
    return Bodies(label, last, is_free)


def graph_of(pairs: Indices, inverse_masses: Array, ids: Indices) -> Graph:
    """The graph of pairs of atoms.

    pairs : (K, 2).
    inverse_masses : (N,) [1/mass], zero for atoms that are held fixed.
    ids : (K,) numbers of the pairs, in the order of the user."""
    from scipy.sparse import coo_array  # loaded only if there are constraints
    from scipy.sparse.csgraph import connected_components, dijkstra

    n_atoms = len(inverse_masses)
    n_pairs = len(pairs)
    # a fixed atom does not couple its constraints: in each of them it is a body of its own
    apart = n_atoms + np.arange(2 * n_pairs).reshape(-1, 2)
    bodies = np.where(inverse_masses[pairs] > 0.0, pairs, apart)
    body_masses = np.concatenate([inverse_masses, np.zeros(2 * n_pairs)])
    # of 32 bits: scipy 1.13 has no shortest paths for others
    places = np.array([np.repeat(np.arange(n_pairs), 2), bodies.reshape(-1)], dtype=np.int32)
    signs = np.tile([-1.0, 1.0], n_pairs)

    incidence = coo_array((signs, tuple(places)), shape=(n_pairs, len(body_masses))).tocsr()
    coupled = ((incidence * body_masses) @ incidence.T).tocsr()
    label = connected_components(coupled)[1]

    by_degree = np.lexsort((np.diff(coupled.indptr), label))
    ends = by_degree[np.flatnonzero(np.diff(label[by_degree], prepend=-1))]
    distances = dijkstra(abs(coupled), unweighted=True, indices=ends, min_only=True)
    order = np.lexsort((distances, -label))[::-1]
    label = label[order]
    starts = np.flatnonzero(np.diff(label, prepend=-1, append=label[-1] + 1))

    matrix = coupled[order][:, order].tocoo()
    pairs = pairs[order]
    components = _enveloped(pairs, inverse_masses, starts, matrix)
    first, second = np.ascontiguousarray(pairs.T)
    return Graph(ids[order], first, second, components)


def _enveloped(pairs: Indices, inverse_masses: Array, starts: Indices, matrix: Any) -> Components:
    """The envelope of the lower triangle, and the atoms of each component.
    pairs : in the order of the matrix."""
    k = np.arange(len(pairs))
    row, column = matrix.coords
    lowest = k.copy()
    np.minimum.at(lowest, row, np.minimum(column, row))
    origins = np.cumsum(k - lowest + 1) - k - 1
    coupling = np.zeros(origins[-1] + len(pairs))
    below = column <= row
    coupling[origins[row[below]] + column[below]] = matrix.data[below]

    atoms = [np.unique(pairs[start:end]) for start, end in pairwise(starts)]
    moving = [members[inverse_masses[members] > 0.0] for members in atoms]
    atom_starts = np.concatenate([[0], np.cumsum([members.size for members in moving])])
    return Components(starts, np.concatenate(moving), atom_starts, origins, lowest, coupling)


# relative: a triangle with a side as long as the others together is a line; files have nine digits
STRAIGHT = 1e-9
# least number: about ten microseconds of work, more than the time to wake a thread
CONSTRAINTS_IN_A_CHUNK = 500
ALIKE = 1e-12  # relative: masses and squared lengths that differ by less are equal


class Solving(ByAddress, namedtuple("Solving", "solver atoms n answers most arguments")):
    """A solver on the n components of a group, in as many chunks as there are answers.
    atoms : Atoms.
    arguments : of the solver after the atoms.
    answers : (chunks,) output, see vectors.
    most : (chunks,) the largest so far."""


@filling_kernel
def solve_chunk(solving, chunk):
    """The solver on some components.  CANNOT_KEEP if a constraint cannot be kept."""
    n = solving.n
    n_chunks = solving.answers.size
    first, last = share_of(chunk, n_chunks, n)
    answer = _solved(solving.solver, first, last, solving.atoms, solving.arguments)
    solving.answers[chunk] = answer
    solving.most[chunk] = max(answer, solving.most[chunk])
    return GO_ON if answer >= 0 else CANNOT_KEEP


@by_type
def _solved(solver, first, last, atoms, arguments):
    function = solver.instance_class.formula
    return lambda solver, first, last, atoms, arguments: function(first, last, atoms, *arguments)


class Networks:
    """Components of any shape.
    every : the ConstraintSolver.
    order : (K,) which of its constraints are here.
    Other shapes have other solvers: drifter, projector are their markers, known are their arguments after the atoms;
    n_each is the number of constraints of one molecule, if the solver counts molecules."""

    shape = "networks"
    n_each = 1
    drifter: tuple = networks.DriftComponents()
    projector: tuple = networks.ProjectComponents()

    def __init__(self, every: Any, graph: Graph, positions: Array) -> None:
        self.order = graph.order
        self.graph = graph
        self.masses = every.inverse_masses
        self.bonds = Bonds(
            graph.first,
            graph.second,
            np.ascontiguousarray(every.offsets[graph.order]),
            every.lengths[graph.order] ** 2,
            every.tolerance,
        )

        k = graph.order.size
        n = graph.components.coupling.size
        self.n_constraints = k
        self.n_components = graph.components.starts.size - 1
        n_chunks = max(1, min(self.n_components, k // CONSTRAINTS_IN_A_CHUNK, MOST_CHUNKS))
        self.answers, self.most = np.zeros((2, n_chunks), dtype=np.int64)
        self._calls: defaultdict[Any, DirectCalls] = defaultdict(DirectCalls)
        self.memory = NetworkScratch(
            np.empty((k, 3)), np.empty((k, 3)), np.empty(k), np.zeros(k), np.empty(n), np.empty(n)
        )
        self.multipliers = self.memory.total  # (K,), the last ones
        self.known = self._known(positions)

    def _known(self, positions: Array) -> tuple:
        """The arguments of solvers.
        Raises ValueError if a constraint depends on the others."""
        graph = self.graph
        k = dependent_constraint(positions, graph.components, self.bonds, self.memory)
        if k >= 0:
            raise ValueError(
                f"constraint {self.order[k]} (atoms {graph.first[k]}-{graph.second[k]}) follows from the other "
                "constraints or contradicts them; leave it out"
            )
        return graph.components, self.bonds, self.memory

    def offsets(self) -> list[Array]:
        """All arrays (…, 3) of lattice translations that its solvers read."""
        offsets = [self.bonds.offsets]
        for argument in self.known:
            if isinstance(argument, TriatomicMolecules):
                offsets += argument.offsets
        return offsets

    def drift(self, positions: Array, velocities: Array, duration: float) -> Operation:
        """Drift of the atoms of the group."""
        return self._solve(self.drifter, positions, velocities, float(duration))

    def project(self, positions: Array, vectors: Array, targets: Array) -> Operation:
        """r_ij · x_ij = targets for the vectors x."""
        return self._solve(self.projector, positions, vectors, targets, self.multipliers)

    def _solve(self, solver: tuple, positions: Array, vectors: Array, *more: Any) -> Operation:
        atoms = Atoms(positions, vectors, self.masses, lanes_for())
        arguments = (*self.known, *more)
        solving = Solving(solver, atoms, self.n_components, self.answers, self.most, arguments)
        calls = self._calls[type(solver), positions.flags.carray, vectors.flags.carray]
        return operation(calls, solve_chunk, solving, len(self.answers))

    def failed(self, of_drift: bool) -> int:
        """After CANNOT_KEEP: the constraint, within the group, that cannot be kept; of a molecule its first one."""
        answer = int(self.answers[self.answers < 0][0])
        return (-1 - answer) * (self.n_each if of_drift else 1)


class LoneBonds(Networks):
    """Bonds that share no atom."""

    shape = "bonds of their own"
    drifter = closed_forms.DriftPairs()
    projector = closed_forms.ProjectPairs()

    def _known(self, positions: Array) -> tuple:
        return super()._known(positions)[1:2]


class Sweeps(Networks):
    """Components of any shape, by SHAKE, and by RATTLE if all targets are zero."""

    shape = "networks, by sweeps"
    drifter = networks.SweepDrift()

    def project(self, positions: Array, vectors: Array, targets: Array) -> Operation:
        """See Networks."""
        solver = networks.ProjectComponents() if targets.any() else networks.SweepVelocities()
        return self._solve(solver, positions, vectors, targets, self.multipliers)


class Triangles(Networks):
    """Triangles with two equal sides whose outer atoms have equal masses: water."""

    shape = "triangles"
    drifter = closed_forms.DriftTriangles()
    projector = closed_forms.ProjectTriangles()
    n_each = 3

    def _known(self, positions: Array) -> tuple:
        super()._known(positions)
        lengths2 = self.bonds.lengths2
        starts = self.graph.components.starts[:-1]
        base = _equal_sides(self.graph, starts, lengths2, self.masses)
        corners, arms, sides = _corners(self.graph, base, self.bonds.offsets)

        half = 0.5 * np.sqrt(lengths2[base])
        heavy = 1.0 / self.masses[corners[0]]
        light = 1.0 / self.masses[corners[1]]
        height = np.sqrt(lengths2[sides[0]] - half * half)
        share = light / (heavy + 2.0 * light)
        shapes = 2.0 * share * height, (1.0 - 2.0 * share) * height, half, share
        return (TriatomicMolecules(corners, arms, shapes, (*sides, base)),)


class LinearTriatomics(Networks):
    """Three atoms in a line: the distance of the outer ones is kept, and the place of the middle one between them.
    Their constraints depend on each other, and their solver takes this into account."""

    shape = "linear molecules"
    drifter = closed_forms.DriftLinear()
    projector = closed_forms.ProjectLinear()
    n_each = 3

    def _known(self, positions: Array) -> tuple:
        self.n_constraints = 4 * self.n_components
        lengths2 = self.bonds.lengths2
        starts = self.graph.components.starts[:-1]
        longest = starts + np.argmax(lengths2.reshape(-1, 3), axis=1)

        # the middle one is the corner opposite the longest side
        corners, (to_b, to_c), (short, _) = _corners(self.graph, longest, self.bonds.offsets)
        middle, b, c = corners
        beta = np.sqrt(lengths2[short] / lengths2[longest])
        shapes = (1.0 - beta, beta, lengths2[longest])
        offsets = (-to_b, to_c - to_b)
        return (TriatomicMolecules((b, middle, c), offsets, shapes, longest),)


def groups_of(every: Any, positions: Array, solver: str) -> list[Any]:
    """All constraints, sorted by shape.
    solver : as for DistanceConstraints.
    Raises ValueError for a triangle with a side longer than the others together."""
    pairs = every.pairs
    masses = every.inverse_masses
    graph = graph_of(pairs, masses, np.arange(len(pairs)))
    order = graph.order
    kinds = np.full(order.size, Sweeps if solver == "shake" else Networks, dtype=object)
    starts = graph.components.starts[:-1]
    sizes = np.diff(graph.components.starts)
    lengths2 = every.lengths[order] ** 2
    if solver == "auto":
        kinds[starts[sizes == 1]] = LoneBonds

    starts = starts[sizes == 3]
    is_closed = [np.unique(pairs[order[start : start + 3]]).size == 3 for start in starts]
    starts = starts[np.array(is_closed, dtype=bool)]

    sides = starts[:, None] + np.arange(3)
    lengths = np.sqrt(lengths2[sides])
    around = lengths.sum(axis=1)
    excess = 2.0 * lengths.max(axis=1, initial=0.0) - around
    if (excess > STRAIGHT * around).any():
        raise ValueError(
            f"the lengths of constraints {order[sides[np.argmax(excess)]].tolist()}, which form a triangle, contradict "
            "each other: one is longer than the sum of the other two"
        )

    if solver == "auto":
        moves = (masses[pairs[order[sides]]] > 0.0).all(axis=(1, 2))
        kinds[sides[(_equal_sides(graph, starts, lengths2, masses) >= 0) & moves]] = Triangles
    kinds[sides[excess >= -STRAIGHT * around]] = LinearTriatomics

    groups = []
    for kind in dict.fromkeys(kinds):
        ids = order[kinds == kind]
        groups.append(kind(every, graph_of(pairs[ids], masses, ids), positions))
    return groups


def _equal_sides(graph: Graph, starts: Indices, lengths2: Array, inverse_masses: Array) -> Indices:
    """Of each triangle the constraint whose ends have equal masses, equally far from the third atom; −1 if none has."""
    answer = np.full(len(starts), -1)
    for k in range(3):
        base = starts + k
        side, other = np.delete(np.arange(3), k)
        is_isosceles = _alike(lengths2[starts + side], lengths2[starts + other])
        masses = inverse_masses[graph.first[base]], inverse_masses[graph.second[base]]
        is_base = is_isosceles & _alike(*masses)
        answer[is_base] = base[is_base]
    return answer


def _alike(a: Array, b: Array) -> NDArray[np.bool_]:
    return np.isclose(a, b, rtol=ALIKE, atol=0.0)


def _corners(
    graph: Graph, base: Indices, offsets: Array
) -> tuple[tuple[Indices, ...], tuple[Array, ...], tuple[Indices, ...]]:
    """Of each triangle: atoms apex, b, c; offsets of b and c from the apex; constraints apex-b and apex-c.

    base : (T,) the constraint b-c of each.
    offsets : (K, 3) [length]."""
    starts = graph.components.starts[:-1]
    sides = starts[:, None] + np.arange(3)
    sums = graph.first[sides] + graph.second[sides]  # of the numbers of both atoms
    b, c = graph.first[base], graph.second[base]
    apex = sums.sum(axis=1) // 2 - b - c
    arms = []
    shifts = []

    for end in (b, c):
        arm = starts + np.argmax(sums == (apex + end)[:, None], axis=1)
        sign = np.where(graph.first[arm] == apex, 1.0, -1.0)
        arms.append(arm)
        shifts.append(sign[:, None] * offsets[arm])

    return (apex, b, c), tuple(shifts), tuple(arms)
