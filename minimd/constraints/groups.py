"""Constraints of one shape each, with the solver that suits it."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from minimd.constraints.graph import Graph, graph_of
from minimd.constraints.linear_triatomic import DriftRods, ProjectRods
from minimd.constraints.newton import DriftComponents, DriftPairs, Memory, ProjectComponents, ProjectPairs, dependent_constraint
from minimd.constraints.parallel import Crew
from minimd.constraints.settle import DriftTriangles
from minimd.constraints.shake import SweepDrift, SweepVelocities

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
MAX_ITERATIONS, MAX_SWEEPS = 50, 10_000
STRAIGHT = 1e-9  # three atoms whose longest distance is the sum of the others, to this fraction of it, lie in a line
ALIKE = 1e-12  # masses and squared lengths that differ by this fraction are the same


class Whole(Protocol):
    """What a group needs to know of all constraints, in the order of the user: see constraints.ConstraintSolver."""

    pairs: Ints
    lengths: Array
    offsets: Array
    inverse_masses: Array
    tolerance: float
    threads: int


class Networks:
    """Components of any shape. order : (K,) which constraints of the user.  multipliers : (K,), of the last projection."""

    shape = "networks"

    def __init__(self, whole: Whole, graph: Graph, positions: Array) -> None:
        self.order, self.graph, self.masses = graph.order, graph, whole.inverse_masses
        self.n_constraints = graph.n_constraints
        self.offsets = np.ascontiguousarray(whole.offsets[graph.order])
        self.lengths2 = whole.lengths[graph.order] ** 2
        self.tolerance = whole.tolerance
        self.crew = Crew(graph.starts.size - 1, graph.n_constraints, whole.threads)
        k, n = graph.n_constraints, graph.coupling.size
        self.memory = Memory(np.empty((k, 3)), np.empty((k, 3)), np.empty(k), np.empty(k), np.empty(n), np.empty(n))
        self.multipliers = self.memory.total
        self.check(positions)

    def check(self, positions: Array) -> None:
        """ValueError if a constraint depends on the others."""
        k = dependent_constraint(positions, self.graph, self.offsets, self.memory)
        if k >= 0:
            i, j = self.graph.first[k], self.graph.second[k]
            raise ValueError(f"constraint {self.order[k]} (atoms {i}-{j}) follows from the others or contradicts them; leave it out")

    def drift(self, positions: Array, velocities: Array, duration: float) -> int:
        """Drift of the atoms of the group; see constraint_solvers for the answer."""
        arguments = (self.masses, self.graph, self.offsets, self.lengths2, duration, MAX_ITERATIONS, self.memory)
        return self.crew.run(DriftComponents(), positions, velocities, *arguments)

    def project(self, positions: Array, vectors: Array, targets: Array) -> int:
        """r_ij · x_ij = targets for the vectors x; see constraint_solvers for the answer."""
        return self.crew.run(ProjectComponents(), positions, vectors, self.masses, self.graph, self.offsets, targets, self.memory)


class Pairs(Networks):
    """Bonds that share no atom."""

    shape = "bonds of their own"

    def drift(self, positions: Array, velocities: Array, duration: float) -> int:
        """See Networks."""
        first, second = self.graph.first, self.graph.second
        return self.crew.run(DriftPairs(), positions, velocities, self.masses, first, second, self.offsets, self.lengths2, duration)

    def project(self, positions: Array, vectors: Array, targets: Array) -> int:
        """See Networks."""
        first, second = self.graph.first, self.graph.second
        return self.crew.run(ProjectPairs(), positions, vectors, self.masses, first, second, self.offsets, targets, self.multipliers)


class Sweeps(Networks):
    """Components of any shape, by SHAKE and RATTLE."""

    shape = "networks, by sweeps"

    def drift(self, positions: Array, velocities: Array, duration: float) -> int:
        """See Networks."""
        arguments = (self.masses, self.graph, self.offsets, self.lengths2, duration, self.tolerance, MAX_SWEEPS, self.memory)
        return self.crew.run(SweepDrift(), positions, velocities, *arguments)

    def project(self, positions: Array, vectors: Array, targets: Array) -> int:
        """See Networks; by sweeps where nothing but zero is asked for, as RATTLE does."""
        if targets.any():
            return super().project(positions, vectors, targets)
        return self.crew.run(SweepVelocities(), positions, vectors, self.masses, self.graph, self.offsets, self.tolerance, MAX_SWEEPS)


class Triangles(Networks):
    """Triangles with two equal sides whose outer atoms have equal masses: water."""

    shape = "triangles"

    def __init__(self, whole: Whole, graph: Graph, positions: Array) -> None:
        super().__init__(whole, graph, positions)
        base = _equal_sides(graph, graph.starts[:-1], self.lengths2, self.masses)
        self.atoms, self.arms, sides = _corners(graph, base, self.offsets)
        self.shapes = np.sqrt(np.column_stack([self.lengths2[sides[:, 0]], self.lengths2[base]]))

    def drift(self, positions: Array, velocities: Array, duration: float) -> int:
        """See Networks."""
        answer = self.crew.run(DriftTriangles(), positions, velocities, self.masses, self.atoms, self.arms, self.shapes, duration)
        return answer if answer > 0 else 3 * answer + 2  # the first constraint of the triangle


class Rods(Networks):
    """Three atoms in a line, each joined to each: the length of the ends is kept, and the place of the middle one between them."""

    shape = "linear molecules"

    def __init__(self, whole: Whole, graph: Graph, positions: Array) -> None:
        super().__init__(whole, graph, positions)
        self.n_constraints = 4 * (graph.n_constraints // 3)
        self.ends = _longest(graph, self.lengths2)
        corners, arms, sides = _corners(graph, self.ends, self.offsets)
        self.rods = corners[:, [1, 0, 2]]  # the middle one is the corner opposite the longest side
        self.arms = np.stack([-arms[:, 0], arms[:, 1] - arms[:, 0]], axis=1)
        beta = np.sqrt(self.lengths2[sides[:, 0]] / self.lengths2[self.ends])
        self.shares = np.column_stack([1.0 - beta, beta])

    def check(self, positions: Array) -> None:
        """Their lengths do depend on each other, that is why they are here."""

    def drift(self, positions: Array, velocities: Array, duration: float) -> int:
        """See Networks."""
        answer = self.crew.run(DriftRods(), positions, velocities, self.masses, self.rods, self.arms, self.shares, self.lengths2[self.ends], duration)
        return answer if answer > 0 else 3 * answer + 2

    def project(self, positions: Array, vectors: Array, targets: Array) -> int:
        """See Networks."""
        multipliers = np.empty(len(self.rods))
        answer = self.crew.run(ProjectRods(), positions, vectors, self.masses, self.rods, self.arms, self.shares, targets[self.ends], multipliers)
        self.multipliers[:] = 0.0
        self.multipliers[self.ends] = multipliers
        return answer


def groups_of(whole: Whole, positions: Array, solver: str) -> list[Any]:
    """All constraints, sorted by shape. solver : as for DistanceConstraints."""
    graph = graph_of(whole.pairs, whole.inverse_masses)
    kinds = np.full(graph.n_constraints, Sweeps if solver == "shake" else Networks, dtype=object)
    sizes = np.diff(graph.starts)
    if solver == "auto":
        kinds[graph.starts[:-1][sizes == 1]] = Pairs
    starts = graph.starts[:-1][sizes == 3]
    closed = [np.unique(whole.pairs[graph.order[start : start + 3]]).size == 3 for start in starts]
    starts = starts[np.array(closed, dtype=bool)]
    lengths2 = whole.lengths[graph.order] ** 2
    for start, kind in zip(starts, _kinds_of_triangles(graph, starts, lengths2, whole.inverse_masses, solver), strict=True):
        kinds[start : start + 3] = kind or kinds[start]
    return [_group(kind, whole, graph.order[kinds == kind], positions) for kind in dict.fromkeys(kinds)]


def _group(kind: type[Networks], whole: Whole, ids: Ints, positions: Array) -> Networks:
    graph = graph_of(whole.pairs[ids], whole.inverse_masses)
    return kind(whole, graph._replace(order=ids[graph.order]), positions)


def _kinds_of_triangles(graph: Graph, starts: Ints, lengths2: Array, inverse_masses: Array, solver: str) -> list[type[Networks] | None]:
    """Rods, Triangles, or None for those that have no solver of their own."""
    lengths = np.sqrt(lengths2[starts[:, None] + np.arange(3)])
    excess = 2.0 * lengths.max(axis=1, initial=0.0) - lengths.sum(axis=1)
    if (excess > STRAIGHT * lengths.sum(axis=1)).any():
        k = starts[np.argmax(excess)]
        raise ValueError(
            f"lengths of the triangle of constraints {graph.order[k : k + 3].tolist()} contradict each other: one is more than the others together"
        )
    is_straight = excess >= -STRAIGHT * lengths.sum(axis=1)
    base = _equal_sides(graph, starts, lengths2, inverse_masses)
    moves = [(inverse_masses[graph.first[s : s + 3]] > 0.0).all() and (inverse_masses[graph.second[s : s + 3]] > 0.0).all() for s in starts]
    water = (base >= 0) & np.array(moves, dtype=bool) & (solver == "auto")
    return [Rods if straight else Triangles if settles else None for straight, settles in zip(is_straight, water, strict=True)]


def _longest(graph: Graph, lengths2: Array) -> Ints:
    """The longest constraint of each triangle."""
    sides = graph.starts[:-1, None] + np.arange(3)
    return np.take_along_axis(sides, np.argmax(lengths2[sides], axis=1)[:, None], axis=1)[:, 0]


def _equal_sides(graph: Graph, starts: Ints, lengths2: Array, inverse_masses: Array) -> Ints:
    """For each triangle the constraint whose ends have equal masses and equal distances from the third atom; −1 if there is none."""
    answer = np.full(len(starts), -1)
    for k in range(3):
        base = starts + k
        others = lengths2[starts[:, None] + np.delete(np.arange(3), k)]
        masses = inverse_masses[graph.first[base]], inverse_masses[graph.second[base]]
        same = np.isclose(others[:, 0], others[:, 1], rtol=ALIKE, atol=0.0) & np.isclose(*masses, rtol=ALIKE, atol=0.0)
        answer[same] = base[same]
    return answer


def _corners(graph: Graph, base: Ints, offsets: Array) -> tuple[Ints, Array, Ints]:
    """Of each triangle: atoms (apex, b, c) with b-c the base, offsets of b and c from the apex (T, 2, 3), and the two other constraints (T, 2)."""
    sides = graph.starts[:-1, None] + np.arange(3)
    first, second = graph.first[sides], graph.second[sides]
    b, c = graph.first[base], graph.second[base]
    apex = (first.sum(axis=1) + second.sum(axis=1)) // 2 - b - c
    at_apex = (first == apex[:, None]) | (second == apex[:, None])
    arms = [np.argmax(at_apex & ((first == end[:, None]) | (second == end[:, None])), axis=1) + graph.starts[:-1] for end in (b, c)]
    shifts = [np.where((graph.first[arm] == apex)[:, None], 1.0, -1.0) * offsets[arm] for arm in arms]
    return np.column_stack([apex, b, c]), np.ascontiguousarray(np.stack(shifts, axis=1)), np.column_stack(arms)
