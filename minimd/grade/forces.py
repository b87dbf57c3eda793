"""The grade of a force function: whether forces are a gradient, pairwise, symmetric, periodic and cut off correctly, and
equal to minimd's. What is seen for one pair of atoms is in pairs.py."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np

from minimd.forces.evaluation import evaluate
from minimd.grade.calling import KINDS, REST, SEPARATE, START, StudentForce, plain
from minimd.grade.findings import Finding, Grade, Law, causes, coefficient, first_of, judged
from minimd.grade.pairs import DELTA, FARTHEST, FINITE, SAME_FORCE, Pair, related
from minimd.grade.pairs import LAWS as LAWS_OF_PAIRS
from minimd.grade.problems import Array, bisected, difference, multiple_of
from minimd.potentials.bonded import Bond
from minimd.structure.system import System

BOX, CUTOFF = 12.0, 2.5  # σ: cell and cutoff for a function that takes them, if the user gives none
SPACING, JITTER, TRIALS = 1.25, 0.12, 30  # of the atoms in the test [σ]; the best of some configurations is used
ROUNDING, SAME, EQUAL = 1e-9, 1e-8, 1e-6  # relative differences below them: of sums; of moved atoms; of differences
PROBE, LONGEST = 1.25, 40.0  # distance of two atoms across a boundary; largest distance at which a period is searched
FACTOR = 1.15  # by which a parameter is increased
SKEW = np.array([0.9, 0.5, -0.4])  # a vector of a pair that is parallel to no plane of the axes
WHERE, ALONG = np.array([0.31, 0.47, 0.23]), {2: np.array([0.6, 0.8]), 3: np.array([0.6, 0.48, 0.64])}
SHIFTS = np.array([[0.013, -0.007, 0.021], [0.002, 0.001, 0.003]])


class Atoms:
    """A student's forces on many atoms and what is measured on them: see Law.measure."""

    def __init__(
        self, force: StudentForce, cell: Array | None, cutoff: float | None, given: Array | None, potential: Any
    ) -> None:
        self.force, self.d, self.cutoff, self.potential = force, force.dimensions, cutoff, potential
        self.cell, self.lengths = cell, None if cell is None else cell[: self.d]
        self.along, self.units, self.start = ALONG[self.d], np.eye(self.d), WHERE[: self.d]
        self.start = self.start if self.lengths is None else self.start * 0.3 * self.lengths / self.lengths.max()
        self.x, self.faults = self.cluster() if given is None else given, list[str]()
        self.takes_pairs, self.is_field = self.takes(2), self.takes(1) and bool(self.f(self.pair(PROBE)[:1]).any())
        self.forces = self.f(self.x)
        self.scale, self.is_finite = float(np.abs(self.forces).max()) or 1.0, bool(np.isfinite(self.forces).all())

    def f(self, x: Array) -> Array:
        """(N, 3) forces."""
        return self.force(x)[0]

    def u(self, x: Array) -> float:
        """Energy."""
        return float(np.asarray(self.force(x)[1]))

    def off(self, x: Array, right: Array) -> float:
        """The relative difference of the forces at x from those that are right."""
        return float(np.abs(self.f(x) - right).max()) / self.scale

    def pair(self, r: float, along: Array | None = None) -> Array:
        """Two atoms at a distance, inside the cell."""
        return np.array([self.start, self.start + r * (self.along if along is None else along)])

    def of_a_pair(self, r: float) -> float:
        """The force of a pair, > 0 for repulsion."""
        forces = self.f(self.pair(r)) @ self.along
        return float(max(-forces[0], forces[1], key=abs))

    def takes(self, n: int) -> bool:
        """Whether the function works for n atoms."""
        try:
            return self.f(self.pair(PROBE)[:n]).shape == (n, self.d)
        except Exception:  # whatever a student's function raises
            return False

    def cluster(self) -> Array:
        """Atoms near the sites of a simple cubic lattice, no two closer than σ; in a cell, around one of its corners. No
        pair is near the cutoff, or half the cell along an axis, where forces may jump."""
        lengths, sides = self.lengths, [5 - self.d] * self.d
        if lengths is not None:
            sides = list(np.clip((lengths / SPACING).astype(int), 1, 6 - self.d))
        lattice = SPACING * np.array(list(product(*map(range, sides))), dtype=float)
        first, second = np.triu_indices(len(lattice), 1)

        def margin(x: Array) -> float:
            apart, half = np.abs(x[first] - x[second]), np.inf
            if lengths is not None:
                apart, half = np.minimum(apart, lengths - apart), float(np.abs(apart - 0.5 * lengths).min())
            return min(half, float(np.abs(np.linalg.norm(apart, axis=1) - (self.cutoff or CUTOFF)).min()))

        randoms = [np.random.default_rng(seed) for seed in range(TRIALS)]
        x = max((lattice + one.uniform(-JITTER, JITTER, lattice.shape) for one in randoms), key=margin)
        return x + 0.5 if lengths is None else np.mod(x - SPACING + 0.3, lengths)

    def period(self) -> float | None:
        """The edge along x of a cell inside the function: the distance after which the force of a pair repeats."""

        def at(d: float) -> float:
            return float(self.f(self.pair(d, self.units[0]))[1, 0])

        if not self.takes_pairs or self.lengths is not None or self.is_field or not (first := at(1.5)):
            return None
        large = [d for d in np.arange(3.0, LONGEST, 0.25) if abs(at(float(d))) > 0.5 * abs(first)]
        guesses = np.arange(large[0] - 2.0, large[0] + 3.0, 0.005) if large else np.zeros(1)
        edge = float(np.round(min(guesses, key=lambda d: abs(at(d + 1.5) - first) + abs(at(d - 1.5) + first)), 3))
        return edge if edge and abs(at(edge + 1.5) - first) < 0.05 * abs(first) else None

    def cube(self, farthest: float) -> list[str]:
        """The fault of a cutoff that acts on components: pairs interact in a cube."""

        def feels(r: float, along: Array = self.units[0]) -> bool:
            return bool(self.f(self.pair(r, along)).any())

        felt = [feels(float(r)) for r in np.arange(0.9, farthest, 0.05)]
        if not felt[0] or felt[-1]:
            return []
        end = 0.9 + 0.05 * felt.index(False)
        half, _ = bisected(lambda low, r, high: feels(r), end - 0.05, end, 30)
        corner = half / float(self.along.max())
        return first_of((feels(0.99 * corner, self.along) and not feels(1.01 * corner, self.along),
                         "the cutoff acts on the components, not on the distance: pairs in a cube with half the edge "
                         f"{half:.4g} interact. Compare dx² + dy² + dz² with the square of the cutoff"))  # fmt: skip

    def reaction(self) -> float:
        """The sum of all forces."""
        off = float(np.abs(self.forces.sum(axis=0)).max()) / self.scale
        if off > ROUNDING and self.takes_pairs:
            one, two = self.f(self.pair(PROBE))
            sizes, hint = np.linalg.norm([one, two], axis=1), "; or floor takes the place of round in the nearest image"
            self.faults += first_of(
                (sizes.min() < ROUNDING * sizes.max(), f"only one of the two atoms of a pair gets the force, number "
                 f"{sizes.argmax()}: what is added to one must be subtracted from the other{hint * (self.cell is not None)}"),
                (np.allclose(one, two, rtol=1e-9), "both atoms of a pair get the same force: the second one needs the "
                                                   "opposite sign"),
            )  # fmt: skip
        return off

    def gradient(self) -> tuple[float, float, str] | None:
        """The forces beside −∇U."""
        if not self.force.has_energy:
            return None
        slopes = -np.array([difference(self.u, self.x, e) for e in self.steps()]).reshape(self.x.shape) / DELTA
        off = float(np.abs(self.forces - slopes).max()) / (float(np.abs(slopes).max()) or 1.0)
        return off, off, "; ".join(related(multiple_of(self.forces, slopes, EQUAL), 0.0, "−∇U"))

    def steps(self) -> Array:
        """A short step of each coordinate."""
        return np.eye(self.x.size).reshape(-1, *self.x.shape) * DELTA

    def curl(self) -> float | None:
        """Whether forces without an energy can be a gradient: ∂F_i/∂x_j = ∂F_j/∂x_i."""
        some = [] if self.force.has_energy else self.steps()[:24]
        matrix = np.array([np.ravel(difference(self.f, self.x, e))[: len(some)] for e in some])
        return float(np.abs(matrix - matrix.T).max() / max(np.abs(matrix).max(), 1e-300)) if len(some) else None

    def exchange(self) -> float:
        """Renumbered atoms."""
        order = np.random.default_rng(2).permutation(len(self.x))
        return self.off(self.x[order], self.forces[order])

    def rotation(self) -> float | None:
        """Turned atoms."""
        turn = np.linalg.qr(np.random.default_rng(4).normal(size=(self.d, self.d)))[0]
        return self.off(self.x @ turn, self.forces @ turn) if self.cell is None else None

    def periodic(self) -> float | None:
        """Atoms moved by whole cells."""
        cells = np.random.default_rng(6).integers(-1, 2, self.x.shape)
        return None if self.lengths is None else self.off(self.x + cells * self.lengths, self.forces)

    def images(self) -> tuple[int, int, int] | None:
        """Nearest images across each face, in both directions."""
        if self.lengths is None or not self.takes_pairs:
            return None
        bad = list[tuple[int, float]]()  # axes, and the part of the force that is there
        for axis, sign in product(range(self.d), (1, -1)):
            unit, edge, middle = sign * self.units[axis], self.lengths[axis], 0.5 * self.lengths
            face = middle + (0.5 * edge - 0.2) * unit
            inside, across = (self.f(np.array([a, a + b * unit])) for a, b in ((middle, PROBE), (face, PROBE - edge)))
            if np.abs(across - inside).max() > SAME * np.abs(inside).max():
                bad.append((axis, float(np.abs(across).max() / np.abs(inside).max())))
        far = -0.5 * PROBE * self.units[0]  # across the origin, where wrapped positions are cut or interact
        origin, center = (
            float(np.abs(self.f(np.array([a + far, a - far]))).max())
            for a in (0.0 * self.lengths + 0.1, 0.5 * self.lengths)
        )
        axes, is_all = sorted({axis for axis, _ in bad}), len(bad) == 2 * self.d
        verb = f"minimum image {'is missing' if any(part < 0.2 for _, part in bad) else 'is wrong'}"
        where, cure = "along " + ", ".join("xyz"[axis] for axis in axes), "use dx − L · round(dx/L)"
        self.faults += first_of(
            (origin > 0.0 and center < 0.2 * origin, "positions are wrapped into the cell, but differences are not: two atoms on "
             f"both sides of a face of the wrapped cell do not interact; {cure} for the differences"),
            (is_all, f"{verb}: atoms on both sides of a face of the cell do not interact as neighbors; {cure}"),
            (bad and len(bad) == 2 * len(axes), f"{verb} {where}, but right for the other axes"),
            (bad, f"{verb} in one direction {where}: only one of dx > L/2 and dx < −L/2 is treated"),
        )  # fmt: skip
        return len(bad), len(bad), 2 * self.d

    def sum_of_pairs(self) -> tuple[float, float, str] | None:
        """The forces beside the sum, over pairs, of the forces on two atoms alone: other forces are a multiple of it,
        which is a fault, or many-body forces, which may be right."""
        n, forces, parts = len(self.x), self.forces, np.zeros((len(self.x), *self.x.shape))
        for i, j in zip(*np.triu_indices(n, 1), strict=True) if self.takes_pairs else ():
            parts[i, j], parts[j, i] = self.f(self.x[[i, j]])
        pairs, before = parts.sum(axis=1), np.tri(n, k=-1)[:, :, None]
        off, small = float(np.abs(pairs - forces).max()) / self.scale, SAME * self.scale
        halves = [np.abs(forces - (parts * half).sum(axis=1)).max() for half in (before, before.transpose(1, 0, 2))]
        single = (np.abs(forces[:, None] - parts).max(axis=2) + np.diag(np.full(n, np.inf))).min(axis=1).max()
        c = multiple_of(forces, pairs, SAME)
        self.faults += [] if off <= SAME or not self.takes_pairs else first_of(
            (single < small, "each atom feels only one other atom: its force is overwritten (=) in the loop where it should be "
                             "added (+=)"),
            (min(halves) < small, "each atom feels only the atoms with a higher number, or only those with a lower number"),
            (np.abs(forces[-1]).max() < 1e-4 * small, f"atom {n - 1}, the last, feels no force: check the bounds of the loop"),
            (np.isfinite(c), f"the forces of {n} atoms are {coefficient(c)} times the sum of those of pairs: they are divided "
                             "or multiplied by a number of atoms or pairs"),
        )  # fmt: skip
        return (off, off, "" if off <= SAME else ": many-body forces, or pairs left out") if self.takes_pairs else None

    def beside(self) -> float | None:
        """All forces and the energy beside those of minimd."""
        if self.potential is None:
            return None
        answer, n = evaluated(np.pad(self.x, ((0, 0), (0, 3 - self.d))), self.potential, self.cell), len(self.x)
        known, energy, right = answer.forces[:, : self.d], self.u(self.x), float(answer.potential_energy)
        off, c = (
            float(np.abs(self.forces - known).max()) / (float(np.abs(known).max()) or 1.0),
            multiple_of(self.forces, known, 1e-6),
        )
        self.faults += [] if self.faults else first_of(
            (off > SAME_FORCE, f"the forces of {n} atoms differ from minimd's by {off:.1%} of the largest, or by the factor {c:.6g}"),
            (self.force.has_energy and not np.isclose(energy, right, rtol=1e-9), f"the energy of {n} atoms is {energy:.8g}, "
             f"{energy / (right or np.nan):.4g} times minimd's, {right:.8g}"),
        )  # fmt: skip
        return off


def evaluated(x: Array, potential: Any, lengths: Array | None) -> Any:
    """minimd's forces and energy. Bonds without pairs join the two atoms if there are two.

    Raises ValueError if there are more.
    """
    is_bond = isinstance(potential, Bond) and potential.arguments()["pairs"] is None
    if is_bond and len(x) != 2:
        raise ValueError(f"{potential!r} does not say which of the {len(x)} atoms are bonded: give it pairs, such as "
                         "pairs=[[0, 1]], or positions= of two atoms")  # fmt: skip
    return evaluate(System(x, cell=lengths, bonds=[[0, 1]] if is_bond else None), potential)


SELF = Law("finite", FINITE.measure, 0.5, FINITE.words, "forces are not finite: an atom meets itself (i = j, r = 0), or two "
           "atoms coincide")  # fmt: skip
LAWS_OF_A_FIELD = (
    Law("external field", lambda b: (np.nan, 1.0) if b.is_field else None, 0.5, "a single atom feels a force", otherwise=None),
    Law("all forces = −∇U", Atoms.gradient, EQUAL, "largest difference {0:.1e} of the largest force", "the forces are not −∇U "
        "of the energy, by {0:.1%}. {2}"),
    Law("a gradient", Atoms.curl, 1e-4, "∂F_i/∂x_j − ∂F_j/∂x_i is {0:.1e} of the largest element", "the forces are not the "
        "gradient of any energy: ∂F_i/∂x_j and ∂F_j/∂x_i differ by {0:.1%}; no energy can be conserved"),
    Law("exchange", Atoms.exchange, ROUNDING, "forces of renumbered atoms differ by {0:.1e}", "the forces depend on the "
        "numbering of the atoms: the double loop leaves out pairs, or forces are overwritten (=) where they should be added"),
    Law("all atoms as minimd's", Atoms.beside, SAME_FORCE, "largest difference {0:.1e} of the largest force"),
)  # fmt: skip
LAWS = (
    Law("sum of forces", Atoms.reaction, ROUNDING, "|Σ F| is {0:.1e} of the largest force", "the sum of all forces is not zero"),
    Law("sum over pairs", Atoms.sum_of_pairs, SAME, "F − Σ of single pairs is {0:.1e} of the largest force{2}", otherwise=None),
    *LAWS_OF_A_FIELD,
    # of two translations the smaller difference counts: the other one may take a pair across a jump
    Law("translation", lambda b: min(b.off(b.x + shift[: b.d], b.forces) for shift in SHIFTS), SAME,
        "forces of shifted atoms differ by {0:.1e}", "the forces depend on the place of the atoms"),
    Law("rotation", Atoms.rotation, SAME, "forces of turned atoms differ by {0:.1e}", "the forces do not turn with the atoms: "
        "they differ by {0:.1%}. A component is missing, or r is not √(x² + y² + z²)"),
    Law("nearest image", Atoms.images, 0.5, "pairs across {0} of {2} faces do not interact as inside"),
    Law("periodic", Atoms.periodic, SAME, "forces of atoms moved by whole cells differ by {0:.1e}", "forces on atoms outside "
        "the cell differ: subtract L · round(dx/L), which is right for any distance"),
)  # fmt: skip
AT_HALF = Law("at half the cell", lambda rest: rest, 1e-300, "where the nearest image changes, the force is {0:.2g}; if it is "
              "not zero, use a cutoff", otherwise=None)  # fmt: skip


def grade_forces(
    function: Callable[..., Any], potential: Any = None, cell: float | Sequence[float] | None = None,
    cutoff: float | None = None, positions: Any = None, kind: str | None = None,
) -> Grade:  # fmt: skip
    """See grade."""
    lengths, given = edges(cell), None if positions is None else np.array(positions, dtype=float)
    if given is not None and (given.ndim != 2 or given.shape[1] != 3 or not np.isfinite(given).all()):
        raise ValueError(f"positions must be (N, 3) finite numbers; got shape {given.shape}")
    if cutoff is None and potential is not None and np.isfinite(getattr(potential, "cutoff", np.inf) or np.inf):
        cutoff = float(potential.cutoff)
    parameters = getattr(potential, "parameters", None)
    units = parameters if isinstance(parameters, tuple) and len(parameters) == 2 else (1.0, 1.0)
    edge = BOX if lengths is None else float(lengths[0]) if np.ptp(lengths) == 0.0 else lengths
    options = {"box": edge, "cutoff": cutoff or CUTOFF, "epsilon": units[0], "sigma": units[1], "n": 0}
    options |= {"box given": lengths is not None, "cutoff given": cutoff is not None}
    force = StudentForce(function, options, kind, given)
    lengths = np.full(3, BOX) if "box" in force.takes and lengths is None else lengths
    with np.errstate(all="ignore"):
        return measured(force, lengths, cutoff or CUTOFF if "cutoff" in force.takes else cutoff, given, potential)


def measured(
    force: StudentForce, lengths: Array | None, cutoff: float | None, given: Array | None, potential: Any
) -> Grade:
    """The grade of forces that can be called."""
    told = f"{force.name}({', '.join(force.names)}): {KINDS[force.kind]}{' and the energy' * force.has_energy}"
    faults, remarks, findings, name, atoms, x = (
        list[str](),
        list[str](),
        list[Finding](),
        "",
        None,
        np.array(START * 1.2),
    )
    is_law, along, values = force.kind == "law", np.array([0.6, 0.0, 0.8]), values_of(force)

    def at(r: float) -> tuple[float, float]:
        f, u = force((r * r if force.is_squared else r) if is_law else r * along)
        return float(f if is_law else f @ along), float(u)

    f, u = (lambda r: at(r)[0]), (lambda r: at(r)[1])
    if force.kind == "forces":
        atoms = Atoms(force, lengths, cutoff, given, potential)
        if edge := atoms.period():
            remarks.append(
                f"the forces are periodic along x with the period {edge:.6g}, taken as the edge of a cubic cell"
            )
            atoms = Atoms(force, lengths := np.full(3, edge), cutoff, given, potential)
        f, u, x = atoms.of_a_pair, (lambda r: atoms.u(atoms.pair(r))), atoms.x
        findings = judged((SELF, *(LAWS_OF_A_FIELD if atoms.is_field else LAWS)) if atoms.is_finite else (SELF,), atoms)
    is_turned = all(one.passed is not False for one in findings if one.name in ("finite", "rotation"))
    if atoms is None or (is_turned and atoms.takes_pairs and not atoms.is_field):
        farthest = FARTHEST if lengths is None else min(FARTHEST, 0.4995 * float(lengths.min()))
        known = lambda r: float(evaluated(np.array([[0.0, 0.0, 0.0], [r, 0.0, 0.0]]), potential, None).forces[1, 0])  # noqa: E731
        pair = Pair(f, u if force.has_energy else None, known if potential else None, farthest, cutoff, is_law)
        own, faults = (
            {force.roles[name]: value for name, value in values.items()},
            atoms.cube(farthest) if atoms else [],
        )
        pair.name_with(own.get("epsilon", 1.0), own.get("sigma", 1.0), {"epsilon", "sigma"} <= {*own})
        pair.is_cube, pair.may_jump, name = bool(faults), getattr(potential, "truncation", "") == "truncated", pair.name
        if force.kind == "pair":
            x, vector = SEPARATE, force(SKEW)[0]
            pair.off_center = float(np.linalg.norm(np.cross(vector, SKEW)) / np.linalg.norm(vector))
        of_pair = judged(LAWS_OF_PAIRS if pair.is_finite else (FINITE,), pair)
        faults, findings, remarks = faults + causes(of_pair) + pair.faults, findings + of_pair, remarks + pair.remarks
        if atoms and lengths is not None and cutoff is None:
            findings.append(AT_HALF.finding(abs(f(0.4999 * float(lengths.min())))))
    faults = without_effect(force, x, values) + faults + (atoms.faults if atoms else [])
    faults = faults or causes(findings)
    faults += ["the function changes the positions that it is given: work on a copy"] * force.changes_input
    return Grade(told, (*findings,), tuple(dict.fromkeys(faults)), name, (*remarks,))


def values_of(force: StudentForce) -> dict[str, float]:
    """The values of the function's physical parameters, such as ε and σ, by name."""
    values, roles = {**force.defaults, **force.values}, force.roles
    physical = {name for name in values if roles[name] in ("epsilon", "sigma", "stiffness", "strength")
                or ("stiffness" in roles.values() and re.search(REST, plain(name)))}  # fmt: skip
    numbers = {name: value for name, value in values.items() if type(value) in (int, float, np.float64)}
    return {name: float(value) for name, value in numbers.items() if name in physical and value > 0.0}


def without_effect(force: StudentForce, x: Any, values: dict[str, float]) -> list[str]:
    """Faults for physical parameters whose values have no effect on the forces."""
    faults, given, own = list[str](), force.values, force(x)[0]
    for name, value in values.items() if np.isfinite(own).all() and np.any(own) else ():
        force.values = {**given, name: FACTOR * value}
        try:
            is_same = np.array_equal(own, force(x)[0])
        except Exception:  # whatever a student's function raises
            continue
        finally:
            force.values = given
        hint = ", a bond without rest length: F = −k (r − r0) r_ij/r" * bool(re.search(REST, plain(name)))
        faults += [f"the argument {name} is without effect: with {name} = {value:g} and {FACTOR * value:g} the forces are the "
                   f"same{hint}"] * is_same  # fmt: skip
    return faults


def edges(cell: float | Sequence[float] | None) -> Array | None:
    """The edges (3,) of a rectangular cell.  Raises ValueError for any other cell."""
    array = np.array(1.0 if cell is None else cell, dtype=float)
    if array.shape == (3, 3) and not np.any(array - np.diag(np.diagonal(array))):
        array = np.diagonal(array).copy()
    if array.shape not in ((), (3,)) or not (np.isfinite(array).all() and (array > 0.0).all()):
        raise ValueError(f"cell must be the edge of a cube, or three edges, positive and finite; got {cell!r}")
    return None if cell is None else np.broadcast_to(array, (3,)).copy()
