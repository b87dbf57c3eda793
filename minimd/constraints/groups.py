"""Groups of constraints of one shape, each with the solver that suits it."""

from typing import Any, Protocol

import numpy as np

from minimd.constraints.graph import Floats, Graph, Ints, graph_of
from minimd.constraints.linear_triatomic import DriftLinear, ProjectLinear
from minimd.constraints.newton import DriftComponents, Memory, ProjectComponents, dependent_constraint
from minimd.constraints.pairs import DriftPairs, ProjectPairs
from minimd.constraints.parallel import SolverPool
from minimd.constraints.settle import DriftTriangles
from minimd.constraints.shake import SweepDrift, SweepVelocities
from minimd.constraints.vectors import Bonds, Molecules

STRAIGHT = 1e-9  # relative: a triangle whose longest side is the sum of the others to this accuracy is a line; files give some nine digits
ALIKE = 1e-12  # relative: masses and squared lengths that differ by less are equal


class AllConstraints(Protocol):
    """All distance constraints of a system, in the order of the user: attributes of ConstraintSolver."""

    pairs: Ints
    lengths: Floats
    offsets: Floats
    inverse_masses: Floats
    tolerance: float
    threads: int


class Networks:
    """Components of any shape. order : (K,) which constraints of the user.  multipliers : (K,), of the last projection."""

    shape = "networks"

    def __init__(self, every: AllConstraints, graph: Graph, positions: Floats) -> None:
        self.order, self.graph, self.masses = graph.order, graph, every.inverse_masses
        self.n_constraints = graph.order.size
        offsets = np.ascontiguousarray(every.offsets[graph.order])
        self.bonds = Bonds(graph.first, graph.second, offsets, every.lengths[graph.order] ** 2, every.tolerance)
        self.pool = SolverPool(graph.components.starts.size - 1, graph.order.size, every.threads)
        k, n = graph.order.size, graph.components.coupling.size
        self.memory = Memory(np.empty((k, 3)), np.empty((k, 3)), np.empty(k), np.empty(k), np.empty(n), np.empty(n))
        self.multipliers = self.memory.total
        self.check(positions)

    def check(self, positions: Floats) -> None:
        """ValueError if a constraint depends on the others."""
        k = dependent_constraint(positions, self.graph.components, self.bonds, self.memory)
        if k >= 0:
            i, j = self.graph.first[k], self.graph.second[k]
            raise ValueError(f"constraint {self.order[k]} (atoms {i}-{j}) follows from the others or contradicts them; leave it out")

    def drift(self, positions: Floats, velocities: Floats, duration: float) -> int:
        """Drift of the atoms of the group. Returns a number of iterations, or −1 − the constraint, within the group, that cannot be kept."""
        return self.pool.run(DriftComponents(), (positions, velocities, self.masses), self.graph.components, self.bonds, duration, self.memory)

    def project(self, positions: Floats, vectors: Floats, targets: Floats) -> int:
        """r_ij · x_ij = targets for the vectors x. Returns as drift."""
        return self.pool.run(ProjectComponents(), (positions, vectors, self.masses), self.graph.components, self.bonds, targets, self.memory)


class Pairs(Networks):
    """Bonds that share no atom."""

    shape = "bonds of their own"

    def drift(self, positions: Floats, velocities: Floats, duration: float) -> int:
        """See Networks."""
        return self.pool.run(DriftPairs(), (positions, velocities, self.masses), self.bonds, duration)

    def project(self, positions: Floats, vectors: Floats, targets: Floats) -> int:
        """See Networks."""
        return self.pool.run(ProjectPairs(), (positions, vectors, self.masses), self.bonds, targets, self.multipliers)


class Sweeps(Networks):
    """Components of any shape, by SHAKE and RATTLE."""

    shape = "networks, by sweeps"

    def drift(self, positions: Floats, velocities: Floats, duration: float) -> int:
        """See Networks."""
        return self.pool.run(SweepDrift(), (positions, velocities, self.masses), self.graph.components, self.bonds, duration, self.memory)

    def project(self, positions: Floats, vectors: Floats, targets: Floats) -> int:
        """See Networks; by sweeps, as RATTLE does, if all targets are zero."""
        if targets.any():
            return super().project(positions, vectors, targets)
        return self.pool.run(SweepVelocities(), (positions, vectors, self.masses), self.graph.components, self.bonds)


class Triangles(Networks):
    """Triangles with two equal sides whose outer atoms have equal masses: water."""

    shape = "triangles"

    def __init__(self, every: AllConstraints, graph: Graph, positions: Floats) -> None:
        super().__init__(every, graph, positions)
        lengths2 = self.bonds.lengths2
        base = _equal_sides(graph, graph.components.starts[:-1], lengths2, self.masses)
        corners, arms, sides = _corners(graph, base, self.bonds.offsets)
        self.molecules = Molecules(corners, arms, np.sqrt(np.column_stack([lengths2[sides[:, 0]], lengths2[base]])))

    def drift(self, positions: Floats, velocities: Floats, duration: float) -> int:
        """See Networks."""
        answer = self.pool.run(DriftTriangles(), (positions, velocities, self.masses), self.molecules, duration)
        return answer if answer > 0 else 3 * answer + 2  # the first constraint of the triangle


class LinearTriatomics(Networks):
    """Three atoms in a line with three constraints: the distance of the outer ones is kept, and the place of the middle one between them."""

    shape = "linear molecules"

    def __init__(self, every: AllConstraints, graph: Graph, positions: Floats) -> None:
        super().__init__(every, graph, positions)
        self.n_constraints = 4 * (graph.order.size // 3)
        lengths2 = self.bonds.lengths2
        self.ends = _longest(graph, lengths2)
        corners, arms, sides = _corners(graph, self.ends, self.bonds.offsets)
        offsets = np.stack([-arms[:, 0], arms[:, 1] - arms[:, 0]], axis=1)
        beta = np.sqrt(lengths2[sides[:, 0]] / lengths2[self.ends])
        shapes = np.column_stack([1.0 - beta, beta, lengths2[self.ends]])
        self.molecules = Molecules(corners[:, [1, 0, 2]], offsets, shapes)  # the middle atom is the corner opposite the longest side

    def check(self, positions: Floats) -> None:
        """Nothing: their constraints depend on each other, and their solver takes this into account."""

    def drift(self, positions: Floats, velocities: Floats, duration: float) -> int:
        """See Networks."""
        answer = self.pool.run(DriftLinear(), (positions, velocities, self.masses), self.molecules, duration)
        return answer if answer > 0 else 3 * answer + 2

    def project(self, positions: Floats, vectors: Floats, targets: Floats) -> int:
        """See Networks."""
        multipliers = np.empty(len(self.ends))
        answer = self.pool.run(ProjectLinear(), (positions, vectors, self.masses), self.molecules, targets[self.ends], multipliers)
        self.multipliers[:] = 0.0
        self.multipliers[self.ends] = multipliers
        return answer


def groups_of(every: AllConstraints, positions: Floats, solver: str) -> list[Any]:
    """All constraints, sorted by shape.  solver : as for DistanceConstraints."""
    graph = graph_of(every.pairs, every.inverse_masses)
    kinds = np.full(graph.order.size, Sweeps if solver == "shake" else Networks, dtype=object)
    sizes = np.diff(graph.components.starts)
    if solver == "auto":
        kinds[graph.components.starts[:-1][sizes == 1]] = Pairs
    starts = graph.components.starts[:-1][sizes == 3]
    closed = [np.unique(every.pairs[graph.order[start : start + 3]]).size == 3 for start in starts]
    starts = starts[np.array(closed, dtype=bool)]
    lengths2 = every.lengths[graph.order] ** 2
    for start, kind in zip(starts, _kinds_of_triangles(graph, starts, lengths2, every.inverse_masses, solver), strict=True):
        kinds[start : start + 3] = kind or kinds[start]
    return [_group(kind, every, graph.order[kinds == kind], positions) for kind in dict.fromkeys(kinds)]


def _group(kind: type[Networks], every: AllConstraints, ids: Ints, positions: Floats) -> Networks:
    graph = graph_of(every.pairs[ids], every.inverse_masses)
    return kind(every, graph._replace(order=ids[graph.order]), positions)


def _kinds_of_triangles(graph: Graph, starts: Ints, lengths2: Floats, inverse_masses: Floats, solver: str) -> list[type[Networks] | None]:
    """LinearTriatomics, Triangles, or None for those without a special solver."""
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
    return [LinearTriatomics if straight else Triangles if settles else None for straight, settles in zip(is_straight, water, strict=True)]


def _longest(graph: Graph, lengths2: Floats) -> Ints:
    """The longest constraint of each triangle."""
    sides = graph.components.starts[:-1, None] + np.arange(3)
    return np.take_along_axis(sides, np.argmax(lengths2[sides], axis=1)[:, None], axis=1)[:, 0]


def _equal_sides(graph: Graph, starts: Ints, lengths2: Floats, inverse_masses: Floats) -> Ints:
    """For each triangle the constraint whose ends have equal masses and equal distances from the third atom; −1 if there is none."""
    answer = np.full(len(starts), -1)
    for k in range(3):
        base = starts + k
        others = lengths2[starts[:, None] + np.delete(np.arange(3), k)]
        masses = inverse_masses[graph.first[base]], inverse_masses[graph.second[base]]
        same = np.isclose(others[:, 0], others[:, 1], rtol=ALIKE, atol=0.0) & np.isclose(*masses, rtol=ALIKE, atol=0.0)
        answer[same] = base[same]
    return answer


def _corners(graph: Graph, base: Ints, offsets: Floats) -> tuple[Ints, Floats, Ints]:
    """Of each triangle: atoms (apex, b, c) with b-c the base, offsets of b and c from the apex (T, 2, 3), and the two other constraints (T, 2)."""
    sides = graph.components.starts[:-1, None] + np.arange(3)
    first, second = graph.first[sides], graph.second[sides]
    b, c = graph.first[base], graph.second[base]
    apex = (first.sum(axis=1) + second.sum(axis=1)) // 2 - b - c
    at_apex = (first == apex[:, None]) | (second == apex[:, None])
    arms = [np.argmax(at_apex & ((first == end[:, None]) | (second == end[:, None])), axis=1) + graph.components.starts[:-1] for end in (b, c)]
    shifts = [np.where((graph.first[arm] == apex)[:, None], 1.0, -1.0) * offsets[arm] for arm in arms]
    return np.column_stack([apex, b, c]), np.ascontiguousarray(np.stack(shifts, axis=1)), np.column_stack(arms)
