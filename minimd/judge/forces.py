"""The grade of a force function: whether forces are a gradient, pairwise, symmetric, periodic, cut off correctly, and
equal to minimd's. The laws are those of many atoms, and those of one pair at a distance, with f > 0 for repulsion."""

import re
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from minimd.core.structure.checks import checked_sizes
from minimd.judge.calling import KINDS, REST, StudentForce, plain
from minimd.judge.findings import Answer, Grade, Law, causes, first_of, is_near, judged
from minimd.judge.powers import Powers, compared, jumps, powers_of
from minimd.judge.problems import Array, Function, difference, multiple_of

# σ: cell and cutoff for a function that takes them, if the user gives none
BOX = 12.0
CUTOFF = 2.5
# of the atoms in the test [σ]; the best of some configurations is used
SPACING = 1.25
JITTER = 0.12
TRIALS = 30
# relative differences
ROUNDING = 1e-9  # of sums
SAME = 1e-8  # of moved atoms
EQUAL = 1e-6  # of slopes
CAPPED = 1e-4  # of capped forces
PROBE = 1.25  # σ: of two atoms across a boundary
LONGEST = 40.0  # largest distance at which a period is searched
# σ: distances of the search for a cap, of ordinary forces, for an end
CLOSEST = 0.3
NEAREST = 0.77
FARTHEST = 6.0
POINTS = 40  # of profiles
GRID = 500  # of jumps
DELTA = 3e-4  # of differences
FACTOR = 1.15  # of larger parameters
SKEW = np.array([0.9, 0.5, -0.4])  # a vector of a pair that is parallel to no plane of the axes
WHERE = np.array([0.31, 0.47, 0.23])
ALONG = {2: np.array([0.6, 0.8]), 3: np.array([0.6, 0.48, 0.64])}
SHIFTS = np.array([[0.013, -0.007, 0.021], [0.002, 0.001, 0.003]])
CURE = "use dx − L · round(dx/L)"


class Probe:
    """A student's forces, and what is measured on them: see Law.measure.

    has : what laws may need: atoms (many), pairs, field or nofield, cell or free, energy or noenergy, known, cutoff.
    """

    def __init__(
        self, call: StudentForce, cell: Array | None, cutoff: Any, given: Any, potential: Any
    ) -> None:
        self.call = call
        self.d = call.dimensions
        self.cell = cell
        self.cutoff = cutoff
        self.potential = potential
        self.lengths: Any = None if cell is None else cell[: self.d]
        self.along = ALONG[self.d]
        self.units = np.eye(self.d)
        self.start = WHERE[: self.d] * (
            1.0 if self.lengths is None else 0.3 * self.lengths / self.lengths.max()
        )
        self.f, self.u = (
            np.vectorize(lambda r, k=k: self.both(float(r))[k], [float]) for k in range(2)
        )
        self.values = np.zeros(0)
        self.is_over_r = False
        self.remarks = list[str]()
        self.name = ""
        self.farthest = FARTHEST if cell is None else min(FARTHEST, 0.4995 * cell.min())
        self.has = {
            call.kind,
            "free" if cell is None else "cell",
            "energy" if call.has_energy else "noenergy",
        }
        if potential is not None:
            self.has.add("known")
        if cutoff and cutoff < self.farthest:
            self.has.add("cutoff")
        self.skew = call(SKEW)[0] if call.kind == "pair" else SKEW
        self.x = (
            self.place(PROBE)
            if call.kind != "forces"
            else self.cluster()
            if given is None
            else given
        )
        self.forces = call(self.x)[0]
        self.scale = np.abs(self.forces).max() or 1.0
        is_many = call.kind == "forces"
        is_field = is_many and self.takes(1) and call(self.place(PROBE)[:1])[0].any()
        self.has.add("field" if is_field else "nofield")
        self.order = np.random.default_rng(2).permutation(len(self.x)) if is_many else 0
        self.turn = np.linalg.qr(np.random.default_rng(4).normal(size=(self.d, self.d)))[0]
        is_turned = (
            not self.has >= {"forces", "free"}
            or self.off(self.x @ self.turn, self.forces @ self.turn) < SAME
        )
        if (
            "nofield" in self.has
            and (not is_many or self.takes(2))
            and is_turned
            and np.isfinite(self.forces).all()
        ):
            self.has.add("pairs")
            self.find_profile()

    def takes(self, n: int) -> bool:
        """Whether the function works for n atoms."""
        try:
            return self.call(self.place(PROBE)[:n])[0].shape == (n, self.d)
        except Exception:  # whatever a student's function raises
            return False

    def cluster(self) -> Array:
        """Atoms near the sites of a cubic lattice, no two closer than σ; in a cell, around one of its corners. No
        pair is near the cutoff, or half the cell along an axis, where forces may jump."""
        lengths = self.lengths
        sides = [5 - self.d] * self.d
        if lengths is not None:
            sides = [*np.clip((lengths / SPACING).astype(int), 1, 6 - self.d)]
        lattice = SPACING * np.array([*product(*map(range, sides))], dtype=float)
        first, second = np.triu_indices(len(lattice), 1)

        def margin(x: Array) -> float:
            apart = np.abs(x[first] - x[second])
            half = np.inf
            if lengths is not None:
                half = np.abs(apart - 0.5 * lengths).min()
                apart = np.minimum(apart, lengths - apart)
            return min(
                half, float(np.abs(np.linalg.norm(apart, axis=1) - (self.cutoff or CUTOFF)).min())
            )

        randoms = [np.random.default_rng(seed) for seed in range(TRIALS)]
        x = max(
            (lattice + one.uniform(-JITTER, JITTER, lattice.shape) for one in randoms), key=margin
        )
        return x + 0.5 if lengths is None else np.mod(x - SPACING + 0.3, lengths)

    def place(self, r: float, along: Array | None = None) -> Any:
        """The argument of the function for two atoms at a distance."""
        apart = r * (self.along if along is None else along)
        distance = r * r if self.call.is_squared else r
        return {
            "law": distance,
            "pair": apart,
            "forces": np.array([self.start, self.start + apart]),
        }[self.call.kind]

    def both(self, r: float) -> tuple[float, float]:
        """f and u of a pair."""
        force, u = self.call(self.place(r))
        along = force if self.call.kind == "law" else force @ self.along
        f = max(-along[0], along[1], key=abs) if self.call.kind == "forces" else along
        return float(f) * (r if self.is_over_r else 1.0), float(np.asarray(u))

    def slopes(self, r: Array) -> Array:
        """−du/dr."""
        return -np.asarray(difference(self.u, r, DELTA)) / DELTA

    def find_profile(self) -> None:
        """The force of a pair at ordinary distances, that of the potential, and the powers of r."""
        end = min(self.farthest, 0.9 * (self.cutoff or CUTOFF), 2.2)
        ended = [x for x in np.linspace(1.0, end, 60) if self.f(x) == 0.0]
        self.r = np.linspace(NEAREST, 0.98 * ended[0] if ended else end, POINTS)
        pairs = (
            [np.array([[0.0, 0.0, 0.0], [r, 0.0, 0.0]]) for r in self.r]
            if "known" in self.has
            else []
        )
        self.known = np.array(
            [evaluated(pair, self.potential, None).forces[1, 0] for pair in pairs]
        )
        right = self.slopes(self.r) if "energy" in self.has else self.known
        if (
            self.call.kind == "law"
            and len(right)
            and compared(self.f(self.r), right, self.r, "")[1] == -1.0
        ):
            self.is_over_r = True
            self.remarks.append(
                "the law returns f = −u′(r)/r, as minimd's laws do: multiply it by the vector r_ij"
            )
        self.values = self.f(self.r)
        self.powers = powers_of(self.values, self.r)

    def period(self) -> float:
        """The edge of a cell inside the function, after which the force of a pair repeats; 0 if there is none."""

        def at(d: float) -> float:
            return float(self.call(self.place(d, self.units[0]))[0][1, 0])

        if not self.has >= {"forces", "pairs", "free"} or not (first := at(1.5)):
            return 0.0
        large = [d for d in np.arange(3.0, LONGEST, 0.25) if abs(at(d)) > 0.5 * abs(first)]
        guesses = np.arange(large[0] - 2.0, large[0] + 3.0, 0.005) if large else np.zeros(1)
        edge = float(
            np.round(
                min(guesses, key=lambda d: abs(at(d + 1.5) - first) + abs(at(d - 1.5) + first)), 3
            )
        )
        return edge if abs(at(edge + 1.5) - first) < 0.05 * abs(first) else 0.0

    def off(self, x: Array, right: Array) -> float:
        """The relative difference of the forces at x from those that are right."""
        return float(np.abs(self.call(x)[0] - right).max()) / self.scale

    def without_effect(self) -> Answer:
        """The physical parameters, such as ε and σ, that have no effect when they are increased."""
        call = self.call
        still = list[str]()
        own = self.forces
        given = call.values
        for name, value in call.physical.items() if np.isfinite(own).all() and own.any() else ():
            call.values = {**given, name: FACTOR * value}
            try:
                if np.array_equal(own, call(self.x)[0]):
                    still.append(name)
            except Exception:  # whatever a student's function raises
                continue
            finally:
                call.values = given
        hint = (
            "; with a rest length F = −k (r − r0) r_ij/r"
            if re.search(REST, plain(" ".join(still)))
            else ""
        )
        told = f"forces do not change when {' or '.join(still)} is increased{hint}"
        return len(still), len(still), told

    def like(self, right: Array, other: str) -> Answer:
        """The force of a pair beside the one that it should be."""
        c, _, fault = compared(self.values, right, self.r, other)
        return c, bool(fault), fault

    def of_powers(self) -> Answer:
        """The powers of r; those of Lennard-Jones are needed with the function's ε and σ, or without an energy."""
        units = {self.call.roles[name]: value for name, value in self.call.physical.items()}
        epsilon = units.get("epsilon", 1.0)
        sigma = units.get("sigma", 1.0)
        is_given = {"epsilon", "sigma"} <= {*units}
        own = self.powers or Powers({})
        fault = ""
        n = [*own.terms]
        c = [*own.terms.values()]
        is_alone = is_given or not {"known", "energy"} & self.has
        if n == [1] and is_alone and self.call.kind != "law":
            self.remarks.append(
                "the force of a pair decreases as r^−1. If q²/r² is meant, a factor 1/r is missing: "
                "q² r_ij/r³, not q² r_ij/r²"
            )
            return np.nan, np.nan, "", self.powers
        if len(n) == 2 and abs(n[0] - 13) <= 2 and abs(n[1] - 7) <= 2:
            right = {13: 48.0 * epsilon * sigma**12, 7: -24.0 * epsilon * sigma**6}
            s6 = abs(c[0] / c[1]) / 2.0
            told = f"48 ε σ¹² r^−13 − 24 ε σ⁶ r^−7 with ε = {epsilon:g}, σ = {sigma:g}"
            self.name = (
                f"Lennard-Jones with ε = {abs(c[1]) / 24.0 / s6:.6g}, σ = {s6 ** (1 / 6):.6g}"
            )
            is_odd = n != [13, 7] or c[0] < 0.0 or c[1] > 0.0 or is_near(s6, 1.0) or is_given
            if is_odd or is_near(c[0], 48.0) or is_near(c[1], -24.0):  # else it has its own ε and σ
                fault = compared(self.values, Powers(right, own.constant).at(self.r), self.r, told)[
                    2
                ]
        return np.nan, bool(fault) if is_alone or not fault else np.nan, fault, self.powers

    def cap(self) -> Answer:
        """The largest close distance at which the force is not its law, a sum of powers or −du/dr, or is constant."""
        r = np.geomspace(CLOSEST, 1.0, POINTS)
        far = self.r > 1.0
        f = self.f(r)
        powers = self.powers or powers_of(self.values[far], self.r[far])
        right = powers.at(r) if powers else self.slopes(r) if "energy" in self.has else f
        is_flat = np.ptp(f[:4]) == 0.0 != np.ptp(f)
        rest = np.abs(f / right - 1.0)
        off = r[(rest > CAPPED) | ((f == f[0]) & is_flat)] if np.isfinite(rest).all() else r[:0]
        return off.max(initial=0.0), len(off)

    def ending(self) -> Answer:
        """The largest force beyond the cutoff."""
        beyond = np.abs(self.f(np.linspace(1.001 * self.cutoff, self.farthest, 20))).max()
        return beyond, beyond, self.cutoff

    def end(self) -> Answer:
        """Where the force ends, if it jumps to zero; whether it should end there."""
        found = jumps(self.f, np.linspace(NEAREST, self.farthest, GRID))
        end = next((r for r, _, above in found if above == 0.0), np.inf)
        cutoff = self.cutoff or np.inf
        is_odd = self.cutoff is None and end < np.inf and is_near(2.0 * end**2, round(2.0 * end**2))
        is_early = end < 0.999 * cutoff < np.inf or (
            is_odd and not is_near(100.0 * end, round(100.0 * end))
        )
        words = (
            "; ".join(f"jumps by {b - a:+.4g} at r = {r:.6g}" for r, a, b in found[:3])
            or "continuous"
        )
        return end, float(is_early) or (np.nan if found else 0.0), words

    def jump(self) -> Answer:
        """The first jump of the energy."""
        r, below, above = (
            *jumps(self.u, np.linspace(NEAREST, self.farthest, GRID)),
            (0.0, 0.0, 0.0),
        )[0]
        # minimd's energy jumps, too
        is_meant = getattr(self.potential, "truncation", "") == "truncated"
        return above - below, np.nan if is_meant else above - below, r, below

    def all_beside(self) -> Answer:
        """All forces and the energy beside those of minimd."""
        answer = evaluated(np.pad(self.x, ((0, 0), (0, 3 - self.d))), self.potential, self.cell)
        known = answer.forces[:, : self.d]
        energy = self.call(self.x)[1]
        right = answer.potential_energy
        off = np.abs(self.forces - known).max() / (np.abs(known).max() or 1.0)
        if "energy" in self.has and off < ROUNDING and not np.isclose(energy, right, rtol=1e-9):
            return off, 1.0, f"the energy is {energy:.8g}, not {right:.8g}"
        c = multiple_of(self.forces, known, EQUAL)
        return off, off, f"the forces differ by {off:.1%} of the largest (or by a factor: {c:.6g})"

    def reaction(self) -> Answer:
        """The sum of all forces, and what is wrong with a pair."""
        off = np.abs(self.forces.sum(axis=0)).max() / self.scale
        one, two = np.zeros((2, self.d))
        if self.takes(2):
            one, two = self.call(self.place(PROBE))[0]
        sizes = np.linalg.norm([one, two], axis=1)
        return (
            off,
            off,
            first_of(
                (
                    sizes.min() < ROUNDING * sizes.max(),
                    f": only one of the two atoms of a pair gets the force, atom "
                    f"{sizes.argmax()}; subtract from one what is added to the other (or use round, not floor)",
                ),
                (
                    sizes.any() and np.allclose(one, two),
                    ": both atoms of a pair get the same force; the second needs the other sign",
                ),
                (True, ""),
            )[0],
        )

    def all_slopes(self) -> Answer:
        """The forces of all atoms beside −∇U."""
        steps = np.eye(self.x.size).reshape(-1, *self.x.shape) * DELTA
        slopes = (
            -np.array([difference(lambda x: float(self.call(x)[1]), self.x, e) for e in steps])
            / DELTA
        )
        off = np.abs(self.forces.ravel() - slopes).max()
        c = multiple_of(self.forces.ravel(), slopes, EQUAL)
        return (
            off,
            off / (np.abs(slopes).max() or 1.0),
            f": they are {c:.6g} (−∇U)" if np.isfinite(c) else "",
        )

    def curl(self) -> float:
        """Whether forces without an energy can be a gradient: ∂F_i/∂x_j = ∂F_j/∂x_i."""
        some = (np.eye(self.x.size).reshape(-1, *self.x.shape) * DELTA)[:24]
        matrix = np.array(
            [np.ravel(difference(lambda x: self.call(x)[0], self.x, e))[: len(some)] for e in some]
        )
        return float(np.abs(matrix - matrix.T).max() / max(np.abs(matrix).max(), 1e-300))

    def images(self) -> Answer:
        """Nearest images across each face, in both directions."""
        # axes, and the part of the force that is there
        bad = list[tuple[int, float]]()
        middle = 0.5 * self.lengths
        for axis, sign in product(range(self.d), (1, -1)):
            unit = sign * self.units[axis]
            edge = self.lengths[axis]
            face = middle + (0.5 * edge - 0.2) * unit
            ends = (middle, middle + PROBE * unit), (face, face + (PROBE - edge) * unit)
            inside, across = (self.call(np.array(pair))[0] for pair in ends)
            if np.abs(across - inside).max() > SAME * np.abs(inside).max():
                bad.append((axis, np.abs(across).max() / np.abs(inside).max()))
        # wrapped positions interact across the origin
        pair = np.array([-0.5, 0.5])[:, None] * PROBE * self.units[0]
        origin, center = (
            np.abs(self.call(place + pair)[0]).max() for place in (0.0 * middle + 0.1, middle)
        )
        axes = sorted({axis for axis, _ in bad})
        verb = "missing" if any(part < 0.2 for _, part in bad) else "wrong"
        where = "along " + ", ".join("xyz"[axis] for axis in axes)
        return (
            len(bad),
            len(bad) + float(center < 0.2 * origin),
            first_of(
                (
                    center < 0.2 * origin,
                    f"positions are wrapped into the cell, but differences are not: {CURE}",
                ),
                (
                    len(bad) == 2 * self.d,
                    f"minimum image is {verb}: atoms across a face are no neighbors; {CURE}",
                ),
                (
                    len(bad) == 2 * len(axes),
                    f"minimum image is {verb} {where}, but right for the other axes",
                ),
                (
                    True,
                    f"minimum image is {verb} in one direction {where}: only one of dx > L/2 and dx < −L/2 is treated",
                ),
            )[0],
        )

    def sum_of_pairs(self) -> Answer:
        """The forces beside the sum, over pairs, of the forces on two atoms alone: other forces are a multiple of it,
        which is a fault, or many-body forces, which may be right."""
        n = len(self.x)
        forces = self.forces
        parts = np.zeros((n, *self.x.shape))
        for i, j in zip(*np.triu_indices(n, 1), strict=True):
            parts[i, j], parts[j, i] = self.call(self.x[[i, j]])[0]
        pairs = parts.sum(axis=1)
        small = SAME * self.scale
        off = np.abs(pairs - forces).max() / self.scale
        c = multiple_of(forces, pairs, SAME)
        single = (
            (np.abs(forces[:, None] - parts).max(axis=2) + np.diag(np.full(n, np.inf)))
            .min(axis=1)
            .max()
        )
        fault = first_of(
            (off < SAME, ""),
            (
                single < small,
                "each atom feels only one other atom: forces are overwritten (=), not added (+=)",
            ),
            (
                np.abs(forces[-1]).max() < 1e-4 * small,
                f"atom {n - 1}, the last, feels no force: check the bounds",
            ),
            (
                np.isfinite(c),
                f"the forces of {n} atoms are {c:.6g} times the sum of pair forces: they are divided "
                "or multiplied by a number of atoms",
            ),
            (True, ""),
        )[0]
        return off, off if fault or off < SAME else np.nan, fault


def evaluated(x: Array, potential: Any, lengths: Array | None) -> Any:
    """minimd's forces and energy. Bonds without pairs join the two atoms if there are two.

    Raises ValueError if there are more.
    """
    from minimd.core.forces.evaluation import evaluate  # only where a potential of minimd is given
    from minimd.core.potentials.bonded import Bond
    from minimd.core.structure.system import System

    is_bond = isinstance(potential, Bond) and potential.arguments()["pairs"] is None
    if is_bond and len(x) != 2:
        raise ValueError(
            f"{potential!r} does not say which of the {len(x)} atoms are bonded: give it pairs, such as "
            "pairs=[[0, 1]], or positions= of two atoms"
        )
    return evaluate(System(x, cell=lengths, bonds=[[0, 1]] if is_bond else None), potential)


# fmt: off
LAWS = (  # the most telling first
    Law("finite", lambda s: float(np.count_nonzero(~np.isfinite([*s.forces.flat, *s.values]))), 0.5, "{0:g} are not",
        "forces are not finite: an atom meets itself (i = j, r = 0), or two atoms coincide"),
    Law("parameters", Probe.without_effect, 0.5, "{0} have no effect", "{2}"),
    Law("central", lambda s: float(np.linalg.norm(np.cross(s.skew, SKEW)) / np.linalg.norm(s.skew)), 1e-9,
        "F × r_ij is {0:.1e} of F r", "the force of the pair does not point along r_ij", "pair"),
    Law("nearest image", Probe.images, 0.5, "atoms across {0} faces are no neighbors", "{2}", "forces pairs cell"),
    Law("rotation", lambda s: s.off(s.x @ s.turn, s.forces @ s.turn), SAME, "turned forces differ by {0:.1e}",
        "forces do not turn with atoms: a component is missing, or r is not √(x² + y² + z²)", "forces nofield free"),
    Law("a gradient", Probe.curl, 1e-4, "∂F_i/∂x_j − ∂F_j/∂x_i is {0:.1e} of the largest element", "the forces are "
        "not the gradient of any energy (∂F_i/∂x_j and ∂F_j/∂x_i differ): no energy is conserved", "forces noenergy"),
    Law("sum over pairs", Probe.sum_of_pairs, SAME, "F − Σ of single pairs is {0:.1e} of F", "{2}", "forces pairs"),
    Law("sum of forces", Probe.reaction, ROUNDING, "|Σ F| is {0:.1e} of F", "Σ F is not zero{2}", "forces nofield"),
    Law("not capped", Probe.cap, 0.5, "the force follows its law down to r = 0.3", "the force is capped at close "
        "distances (r = {0:.3f} and below), where it no longer follows its law", "pairs"),
    Law("powers of r", Probe.of_powers, 0.5, "F = {3}", "{2}", "pairs"),
    Law("force = −∇U", lambda s: s.like(s.slopes(s.r), "−du/dr of the energy"), 0.5, "F is {0:.6g} times −du/dr", "{2}",
        "pairs energy"),
    Law("as minimd's", lambda s: s.like(s.known, "minimd's force"), 0.5, "F is {0:.6g} times it", "{2}", "pairs known"),
    Law("cutoff", Probe.ending, 1e-300, "the largest force beyond it is {0:.2g}", "the cutoff {2:g} is not applied, "
        "or acts on the components, not on the distance: the largest force beyond it is {0:.3g}", "pairs cutoff"),
    Law("force continuous", Probe.end, 0.5, "{2}", "the force ends at r = {0:.6g}, where it should not: is r² "
        "compared with the cutoff, not with its square?", "pairs"),
    Law("energy continuous", Probe.jump, 1e-300, "first jump: {0:+.4g}", "the energy jumps at the cutoff by {0:+.4g} "
        "whenever a pair crosses r = {2:.6g}; subtract u(r_c) = {3:.4g} from the energy of a pair", "pairs energy"),
)
GENERAL = (  # told if no other law says why; of two translations, one may take a pair across a jump
    Law("all forces = −∇U", Probe.all_slopes, EQUAL, "off by {0:.1e}", "the forces are not −∇U{2}", "forces energy"),
    Law("exchange", lambda s: s.off(s.x[s.order], s.forces[s.order]), ROUNDING, "renumbered forces differ by {0:.1e}",
        "forces depend on the numbering of atoms: pairs are left out, or forces overwritten (=)", "forces"),
    Law("translation", lambda s: min(s.off(s.x + shift[: s.d], s.forces) for shift in SHIFTS), SAME,
        "shifted forces differ by {0:.1e}", "the forces change if all atoms are shifted", "forces nofield"),
    Law("periodic", lambda s: s.off(s.x + np.sign(s.x - s.x.mean()) * s.lengths, s.forces), SAME, "in other cells "
        "forces differ by {0:.1e}", f"forces on atoms outside the cell differ: {CURE}", "forces nofield cell"),
    Law("all atoms as minimd's", Probe.all_beside, ROUNDING, "off by {0:.1e}", "against minimd {2}", "forces known"),
    Law("external field", lambda s: np.nan, 0.5, "a single atom feels a force", "", "field"),
)
# fmt: on


def grade_forces(
    function: Function,
    potential: Any = None,
    cell: float | Sequence[float] | None = None,
    cutoff: float | None = None,
    positions: Any = None,
    kind: str | None = None,
) -> Grade:
    """See grade."""
    lengths = None if cell is None else checked_sizes("cell", cell, 3, "edge")
    given = None if positions is None else np.array(positions, dtype=float)
    if given is not None and (
        given.ndim != 2 or given.shape[1] != 3 or not np.isfinite(given).all()
    ):
        raise ValueError(f"positions must be (N, 3) finite numbers; got shape {given.shape}")
    if (
        cutoff is None
        and potential is not None
        and np.isfinite(getattr(potential, "cutoff", np.inf) or np.inf)
    ):
        cutoff = float(potential.cutoff)
    parameters = getattr(potential, "parameters", None)
    units = parameters if isinstance(parameters, tuple) and len(parameters) == 2 else (1.0, 1.0)
    edge = BOX if lengths is None else float(lengths[0]) if np.ptp(lengths) == 0.0 else lengths
    options = {
        "box": edge,
        "cutoff": cutoff or CUTOFF,
        "epsilon": units[0],
        "sigma": units[1],
        "n": 0,
    }
    options |= {"box given": lengths is not None, "cutoff given": cutoff is not None}
    with np.errstate(all="ignore"):
        call = StudentForce(function, options, kind, given)
    lengths = np.full(3, BOX) if "box" in call.takes and lengths is None else lengths
    cutoff = cutoff or CUTOFF if "cutoff" in call.takes else cutoff
    with np.errstate(all="ignore"):
        one = Probe(call, lengths, cutoff, given, potential)
        if edge := one.period():
            one = Probe(call, np.full(3, edge), cutoff, given, potential)
            one.remarks.append(
                f"forces are periodic along x with the period {edge:.6g}, taken as the edge of a cubic cell"
            )
        telling, general = (judged(laws, one) for laws in (LAWS, GENERAL))
        if one.cell is not None and cutoff is None and one.has >= {"forces", "pairs"}:
            rest = abs(one.f(0.4999 * one.cell.min()))
            one.remarks += first_of(
                (
                    rest,
                    f"the force jumps by {rest:.2g} where the nearest image changes: use a cutoff",
                )
            )
    faults = causes(telling) or causes(general)
    faults += [
        "the function changes the positions that it is given: work on a copy"
    ] * call.changes_input
    told = f"{call.name}({', '.join(call.names)}): {KINDS[call.kind]}{' and the energy' * call.has_energy}"
    return Grade(told, (*telling, *general), tuple(faults), one.name, tuple(one.remarks))
