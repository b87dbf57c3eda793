"""Laws for the forces on many atoms: −∇U, action and reaction, exchange, rotation, translation, nearest images,
and sums over pairs."""

from __future__ import annotations

from itertools import product

import numpy as np

from minimd.grade.findings import Finding, coefficient
from minimd.grade.force_calling import Array, StudentForce

SPACING, JITTER = 1.25, 0.12  # of the atoms in the test [σ]: no two are closer than 1.0
TRIALS = 30  # configurations; the one whose pairs stay farthest from the cutoff is used
CUTOFF = 2.5  # σ: the most common cutoff
DELTA = 5e-4
ROUNDING = 1e-9
PROBE = 1.25  # distance of two atoms across a boundary
LONGEST = 40.0  # largest distance at which a period is searched
WHERE = np.array([0.31, 0.47, 0.23])
# direction of a pair, by the number of dimensions
ALONG = {1: np.array([1.0]), 2: np.array([0.6, 0.8]), 3: np.array([0.6, 0.48, 0.64])}
AXES = "xyz"


class Bodies:
    """A student's forces on a configuration. faults : sentences, complete after findings()."""

    def __init__(self, force: StudentForce, lengths: Array | None, cutoff: float | None, given: Array | None) -> None:
        self.force, self.d = force, force.dimensions
        self.lengths = None if lengths is None else lengths[: self.d]
        self.along, self.cutoff = ALONG[self.d], cutoff or CUTOFF
        self.x = given if given is not None else self._cluster()
        self.faults: list[str] = []
        self.multiple = 1.0  # the forces are this multiple of −∇U
        self.takes_pairs, self.is_broken = self._takes(2), False
        self.is_field = self._takes(1) and bool(np.abs(self.f(self.pair(PROBE)[:1])).max() > 0.0)

    def f(self, x: Array) -> Array:
        """(N, 3) forces."""
        return self.force(x, len(x))[0]

    def u(self, x: Array) -> float:
        """Energy."""
        return float(np.asarray(self.force(x, len(x))[1]))

    def pair(self, r: float) -> Array:
        """Two atoms at distance r, inside the cell."""
        start = WHERE[: self.d] if self.lengths is None else WHERE[: self.d] * 0.3 * self.lengths / self.lengths.max()
        return np.array([start, start + r * self.along])

    def of_a_pair(self, r: float) -> float:
        """The force of a pair, > 0 for repulsion."""
        forces = self.f(self.pair(r))
        both = np.array([-forces[0] @ self.along, forces[1] @ self.along])
        return float(both[np.argmax(np.abs(both))])

    def energy_of_a_pair(self, r: float) -> float:
        """The energy of a pair."""
        return self.u(self.pair(r))

    def period(self) -> float | None:
        """The edge along x of a cell inside the function: the distance after which the force of a pair repeats;
        None if it does not."""
        if not self.takes_pairs:
            return None
        distances = np.arange(3.0, LONGEST, 0.25)
        start, unit = WHERE[: self.d], np.eye(self.d)[0]

        def at(d: float) -> float:
            return float(self.f(np.array([start, start + d * unit]))[1, 0])

        first, values = at(1.5), np.array([at(float(d)) for d in distances])
        if first == 0.0 or not np.isfinite(values).all():
            return None
        large = np.flatnonzero(np.abs(values) > 0.5 * abs(first))
        if not len(large):
            return None
        low, high = distances[large[0]] - 2.0, distances[large[0]] + 3.0
        guesses = np.arange(low, high, 0.005)
        offs = [abs(at(float(edge) + 1.5) - first) + abs(at(float(edge) - 1.5) + first) for edge in guesses]
        k = int(np.argmin(offs))
        edge = float(np.round(guesses[k], 3))
        return edge if abs(at(edge + 1.5) - first) < 0.05 * abs(first) else None

    def cube(self, farthest: float) -> float | None:
        """Half the edge of the cube in which pairs interact; None if the region is not a cube, or has no end."""
        if self.d == 1:
            return None
        start, unit, largest = WHERE[: self.d], np.eye(self.d)[0], float(self.along.max())

        def feels(r: float, along: Array) -> bool:
            return bool(np.any(self.f(np.array([start, start + r * along]))))

        r = np.arange(0.9, farthest, 0.05)
        felt = [k for k, one in enumerate(r) if feels(float(one), unit)]
        if not felt or felt[-1] == len(r) - 1 or felt[-1] + 1 != len(felt):
            return None
        low, high = float(r[felt[-1]]), float(r[felt[-1] + 1])
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if feels(middle, unit) else (low, middle)
        return low if feels(0.99 * low / largest, self.along) and not feels(1.01 * low / largest, self.along) else None

    def findings(self) -> list[Finding]:
        """Test all laws."""
        forces = self.f(self.x)
        if not np.isfinite(forces).all():
            self.is_broken = True
            self.faults.append(
                f"the forces of {len(self.x)} atoms are not finite: an atom meets itself (i = j, r = 0), or two atoms "
                "coincide"
            )
            return [
                Finding(
                    "finite", False, f"{np.count_nonzero(~np.isfinite(forces))} components of forces are not finite"
                )
            ]
        scale = float(np.abs(forces).max()) or 1.0
        if self.is_field:
            return [
                Finding("external field", None, "a single atom feels a force"),
                *self._gradient(forces, scale),
                self._exchange(forces, scale),
            ]
        answers = [
            self._reaction(forces, scale),
            *self._gradient(forces, scale),
            self._exchange(forces, scale),
            self._translation(forces, scale),
        ]
        answers += [self._rotation(forces, scale)] if self.lengths is None else self._images(forces, scale)
        return answers + ([self._sum(forces, scale)] if self.takes_pairs else [])

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
        lattice = np.array(list(product(*map(range, sides))), dtype=float)
        trials = [
            SPACING * lattice + np.random.default_rng(seed).uniform(-JITTER, JITTER, lattice.shape)
            for seed in range(TRIALS)
        ]
        x = max(trials, key=self._margin)
        return x + 0.5 if self.lengths is None else np.mod(x - SPACING + 0.3, self.lengths)

    def _margin(self, x: Array) -> float:
        """The smallest distance of any pair from the cutoff, or from half the cell along an axis,
        where forces may jump."""
        first, second = np.triu_indices(len(x), 1)
        apart, margins = np.abs(x[first] - x[second]), [1.0]
        if self.lengths is not None:
            margins.append(float(np.abs(apart - 0.5 * self.lengths).min()))
            apart = np.minimum(apart, self.lengths - apart)
        margins.append(float(np.abs(np.sqrt((apart**2).sum(axis=1)) - self.cutoff).min()))
        return min(margins)

    def _reaction(self, forces: Array, scale: float) -> Finding:
        off = float(np.abs(forces.sum(axis=0)).max()) / scale
        if off > ROUNDING and self.takes_pairs:
            one, two = self.f(self.pair(PROBE))
            sizes = np.linalg.norm(one), np.linalg.norm(two)
            if min(sizes) < ROUNDING * max(sizes):
                who = "first" if sizes[1] < sizes[0] else "second"
                hint = "" if self.lengths is None else "; or the nearest image is taken with floor in place of round"
                self.faults.append(
                    f"only one of the two atoms of a pair gets the force, the {who} one: what is added to one must be "
                    f"subtracted from the other{hint}"
                )
            elif np.allclose(one, two, rtol=1e-9):
                self.faults.append("both atoms of a pair get the same force: the second one needs the opposite sign")
        return Finding("sum of forces", off < ROUNDING, f"|Σ F| is {off:.1e} of the largest force", off)

    def _gradient(self, forces: Array, scale: float) -> list[Finding]:
        """Compare F with −∇U; without an energy, test whether F can be a gradient at all: ∂F_i/∂x_j = ∂F_j/∂x_i."""
        n = self.x.size
        units = np.eye(n).reshape(n, *self.x.shape) * DELTA
        weights = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
        if not self.force.has_energy:
            some = units[:24]
            matrix = (
                np.array(
                    [
                        np.ravel(sum(c * (self.f(self.x + k * e) - self.f(self.x - k * e)) for k, c in weights))
                        for e in some
                    ]
                )
                / DELTA
            )
            matrix = matrix[:, : len(some)]
            off = float(np.abs(matrix - matrix.T).max() / max(np.abs(matrix).max(), 1e-300))
            if off >= 1e-4:
                self.faults.append(
                    f"the forces are not the gradient of any energy: ∂F_i/∂x_j and ∂F_j/∂x_i differ by {off:.1%}; no "
                    "energy can be conserved"
                )
            return [
                Finding("a gradient", off < 1e-4, f"∂F_i/∂x_j − ∂F_j/∂x_i is {off:.1e} of the largest element", off)
            ]
        slopes = (
            -np.array(
                [sum(c * (self.u(self.x + k * e) - self.u(self.x - k * e)) for k, c in weights) for e in units]
            ).reshape(self.x.shape)
            / DELTA
        )
        off = float(np.abs(forces - slopes).max() / np.abs(slopes).max())
        c = float(np.sum(forces * slopes) / np.sum(slopes * slopes))
        words = f"largest difference {off:.1e} of the largest force"
        if off > 1e-6 and float(np.abs(forces - c * slopes).max() / np.abs(slopes).max()) < 1e-6:
            words = f"F = {coefficient(c)} × (−∇U)"
            self.multiple = c
        return [Finding("all forces = −∇U", off < 1e-6, words, off)]

    def _exchange(self, forces: Array, scale: float) -> Finding:
        order = np.random.default_rng(2).permutation(len(self.x))
        off = float(np.abs(self.f(self.x[order]) - forces[order]).max()) / scale
        if off > ROUNDING and not self.faults:
            self.faults.append(f"the forces depend on the numbering of the atoms, by {off:.1%}: the double loop leaves "
                               f"out pairs, or forces are overwritten "
                               "(=) where they should be added (+=)")  # fmt: skip
        return Finding("exchange", off < ROUNDING, f"forces of renumbered atoms differ by {off:.1e}", off)

    def _translation(self, forces: Array, scale: float) -> Finding:
        # the smaller difference counts: the other shift may take a pair across a jump
        shifts = np.array([[0.013, -0.007, 0.021], [0.002, 0.001, 0.003]])[:, : self.d]
        off = min(float(np.abs(self.f(self.x + shift) - forces).max()) / scale for shift in shifts)
        return Finding("translation", off < 1e-8, f"forces of shifted atoms differ by {off:.1e}", off)

    def _rotation(self, forces: Array, scale: float) -> Finding:
        turn = np.linalg.qr(np.random.default_rng(4).normal(size=(self.d, self.d)))[0]
        off = float(np.abs(self.f(self.x @ turn) - forces @ turn).max()) / scale
        if off > 1e-8:
            self.faults.append(
                f"the forces do not turn with the atoms: they differ by {off:.1%}. A component is missing, or r is not "
                "√(x² + y² + z²)"
            )
        return Finding("rotation", off < 1e-8, f"forces of turned atoms differ by {off:.1e}", off)

    def _images(self, forces: Array, scale: float) -> list[Finding]:
        """Test nearest images across each face, in both directions, and atoms in other cells."""
        lengths = np.asarray(self.lengths)
        answers: list[Finding] = []
        missing: list[tuple[int, int]] = []
        wrong: list[tuple[int, int]] = []
        if self.takes_pairs:
            for axis, sign in product(range(self.d), (1, -1)):
                unit = np.eye(self.d)[axis]
                first = 0.5 * lengths + (0.5 * lengths[axis] - 0.2) * sign * unit
                inside = self.f(np.array([0.5 * lengths, 0.5 * lengths + sign * PROBE * unit]))
                across = self.f(np.array([first, first + sign * PROBE * unit - sign * lengths[axis] * unit]))
                off = float(np.abs(across - inside).max() / np.abs(inside).max())
                if off > 1e-8:
                    (missing if np.abs(across).max() < 0.2 * np.abs(inside).max() else wrong).append((axis, sign))
            if self._wraps_positions(lengths):
                self.faults.append(
                    "positions are wrapped into the cell, but differences are not: two atoms on both "
                    "sides of a face of the wrapped cell do not interact; use dx − L · round(dx/L) for the differences"
                )
                return [
                    Finding(
                        "nearest image",
                        False,
                        "pairs closer than half the cell do not interact across the middle of the cell",
                    )
                ]
            n_bad = len(missing) + len(wrong)
            words = (
                "pairs across all faces interact as inside"
                if not n_bad
                else f"pairs across {n_bad} of {2 * self.d} faces do not interact as inside"
            )
            answers.append(Finding("nearest image", not n_bad, words, float(n_bad)))
            if n_bad:
                self._tell_images(missing, wrong)
        random = np.random.default_rng(6).integers(-1, 2, self.x.shape)
        off = float(np.abs(self.f(self.x + random * lengths) - forces).max()) / scale
        answers.append(
            Finding("periodic", off < 1e-8, f"forces of atoms moved by whole cells differ by {off:.1e}", off)
        )
        if off > 1e-8 and not missing and not wrong:
            self.faults.append(
                f"forces on atoms outside the cell differ, by {off:.1%}: subtract L · round(dx/L), which is right for "
                "any distance"
            )
        return answers

    def _wraps_positions(self, lengths: Array) -> bool:
        """Whether pairs interact near the origin and across it, but not across the middle of the cell."""
        for axis in range(self.d):
            unit = np.eye(self.d)[axis]
            if lengths[axis] < 4.0 * PROBE:
                return False
            one, across, half = (
                float(np.abs(self.f(np.array([0.1 * lengths, 0.1 * lengths + PROBE * unit]) + shift * unit)).max())
                for shift in (0.0, -0.1 * lengths[axis] - 0.5 * PROBE, 0.4 * lengths[axis] - 0.5 * PROBE)
            )
            if not (one > 0.0 and abs(across - one) < 1e-8 * one and half < 0.2 * one):
                return False
        return True

    def _tell_images(self, missing: list[tuple[int, int]], wrong: list[tuple[int, int]]) -> None:
        bad = missing + wrong
        axes = sorted({axis for axis, _ in bad})
        where = "along " + ", ".join(AXES[axis] for axis in axes)
        verb = "is missing" if missing else "is wrong"
        if len(bad) == 2 * self.d:
            self.faults.append(
                f"minimum image {verb}: atoms on both sides of a face of the cell do not interact as neighbors; use dx "
                "− L · round(dx/L)"
            )
        elif len(axes) < self.d and len(bad) == 2 * len(axes):
            self.faults.append(f"minimum image {verb} {where}, but right for the other axes")
        else:
            self.faults.append(
                f"minimum image {verb} in one direction {where}: only one of dx > L/2 and dx < −L/2 is treated"
            )

    def _sum(self, forces: Array, scale: float) -> Finding:
        """Compare the forces with the sum, over pairs, of the forces on two atoms alone."""
        n = len(self.x)
        parts = np.zeros((n, n, self.d))
        for i in range(n):
            for j in range(i + 1, n):
                parts[i, j], parts[j, i] = self.f(self.x[[i, j]])
        off = float(np.abs(parts.sum(axis=1) - forces).max()) / scale
        if off > 1e-8:
            lower = np.array([np.abs(forces[i] - parts[i, :i].sum(axis=0)).max() for i in range(n)]).max() / scale
            upper = np.array([np.abs(forces[i] - parts[i, i + 1 :].sum(axis=0)).max() for i in range(n)]).max() / scale
            single = (
                np.array([np.abs(forces[i] - parts[i]).max(axis=1)[np.arange(n) != i].min() for i in range(n)]).max()
                / scale
            )
            last = float(np.abs(forces[-1]).max()) / scale
            if single < 1e-8:
                self.faults.append(
                    "each atom feels only one other atom: its force is overwritten (=) in the loop where it should be "
                    "added (+=)"
                )
            elif min(lower, upper) < 1e-8:
                self.faults.append(
                    "each atom feels only the atoms with a higher number, or only those with a lower number"
                )
            elif last < 1e-12 and n > 2:
                self.faults.append(f"atom {n - 1}, the last, feels no force: check the bounds of the loop")
            else:
                return self._other_sum(parts.sum(axis=1), forces, off)
        return Finding("sum over pairs", off < 1e-8, f"F − Σ of single pairs is {off:.1e} of the largest force", off)

    def _other_sum(self, pairs: Array, forces: Array, off: float) -> Finding:
        """Forces that are not the sum over pairs: either a multiple of it, which is a fault, or many-body forces,
        which may be right."""
        c, n = float(np.sum(forces * pairs) / np.sum(pairs * pairs)), len(forces)
        if float(np.abs(forces - c * pairs).max()) < 1e-8 * float(np.abs(forces).max()):
            self.faults.append(f"the forces of {n} atoms are {coefficient(c)} times the sum of those of pairs: they "
                               f"are divided or multiplied by a number "
                               "of atoms or pairs")  # fmt: skip
            return Finding("sum over pairs", False, f"F = {coefficient(c)} × Σ of single pairs", c)
        passed = False if self.faults else None
        return Finding(
            "sum over pairs",
            passed,
            f"F − Σ of single pairs is {off:.1e} of the largest force: many-body forces, or pairs left out",
            off,
        )
