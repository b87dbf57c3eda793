"""What is measured on a student's force function: on many atoms, and on one pair at a distance, with f > 0 for
repulsion. The laws are in forces.py."""

import re
from itertools import product
from typing import Any

import numpy as np

from minimd.core.structure.arrays import Array
from minimd.judge.calling import REST, StudentForce, plain
from minimd.judge.findings import Answer, is_near
from minimd.judge.powers import Powers, compared, jumps, powers_of
from minimd.judge.problems import difference, largest, multiple_of

CUTOFF = 2.5  # σ: for a function that takes a cutoff, if the user gives none
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
CLOSEST = 0.3  # σ: from here on, a cap is searched
NEAREST = 0.77  # σ: from here on, forces are ordinary
FARTHEST = 6.0  # σ: to here, an end is searched
POINTS = 40  # of profiles
GRID = 500  # of jumps
DELTA = 3e-4  # of differences
FACTOR = 1.15  # of larger parameters
SKEW = np.array([0.9, 0.5, -0.4])  # a vector of a pair that is parallel to no plane of the axes
WHERE = np.array([0.31, 0.47, 0.23])
SHIFTS = np.array([[0.013, -0.007, 0.021], [0.002, 0.001, 0.003]])
ALONG = {2: np.array([0.6, 0.8]), 3: np.array([0.6, 0.48, 0.64])}
CURE = "use dx − L · round(dx/L)"


class Probe:
    """A student's forces, and what is measured on them: see Law.measure.

    has : what laws may need: the kind of the call (forces, law or pair); of many atoms field or nofield; cell or free,
        energy or noenergy, known, cutoff, and pairs.
    x, forces : atoms in the test, or the distance or the vector of a pair, and the forces there.
    r, values, known : distances, the force of a pair there, and that of the potential.
    """

    def __init__(
        self, call: StudentForce, cell: Array | None, cutoff: Any, positions: Any, potential: Any
    ) -> None:
        self.call = call
        self.d = call.dimensions
        self.cell = cell
        self.cutoff = cutoff
        self.potential = potential
        self.along = ALONG[self.d]
        self.start = WHERE[: self.d]
        self.farthest = FARTHEST
        self.lengths: Any = None
        if cell is not None:
            self.lengths = cell[: self.d]
            self.start = self.start * (0.3 * self.lengths / self.lengths.max())
            self.farthest = min(FARTHEST, 0.4995 * cell.min())

        self.f = np.vectorize(lambda r: self.both(r)[0], [float])
        self.u = np.vectorize(lambda r: self.both(r)[1], [float])
        self.values = np.zeros(0)
        self.is_over_r = False
        self.remarks = list[str]()
        self.name = ""

        self.has = {
            call.kind,
            "free" if cell is None else "cell",
            "energy" if call.has_energy else "noenergy",
        }
        if potential is not None:
            self.has.add("known")
        if cutoff and cutoff < self.farthest:
            self.has.add("cutoff")

        is_many = call.kind == "forces"
        self.x = self.place(PROBE)
        if is_many:
            self.x = self.cluster() if positions is None else positions
        self.forces = call(self.x)[0]
        self.scale = largest(self.forces) or 1.0
        has_pairs: Any = np.isfinite(self.forces).all()
        if is_many:
            has_field = False
            if self.takes(1):
                alone, _ = call(self.place(PROBE)[:1])
                has_field = bool(alone.any())
            self.has.add("field" if has_field else "nofield")
            has_pairs = has_pairs and not has_field and self.takes(2)
            if cell is None:
                has_pairs = has_pairs and self.turned() < SAME

        if has_pairs:
            self.has.add("pairs")
            self.find_profile()

    def takes(self, n: int) -> bool:
        """Whether the function works for n atoms."""
        try:
            forces, _ = self.call(self.place(PROBE)[:n])
        except Exception:  # whatever a student's function raises
            return False
        return forces.shape == (n, self.d)

    def cluster(self) -> Array:
        """Atoms near the sites of a cubic lattice, no two closer than σ; in a cell, around one of its corners. No
        pair is near the cutoff, or half the cell along an axis, where forces may jump."""
        lengths = self.lengths
        cutoff = self.cutoff or CUTOFF
        n_sites: Any = [5 - self.d] * self.d
        if lengths is not None:
            n_sites = np.clip((lengths / SPACING).astype(int), 1, 6 - self.d)
        sites = [*product(*map(range, n_sites))]
        lattice = SPACING * np.array(sites)
        first, second = np.triu_indices(len(sites), 1)

        def margin(x: Array) -> float:
            apart = np.abs(x[first] - x[second])
            margin_of_half = np.inf
            if lengths is not None:
                margin_of_half = np.abs(apart - 0.5 * lengths).min()
                apart = np.minimum(apart, lengths - apart)
            distances = np.linalg.norm(apart, axis=1)
            return min(margin_of_half, np.abs(distances - cutoff).min())

        trials = list[Array]()
        for seed in range(TRIALS):
            random = np.random.default_rng(seed)
            trials.append(lattice + random.uniform(-JITTER, JITTER, lattice.shape))
        x = max(trials, key=margin)
        if lengths is None:
            return x + 0.5
        return np.mod(x - SPACING + 0.3, lengths)

    def place(self, r: float) -> Any:
        """The argument of the function for two atoms at a distance."""
        if self.call.kind == "law":
            return r * r if self.call.is_squared else r
        apart = r * self.along
        if self.call.kind == "pair":
            return apart
        return np.array([self.start, self.start + apart])

    def both(self, r: float) -> tuple[float, float]:
        """f and u of a pair."""
        f, u = self.call(self.place(r))
        if self.call.kind != "law":
            f = f @ self.along
        if self.call.kind == "forces":
            f = max(-f[0], f[1], key=abs)
        if self.is_over_r:
            f = f * r
        return float(f), float(u)

    def slopes(self, r: Array) -> Array:
        """−du/dr."""
        return -np.asarray(difference(self.u, r, DELTA)) / DELTA

    def find_profile(self) -> None:
        """The force of a pair at ordinary distances, that of the potential, and the powers of r."""
        end = min(self.farthest, 0.9 * (self.cutoff or CUTOFF), 2.2)
        distances = np.linspace(1.0, end, 60)
        zeros = distances[self.f(distances) == 0.0]
        if zeros.size:
            end = 0.98 * zeros[0]
        self.r = np.linspace(NEAREST, end, POINTS)
        self.values = self.f(self.r)

        right = None
        if "known" in self.has:
            values = list[float]()
            for r in self.r:
                pair = np.array([[0.0, 0.0, 0.0], [r, 0.0, 0.0]])
                answer = evaluated(pair, self.potential, None)
                values.append(answer.forces[1, 0])
            self.known = np.array(values)
            right = self.known
        if "energy" in self.has:
            right = self.slopes(self.r)
        if self.call.kind == "law" and right is not None:
            _, power, _ = compared(self.values, right, self.r, "")
            if power == -1.0:
                self.is_over_r = True
                self.values = self.f(self.r)
                self.remarks.append(
                    "the law returns f = −u′(r)/r, as minimd's laws do: multiply it by the vector r_ij"
                )
        self.powers = powers_of(self.values, self.r)

    def period(self) -> float:
        """The edge of a cell inside the function, after which the force of a pair repeats; 0 if there is none."""
        if not self.has >= {"forces", "pairs", "free"}:
            return 0.0

        def at(distance: float) -> float:
            pair = np.array([self.start, self.start])
            pair[1, 0] += distance
            return self.call(pair)[0][1, 0]

        first = at(1.5)
        if not first:
            return 0.0
        for far in np.arange(3.0, LONGEST, 0.25):
            if abs(at(far)) > 0.5 * abs(first):
                break
        else:
            return 0.0

        def misfit(edge: float) -> float:
            return abs(at(edge + 1.5) - first) + abs(at(edge - 1.5) + first)

        edge = min(np.arange(far - 2.0, far + 3.0, 0.005), key=misfit)
        edge = np.round(edge, 3)
        return edge if abs(at(edge + 1.5) - first) < 0.05 * abs(first) else 0.0

    def off(self, x: Array, right: Array) -> float:
        """The relative difference of the forces at x from those that are right."""
        return largest(self.call(x)[0] - right) / self.scale

    def not_finite(self) -> int:
        """The number of forces that are not finite."""
        numbers = [*self.forces.flat, *self.values]
        return int(np.count_nonzero(~np.isfinite(numbers)))

    def sideways(self) -> float:
        """The part of the force of a pair across its vector."""
        force, _ = self.call(SKEW)
        across = np.cross(force, SKEW)
        size = np.linalg.norm(force)
        return float(np.linalg.norm(across) / size)

    def turned(self) -> float:
        """How far forces on atoms that are turned differ from turned forces."""
        random = np.random.default_rng(4)
        turn, _ = np.linalg.qr(random.normal(size=(self.d, self.d)))
        return self.off(self.x @ turn, self.forces @ turn)

    def renumbered(self) -> float:
        """How far forces on renumbered atoms differ."""
        order = np.random.default_rng(2).permutation(len(self.x))
        return self.off(self.x[order], self.forces[order])

    def shifted(self) -> float:
        """How far forces on atoms that are all shifted differ. Of two shifts, one may take a pair across a jump."""
        shifts = SHIFTS[:, : self.d]
        return min(self.off(self.x + shift, self.forces) for shift in shifts)

    def in_other_cells(self) -> float:
        """How far forces on atoms outside the cell differ."""
        shifts = np.sign(self.x - self.x.mean()) * self.lengths
        return self.off(self.x + shifts, self.forces)

    def as_slope(self) -> Answer:
        """The force of a pair beside the slope of its energy."""
        return self.like(self.slopes(self.r), "−du/dr of the energy")

    def as_known(self) -> Answer:
        """The force of a pair beside that of minimd."""
        return self.like(self.known, "minimd's force")

    def without_effect(self) -> Answer:
        """The physical parameters, such as ε and σ, that have no effect when they are increased."""
        call = self.call
        values = call.values
        names = list[str]()
        can_differ = np.isfinite(self.forces).all() and self.forces.any()
        for name, value in call.physical.items() if can_differ else ():
            call.values = {**values, name: FACTOR * value}
            try:
                if np.array_equal(self.forces, call(self.x)[0]):
                    names.append(name)
            except Exception:  # whatever a student's function raises
                continue
            finally:
                call.values = values
        sentence = f"forces do not change when {' or '.join(names)} is increased"
        if re.search(REST, plain(" ".join(names))):
            sentence += "; with a rest length F = −k (r − r0) r_ij/r"
        return len(names), len(names), sentence

    def like(self, right: Array, other: str) -> Answer:
        """The force of a pair beside the one that it should be."""
        c, _, fault = compared(self.values, right, self.r, other)
        return c, bool(fault), fault

    def of_powers(self) -> Answer:
        """The powers of r; those of Lennard-Jones are needed with the function's ε and σ, or without an energy."""
        roles = self.call.roles
        units = {roles[name]: value for name, value in self.call.physical.items()}
        has_units = {"epsilon", "sigma"} <= {*units}
        is_alone = has_units or self.has.isdisjoint({"known", "energy"})
        own = self.powers or Powers({})
        exponents = [*own.terms]
        is_nearly_known = len(exponents) == 2 and largest(np.subtract(exponents, (13, 7))) <= 2
        off = 0.0
        fault = ""
        if exponents == [1] and is_alone and self.call.kind != "law":
            off = np.nan
            self.remarks.append(
                "the force of a pair decreases as r^−1. If q²/r² is meant, a factor 1/r is missing: q² r_ij/r³, not "
                "q² r_ij/r²"
            )
        elif is_nearly_known:
            fault = self.beside_lennard_jones(own, units, has_units)
            if fault:
                off = 1.0 if is_alone else np.nan
        return np.nan, off, fault, self.powers

    def beside_lennard_jones(self, own: Powers, units: dict[str, float], has_units: bool) -> str:
        """The fault of two powers that are nearly those of Lennard-Jones, if they differ from these with the units."""
        repulsion, attraction = own.terms.values()
        s6 = abs(repulsion / attraction) / 2.0
        depth = abs(attraction) / 24.0 / s6
        self.name = f"Lennard-Jones with ε = {depth:.6g}, σ = {s6 ** (1 / 6):.6g}"
        has_own_units = (
            [*own.terms] == [13, 7]
            and repulsion > 0.0 > attraction
            and not is_near(s6, 1.0)
            and not is_near(repulsion, 48.0)
            and not is_near(attraction, -24.0)
        )
        if has_own_units and not has_units:
            return ""

        epsilon = units.get("epsilon", 1.0)
        sigma = units.get("sigma", 1.0)
        terms = {13: 48.0 * epsilon * sigma**12, 7: -24.0 * epsilon * sigma**6}
        right = Powers(terms, own.constant)
        law = f"48 ε σ¹² r^−13 − 24 ε σ⁶ r^−7 with ε = {epsilon:g}, σ = {sigma:g}"
        return compared(self.values, right.at(self.r), self.r, law)[2]

    def cap(self) -> Answer:
        """The largest close distance at which the force is not its law, a sum of powers or −du/dr, or is constant."""
        r = np.geomspace(CLOSEST, 1.0, POINTS)
        f = self.f(r)
        far = self.r > 1.0
        powers = self.powers or powers_of(self.values[far], self.r[far])

        right = f
        if powers:
            right = powers.at(r)
        elif "energy" in self.has:
            right = self.slopes(r)
        rest = np.abs(f / right - 1.0)
        if not np.isfinite(rest).all():
            return 0.0, 0

        is_flat = np.ptp(f[:4]) == 0.0 != np.ptp(f)
        is_capped = (rest > CAPPED) | (is_flat & (f == f[0]))
        return r[is_capped].max(initial=0.0), is_capped.sum()

    def ending(self) -> Answer:
        """The largest force beyond the cutoff."""
        distances = np.linspace(1.001 * self.cutoff, self.farthest, 20)
        beyond = largest(self.f(distances))
        return beyond, beyond, self.cutoff

    def end(self) -> Answer:
        """Where the force ends, if it jumps to zero; whether it should end there."""
        places = jumps(self.f, np.linspace(NEAREST, self.farthest, GRID))
        if not places:
            return np.inf, 0.0, "continuous"

        end = next((r for r, _, above in places if above == 0.0), np.inf)
        if self.cutoff:
            is_early = end < 0.999 * self.cutoff
        else:  # the square of a cutoff of few digits
            is_odd = np.isfinite(end) and is_near(2.0 * end**2, round(2.0 * end**2))
            is_early = is_odd and not is_near(100.0 * end, round(100.0 * end))
        changes = [
            f"jumps by {above - below:+.4g} at r = {r:.6g}" for r, below, above in places[:3]
        ]
        return end, 1.0 if is_early else np.nan, "; ".join(changes)

    def jump(self) -> Answer:
        """The first jump of the energy."""
        places = jumps(self.u, np.linspace(NEAREST, self.farthest, GRID))
        r, below, above = places[0] if places else (0.0, 0.0, 0.0)
        change = above - below
        # minimd's energy jumps, too
        is_meant = getattr(self.potential, "truncation", "") == "truncated"
        return change, np.nan if is_meant else change, r, below

    def all_beside(self) -> Answer:
        """All forces and the energy beside those of minimd."""
        missing = 3 - self.d
        x = np.pad(self.x, ((0, 0), (0, missing)))
        answer = evaluated(x, self.potential, self.cell)
        known = answer.forces[:, : self.d]
        right = answer.potential_energy
        _, energy = self.call(self.x)
        off = largest(self.forces - known) / (largest(known) or 1.0)
        if "energy" in self.has and off < ROUNDING and not np.isclose(energy, right, rtol=1e-9):
            return off, 1.0, f"the energy is {energy:.8g}, not {right:.8g}"
        c = multiple_of(self.forces, known, EQUAL)
        return off, off, f"the forces differ by {off:.1%} of the largest (or by a factor: {c:.6g})"

    def reaction(self) -> Answer:
        """The sum of all forces, and what is wrong with a pair."""
        off = largest(self.forces.sum(axis=0)) / self.scale
        pair = np.zeros((2, self.d))
        if self.takes(2):
            pair, _ = self.call(self.place(PROBE))
        sizes = np.linalg.norm(pair, axis=1)
        fault = ""
        if sizes.min() < ROUNDING * sizes.max():
            fault = (
                f": only one of the two atoms of a pair gets the force, atom {sizes.argmax()}; subtract from one what "
                "is added to the other (or use round, not floor)"
            )
        elif sizes.any() and np.allclose(*pair):
            fault = ": both atoms of a pair get the same force; the second needs the other sign"
        return off, off, fault

    def changes(self, part: int, n: int) -> list[Array]:
        """DELTA times the derivatives of the forces (part 0) or of the energy (part 1) by the first n coordinates."""

        def at(x: Array) -> Any:
            return self.call(x)[part]

        units = np.eye(self.x.size)[:n]
        shifts = DELTA * units.reshape(-1, *self.x.shape)
        return [difference(at, self.x, shift) for shift in shifts]

    def all_slopes(self) -> Answer:
        """The forces of all atoms beside −∇U."""
        slopes = -np.array(self.changes(1, self.x.size)) / DELTA
        forces = self.forces.ravel()
        off = largest(forces - slopes)
        c = multiple_of(forces, slopes, EQUAL)
        relation = f": they are {c:.6g} (−∇U)" if np.isfinite(c) else ""
        return off, off / (largest(slopes) or 1.0), relation

    def curl(self) -> float:
        """Whether forces without an energy can be a gradient: ∂F_i/∂x_j = ∂F_j/∂x_i."""
        changes = self.changes(0, 24)
        n = len(changes)
        matrix = np.array(changes).reshape(n, -1)[:, :n]
        return largest(matrix - matrix.T) / max(largest(matrix), 1e-300)

    def images(self) -> Answer:
        """Nearest images across each face, in both directions."""
        shares = dict[tuple[int, int], float]()  # of a wrong force, in the right one, by face
        middle = 0.5 * self.lengths
        units = np.eye(self.d)
        for axis, sign in product(range(self.d), (1, -1)):
            unit = sign * units[axis]
            edge = self.lengths[axis]
            face = middle + (0.5 * edge - 0.2) * unit
            pair_inside = np.array([middle, middle + PROBE * unit])
            pair_across = np.array([face, face + (PROBE - edge) * unit])
            inside, _ = self.call(pair_inside)
            across, _ = self.call(pair_across)
            size = largest(inside)
            if largest(across - inside) > SAME * size:
                shares[axis, sign] = largest(across) / size

        # wrapped positions interact across the origin
        pair = np.array([-0.5, 0.5])[:, None] * PROBE * units[0]
        at_origin, _ = self.call(0.1 + pair)
        at_middle, _ = self.call(middle + pair)
        is_wrapped = largest(at_middle) < 0.2 * largest(at_origin)

        n = len(shares)
        axes = sorted({axis for axis, _ in shares})
        names = ", ".join("xyz"[axis] for axis in axes)
        verb = "missing" if min(shares.values(), default=1.0) < 0.2 else "wrong"
        if is_wrapped:
            fault = f"positions are wrapped into the cell, but differences are not: {CURE}"
        elif n == 2 * self.d:
            fault = f"minimum image is {verb}: atoms across a face are no neighbors; {CURE}"
        elif n == 2 * len(axes):
            fault = f"minimum image is {verb} along {names}, but right for the other axes"
        else:
            fault = (
                f"minimum image is {verb} in one direction along {names}: only one of dx > L/2 and dx < −L/2 is "
                "treated"
            )
        return n, n + is_wrapped, fault

    def sum_of_pairs(self) -> Answer:
        """The forces beside the sum, over pairs, of the forces on two atoms alone: other forces are a multiple of it,
        which is a fault, or many-body forces, which may be right."""
        n = len(self.x)
        forces = self.forces
        parts = np.zeros((n, *self.x.shape))
        for i, j in zip(*np.triu_indices(n, 1), strict=True):
            pair, _ = self.call(self.x[[i, j]])
            parts[i, j], parts[j, i] = pair
        pairs = parts.sum(axis=1)
        off = largest(pairs - forces) / self.scale
        if off < SAME:
            return off, off, ""

        small = SAME * self.scale
        distances = np.abs(forces[:, None] - parts).max(axis=2)
        np.fill_diagonal(distances, np.inf)
        c = multiple_of(forces, pairs, SAME)
        if distances.min(axis=1).max() < small:
            fault = (
                "each atom feels only one other atom: forces are overwritten (=), not added (+=)"
            )
        elif largest(forces[-1]) < 1e-4 * small:
            fault = f"atom {n - 1}, the last, feels no force: check the bounds"
        elif np.isfinite(c):
            fault = (
                f"the forces of {n} atoms are {c:.6g} times the sum of pair forces: they are divided or multiplied by "
                "a number of atoms"
            )
        else:
            return off, np.nan, ""
        return off, off, fault


def evaluated(x: Array, potential: Any, lengths: Array | None) -> Any:
    """minimd's forces and energy. Bonds without pairs join the two atoms if there are two.

    Raises ValueError if there are more.
    """
    from minimd.core.diagnosis.evaluation import (
        evaluate,  # only where a potential of minimd is given
    )
    from minimd.core.potentials.bonded import Bond
    from minimd.core.structure.system import System

    is_bond = isinstance(potential, Bond) and potential.arguments()["pairs"] is None
    if is_bond and len(x) != 2:
        raise ValueError(
            f"{potential!r} does not say which of the {len(x)} atoms are bonded: give it pairs, such as "
            "pairs=[[0, 1]], or positions= of two atoms"
        )
    bonds = [[0, 1]] if is_bond else None
    return evaluate(System(x, cell=lengths, bonds=bonds), potential)
