"""Laws for the forces on many atoms: −∇U, action and reaction, exchange, rotation, translation, nearest images,
and sums over pairs."""

from __future__ import annotations

from itertools import product

import numpy as np

from minimd.grade.calling import StudentForce
from minimd.grade.findings import Finding, all_of, coefficient, first_of
from minimd.grade.problems import Array, bisected, difference, multiple_of

SPACING, JITTER = 1.25, 0.12  # of the atoms in the test [σ]: no two are closer than 1.0
TRIALS = 30  # configurations; the one whose pairs stay farthest from the cutoff is used
CUTOFF = 2.5  # σ: the most common cutoff
DELTA = 5e-4
ROUNDING, SAME, EQUAL = 1e-9, 1e-8, 1e-6  # relative differences below them: of sums; of moved atoms; of differences
PROBE = 1.25  # distance of two atoms across a boundary
LONGEST = 40.0  # largest distance at which a period is searched
WHERE = np.array([0.31, 0.47, 0.23])
# direction of a pair, by the number of dimensions
ALONG = {1: np.array([1.0]), 2: np.array([0.6, 0.8]), 3: np.array([0.6, 0.48, 0.64])}
ROUND = "use dx − L · round(dx/L)"  # the cure of wrong images


class Bodies:
    """A student's forces on a configuration. faults : sentences, complete after findings()."""

    def __init__(self, force: StudentForce, lengths: Array | None, cutoff: float | None, given: Array | None) -> None:
        self.force, self.d = force, force.dimensions
        self.lengths = None if lengths is None else lengths[: self.d]
        self.along, self.units, self.cutoff = ALONG[self.d], np.eye(self.d), cutoff or CUTOFF
        self.start = WHERE[: self.d]  # of the first of two atoms
        self.x = given if given is not None else self._cluster()
        self.faults: list[str] = []
        self.multiple = 1.0  # the forces are this multiple of −∇U
        self.takes_pairs, self.is_broken = self._takes(2), False
        self.is_field = self._takes(1) and bool(np.abs(self.f(self.pair(PROBE)[:1])).max() > 0.0)
        self.forces = self.f(self.x)
        self.scale = float(np.abs(self.forces).max()) or 1.0

    def f(self, x: Array) -> Array:
        """(N, 3) forces."""
        return self.force(x)[0]

    def u(self, x: Array) -> float:
        """Energy."""
        return float(np.asarray(self.force(x)[1]))

    def pair(self, r: float) -> Array:
        """Two atoms at distance r, inside the cell."""
        start = self.start if self.lengths is None else self.start * 0.3 * self.lengths / self.lengths.max()
        return np.array([start, start + r * self.along])

    def of_a_pair(self, r: float) -> float:
        """The force of a pair, > 0 for repulsion."""
        forces = self.f(self.pair(r))
        both = np.array([-forces[0] @ self.along, forces[1] @ self.along])
        return float(both[np.argmax(np.abs(both))])

    def period(self) -> float | None:
        """The edge along x of a cell inside the function: the distance after which the force of a pair repeats."""

        def at(d: float) -> float:
            return float(self.f(np.array([self.start, self.start + d * self.units[0]]))[1, 0])

        if not self.takes_pairs:
            return None
        distances = np.arange(3.0, LONGEST, 0.25)
        first, values = at(1.5), np.array([at(float(d)) for d in distances])
        large = np.flatnonzero(np.abs(values) > 0.5 * abs(first))
        if first == 0.0 or not np.isfinite(values).all() or not len(large):
            return None
        guesses = np.arange(distances[large[0]] - 2.0, distances[large[0]] + 3.0, 0.005)
        offs = [abs(at(float(edge) + 1.5) - first) + abs(at(float(edge) - 1.5) + first) for edge in guesses]
        edge = float(np.round(guesses[int(np.argmin(offs))], 3))
        return edge if abs(at(edge + 1.5) - first) < 0.05 * abs(first) else None

    def cube(self, farthest: float) -> float | None:
        """Half the edge of the cube in which pairs interact; None if the region is not a cube, or has no end."""

        def feels(r: float, along: Array) -> bool:
            return bool(np.any(self.f(np.array([self.start, self.start + r * along]))))

        if self.d == 1:
            return None
        r = np.arange(0.9, farthest, 0.05)
        felt = [k for k, one in enumerate(r) if feels(float(one), self.units[0])]
        if not felt or felt[-1] == len(r) - 1 or felt[-1] + 1 != len(felt):
            return None
        ends = float(r[felt[-1]]), float(r[felt[-1] + 1])
        half, _ = bisected(lambda low, middle, high: feels(middle, self.units[0]), *ends, 30)
        corner = half / float(self.along.max())
        return half if feels(0.99 * corner, self.along) and not feels(1.01 * corner, self.along) else None

    def findings(self) -> list[Finding]:
        """Test all laws."""
        if n_bad := np.count_nonzero(~np.isfinite(self.forces)):
            self.is_broken = True
            self.faults.append(f"the forces of {len(self.x)} atoms are not finite: an atom meets itself (i = j, r = 0)"
                               ", or two atoms coincide")  # fmt: skip
            return [Finding("finite", False, f"{n_bad} components of forces are not finite")]
        if self.is_field:
            field = Finding("external field", None, "a single atom feels a force")
            return [field, self._gradient(), self._exchange()]
        # of two translations the smaller difference counts: the other one may take a pair across a jump
        shifts = np.array([[0.013, -0.007, 0.021], [0.002, 0.001, 0.003]])[:, : self.d]
        shifted = min(self._off(self.x + e, self.forces) for e in shifts)
        answers = [self._reaction(), self._gradient(), self._exchange(), self._same("translation", "shifted", shifted)]
        if self.lengths is None:
            turn = np.linalg.qr(np.random.default_rng(4).normal(size=(self.d, self.d)))[0]
            off = self._off(self.x @ turn, self.forces @ turn)
            answers.append(self._same("rotation", "turned", off))
            self.faults += all_of((off > SAME, f"the forces do not turn with the atoms: they differ by {off:.1%}. A "
                                   "component is missing, or r is not √(x² + y² + z²)"))  # fmt: skip
        else:
            answers += self._images(self.lengths)
        return answers + ([self._sum()] if self.takes_pairs else [])

    def _off(self, x: Array, right: Array) -> float:
        return float(np.abs(self.f(x) - right).max()) / self.scale

    def _same(self, law: str, atoms: str, off: float, limit: float = SAME) -> Finding:
        return Finding(law, off < limit, f"forces of {atoms} atoms differ by {off:.1e}", off)

    def _takes(self, n: int) -> bool:
        try:
            return self.f(self.pair(PROBE)[:n]).shape == (n, self.d)
        except Exception:  # whatever a student's function raises
            return False

    def _cluster(self) -> Array:
        """Atoms near the sites of a simple cubic lattice; in a cell, around one of its corners."""
        sides = np.full(self.d, {1: 6, 2: 3, 3: 2}[self.d])
        if self.lengths is not None:
            sides = np.clip((self.lengths / SPACING).astype(int), 1, {1: 6, 2: 4, 3: 3}[self.d])
        lattice = SPACING * np.array(list(product(*map(range, sides))), dtype=float)
        randoms = [np.random.default_rng(seed) for seed in range(TRIALS)]
        x = max((lattice + one.uniform(-JITTER, JITTER, lattice.shape) for one in randoms), key=self._margin)
        return x + 0.5 if self.lengths is None else np.mod(x - SPACING + 0.3, self.lengths)

    def _margin(self, x: Array) -> float:
        """The smallest distance of any pair from the cutoff, or from half the cell along an axis, where forces may
        jump."""
        first, second = np.triu_indices(len(x), 1)
        apart, margins = np.abs(x[first] - x[second]), [1.0]
        if self.lengths is not None:
            margins.append(float(np.abs(apart - 0.5 * self.lengths).min()))
            apart = np.minimum(apart, self.lengths - apart)
        return min(*margins, float(np.abs(np.sqrt((apart**2).sum(axis=1)) - self.cutoff).min()))

    def _reaction(self) -> Finding:
        off = float(np.abs(self.forces.sum(axis=0)).max()) / self.scale
        if off > ROUNDING and self.takes_pairs:
            one, two = self.f(self.pair(PROBE))
            sizes = np.linalg.norm(one), np.linalg.norm(two)
            who = "first" if sizes[1] < sizes[0] else "second"
            hint = "" if self.lengths is None else "; or the nearest image is taken with floor in place of round"
            self.faults += first_of(
                (min(sizes) < ROUNDING * max(sizes), f"only one of the two atoms of a pair gets the force, the {who} "
                    f"one: what is added to one must be subtracted from the other{hint}"),
                (np.allclose(one, two, rtol=1e-9), "both atoms of a pair get the same force: the second one needs the "
                                                   "opposite sign"),
            )  # fmt: skip
        return Finding("sum of forces", off < ROUNDING, f"|Σ F| is {off:.1e} of the largest force", off)

    def _gradient(self) -> Finding:
        """Compare F with −∇U; without an energy, test whether F can be a gradient at all: ∂F_i/∂x_j = ∂F_j/∂x_i."""
        steps = np.eye(self.x.size).reshape(-1, *self.x.shape) * DELTA
        if not self.force.has_energy:
            some = steps[:24]
            matrix = np.array([np.ravel(difference(self.f, self.x, e)) for e in some])[:, : len(some)] / DELTA
            off = float(np.abs(matrix - matrix.T).max() / max(np.abs(matrix).max(), 1e-300))
            self.faults += all_of((off >= 1e-4, "the forces are not the gradient of any energy: ∂F_i/∂x_j and "
                                   f"∂F_j/∂x_i differ by {off:.1%}; no energy can be conserved"))  # fmt: skip
            words = f"∂F_i/∂x_j − ∂F_j/∂x_i is {off:.1e} of the largest element"
            return Finding("a gradient", off < 1e-4, words, off)
        slopes = -np.array([difference(self.u, self.x, e) for e in steps]).reshape(self.x.shape) / DELTA
        off = float(np.abs(self.forces - slopes).max()) / (float(np.abs(slopes).max()) or 1.0)
        words, c = f"largest difference {off:.1e} of the largest force", multiple_of(self.forces, slopes, EQUAL)
        if off > EQUAL and np.isfinite(c):
            self.multiple, words = c, f"F = {coefficient(c)} × (−∇U)"
        return Finding("all forces = −∇U", off < EQUAL, words, off)

    def _exchange(self) -> Finding:
        order = np.random.default_rng(2).permutation(len(self.x))
        off = self._off(self.x[order], self.forces[order])
        if off > ROUNDING and not self.faults:
            self.faults.append(f"the forces depend on the numbering of the atoms, by {off:.1%}: the double loop leaves "
                               "out pairs, or forces are overwritten (=) where they should be added (+=)")  # fmt: skip
        return self._same("exchange", "renumbered", off, ROUNDING)

    def _images(self, lengths: Array) -> list[Finding]:
        """Test nearest images across each face, in both directions, and atoms in other cells."""
        bad: list[tuple[int, bool]] = []  # axes, and whether the force is missing
        for axis, sign in product(range(self.d), (1, -1)) if self.takes_pairs else ():
            unit, edge = sign * self.units[axis], lengths[axis]
            first = 0.5 * lengths + (0.5 * edge - 0.2) * unit
            inside = self.f(np.array([0.5 * lengths, 0.5 * lengths + PROBE * unit]))
            across = self.f(np.array([first, first + PROBE * unit - edge * unit]))
            if float(np.abs(across - inside).max() / np.abs(inside).max()) > SAME:
                bad.append((axis, bool(np.abs(across).max() < 0.2 * np.abs(inside).max())))
        if self.takes_pairs and self._wraps_positions(lengths):
            self.faults.append("positions are wrapped into the cell, but differences are not: two atoms on both sides "
                               "of a face of the wrapped cell do not interact; "
                               f"{ROUND} for the differences")  # fmt: skip
            words = "pairs closer than half the cell do not interact across the middle of the cell"
            return [Finding("nearest image", False, words)]
        words = f"pairs across {len(bad)} of {2 * self.d} faces do not interact as inside"
        words = words if bad else "pairs across all faces interact as inside"
        answers = [Finding("nearest image", not bad, words, float(len(bad)))] if self.takes_pairs else []
        off = self._off(self.x + np.random.default_rng(6).integers(-1, 2, self.x.shape) * lengths, self.forces)
        axes = sorted({axis for axis, _ in bad})
        verb = f"minimum image {'is missing' if any(missing for _, missing in bad) else 'is wrong'}"
        where = "along " + ", ".join("xyz"[axis] for axis in axes)
        self.faults += first_of(
            (len(bad) == 2 * self.d, f"{verb}: atoms on both sides of a face of the cell do not interact as neighbors; "
                                     f"{ROUND}"),
            (bad and len(bad) == 2 * len(axes), f"{verb} {where}, but right for the other axes"),
            (bad, f"{verb} in one direction {where}: only one of dx > L/2 and dx < −L/2 is treated"),
            (off > SAME, f"forces on atoms outside the cell differ, by {off:.1%}: subtract L · round(dx/L), which is "
                         "right for any distance"),
        )  # fmt: skip
        words = f"forces of atoms moved by whole cells differ by {off:.1e}"
        return [*answers, Finding("periodic", off < SAME, words, off)]

    def _wraps_positions(self, lengths: Array) -> bool:
        """Whether pairs interact near the origin and across it, but not across the middle of the cell."""
        for unit, edge in zip(self.units, lengths, strict=True):
            pair, half = np.array([0.1 * lengths, 0.1 * lengths + PROBE * unit]), 0.5 * PROBE
            shifts = (0.0, -0.1 * edge - half, 0.4 * edge - half)
            one, across, middle = (float(np.abs(self.f(pair + shift * unit)).max()) for shift in shifts)
            if edge < 4.0 * PROBE or not (one > 0.0 and abs(across - one) < SAME * one and middle < 0.2 * one):
                return False
        return True

    def _sum(self) -> Finding:
        """Compare the forces with the sum, over pairs, of the forces on two atoms alone: other forces are a multiple
        of it, which is a fault, or many-body forces, which may be right."""
        n, forces = len(self.x), self.forces
        parts = np.zeros((n, n, self.d))
        for i, j in zip(*np.triu_indices(n, 1), strict=True):
            parts[i, j], parts[j, i] = self.f(self.x[[i, j]])
        pairs = parts.sum(axis=1)
        off = float(np.abs(pairs - forces).max()) / self.scale
        words = f"F − Σ of single pairs is {off:.1e} of the largest force"
        if off <= SAME:
            return Finding("sum over pairs", True, words, off)
        before = np.tri(n, k=-1)[:, :, None]
        halves = [np.abs(forces - (parts * half).sum(axis=1)).max() for half in (before, before.transpose(1, 0, 2))]
        single = (np.abs(forces[:, None] - parts).max(axis=2) + np.diag(np.full(n, np.inf))).min(axis=1).max()
        wrong = first_of(
            (single < SAME * self.scale, "each atom feels only one other atom: its force is overwritten (=) in the "
                                         "loop where it should be added (+=)"),
            (min(halves) < SAME * self.scale, "each atom feels only the atoms with a higher number, or only those with "
                                              "a lower number"),
            (np.abs(forces[-1]).max() < 1e-12 * self.scale and n > 2, f"atom {n - 1}, the last, feels no force: check "
                                                                      "the bounds of the loop"),
        )  # fmt: skip
        self.faults += wrong
        c = multiple_of(forces, pairs, SAME)
        if not wrong and np.isfinite(c):
            self.faults.append(f"the forces of {n} atoms are {coefficient(c)} times the sum of those of pairs: they "
                               "are divided or multiplied by a number of atoms or pairs")  # fmt: skip
            return Finding("sum over pairs", False, f"F = {coefficient(c)} × Σ of single pairs", c)
        words += "" if wrong else ": many-body forces, or pairs left out"
        return Finding("sum over pairs", False if self.faults else None, words, off)
