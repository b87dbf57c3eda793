"""A pair potential from a table, by quintic splines."""

from __future__ import annotations

import os
from collections import namedtuple
from collections.abc import Mapping, Sequence
from math import factorial, nan, sqrt
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from minimd.core.compiled.kernels import scalar
from minimd.core.console.quiet import warn
from minimd.core.console.words import shown
from minimd.core.potentials import declared as kind
from minimd.core.potentials.declared import declared
from minimd.core.potentials.law import law_type
from minimd.core.potentials.pair import (
    FOR_PAIRS,
    TRUNCATION,
    Cutoff,
    Label,
    Nonbonded,
    PairPotential,
    checked_cutoffs,
)
from minimd.core.potentials.splines import Identical
from minimd.core.potentials.table_file import read_table
from minimd.core.potentials.truncation import TruncationName
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_numbers

# of the pieces of a table: four continuous derivatives of u, so that methods up to order 4 keep their order
DEGREE = 5
FEWEST = DEGREE + 1  # points that one piece goes through
# a force of a file may differ from -du/dr by this part; points on each side whose slopes are compared
SAME_FORCE = 0.02
BESIDE = 2
FOR_EACH = "one number for each r, or a mapping from pairs of species to them"


class Table(Identical, namedtuple("Table", "knots coefficients density")):
    """Splines on one set of knots.

    knots : (M + 1,) increasing [length], the distances of the table.
    coefficients : (K, M, 6) of K splines with M pieces; u = Σ cₖ (r − knot)^(5 − k) [energy].
    density : pieces per length, if all were equally long; it gives the piece where a search begins.
    """

    __slots__ = ()


@scalar
def tabulated(r2, table, parameters):
    """One of the splines of a table.

        u(r)     = S(r), a polynomial of degree 5 between two knots
        −u′(r)/r = −S′(r)/r

    r2 : squared distance [length²].
    parameters : (k,) number of the spline.
    Returns u [energy], −u′/r [energy/length²]; NaN closer than the first knot, where nothing is known;
    the last piece continues beyond the last knot.
    """
    r = sqrt(r2)
    n = table.knots.size - 1
    if r < table.knots[0]:
        return nan, nan
    low = int(min((r - table.knots[0]) * table.density, n - 1.0))
    high = n
    if not table.knots[low] <= r < table.knots[low + 1]:
        low = 0
        while high - low > 1:
            middle = (low + high) // 2
            if r < table.knots[middle]:
                high = middle
            else:
                low = middle

    k = int(parameters[0])
    x = r - table.knots[low]
    u = slope = 0.0
    for power in range(DEGREE + 1):
        slope = slope * x + u
        u = u * x + table.coefficients[k, low, power]
    return u, -slope / r


TabulatedLaw = law_type("TabulatedLaw", tabulated)
TabulatedLaw.is_scalar = True


class Tabulated(Nonbonded):
    """A pair potential from a table: the quintic spline through the points (rᵢ, uᵢ), and its exact derivative.

    The spline has four continuous derivatives and an error of order Δr⁶ in the energy, Δr⁵ in the force (not-a-knot
    ends: C. de Boor, A Practical Guide to Splines (2001), chapters IV and XIII). Noise of the table appears in the
    force, divided by Δr: smooth a measured table. Closer than the first point nothing is known: u is NaN there, and a
    run ends with NonFiniteError. So begin the table well inside the repulsive wall. Tables use the pair list,
    one pair at a time; a law with a formula is several times faster.
    """

    r: ArrayLike = declared(
        kind.given, "equally spaced or not", "length", of=f"{FEWEST} or more increasing distances"
    )
    u: ArrayLike | Mapping[tuple[Label, Label], ArrayLike] = declared(
        kind.given, "u(r)", "energy", of=FOR_EACH
    )
    cutoff: Cutoff | None = declared(
        kind.given, "r_c; the end of the table if not given", "length", of=FOR_PAIRS, default=None
    )
    truncation: TruncationName = TRUNCATION
    mixing: None = declared(kind.given, init=False, default=None)
    pairs: None = declared(kind.given, init=False, default=None)
    tail_correction: bool = declared(kind.flag, init=False, default=False)

    @classmethod
    def from_file(
        cls,
        file: str | os.PathLike[str],
        keyword: str | None = None,
        cutoff: float | None = None,
        truncation: TruncationName = "shifted",
    ) -> Tabulated:
        """The potential in a file for LAMMPS' pair_style table, in Å and eV, or in σ and ε; kcal/mol if it says so.

        keyword : of the section; not needed in a file of one.
        A force in the file that is not −du/dr is told by a warning: the force is the derivative of the spline.
        Raises OSError for a file that cannot be read; ValueError for one that holds something else.
        """
        r, u, force = read_table(file, keyword)
        potential = cls(r, u, cutoff, truncation)
        _tell_of_force(r, u, force)
        return potential

    def as_law(self) -> tuple[Any, Any, Any]:
        """See Nonbonded."""
        r = _checked_distances(self.r)
        is_by_pair = isinstance(self.u, Mapping)
        by_pair: Any = self.u if is_by_pair else {None: self.u}
        energies: Any = {pair: _checked_energies(u, r, pair) for pair, u in by_pair.items()}
        if not energies:
            raise ValueError(
                "u must be energies, or a mapping with an entry for each pair of species; it is empty"
            )

        self.r = r
        self.u = energies if is_by_pair else energies[None]
        if self.cutoff is None:
            self.cutoff = float(r[-1])
        cutoffs = checked_cutoffs(self.cutoff).values()
        shortest = min(cutoffs)
        longest = max(cutoffs)
        if not r[0] < shortest <= longest <= r[-1]:
            wrong = longest if longest > r[-1] else shortest
            raise ValueError(
                f"cutoff must lie within the table, which goes from r = {r[0]:g} to {r[-1]:g}; "
                f"cutoff = {wrong:g}: give another cutoff, or a longer table"
            )

        law = TabulatedLaw(_table(r, [*energies.values()]))
        if not is_by_pair:
            return law, (0.0,), {}
        return law, {}, {pair: (float(k),) for k, pair in enumerate(energies)}


def _checked_distances(r: Any) -> Array:
    distances = checked_numbers("r", r, "increasing distances")
    if distances.ndim != 1 or len(distances) < FEWEST:
        raise ValueError(
            f"r must be at least {FEWEST} distances, for a spline of degree {DEGREE}; "
            f"its shape is {distances.shape}"
        )

    wrong = np.flatnonzero(~(np.isfinite(distances) & (distances >= 0.0)))
    if wrong.size:
        raise ValueError(
            f"r must be finite and not negative; r[{wrong[0]}] = {distances[wrong[0]]:g}"
        )

    steps = np.diff(distances)
    if not steps.min() > 0.0:
        k = np.argmin(steps > 0.0)
        raise ValueError(
            f"r must increase; r[{k + 1}] = {distances[k + 1]:g} follows r[{k}] = {distances[k]:g}: "
            "sort the table, each r once"
        )

    return distances


def _checked_energies(u: Any, r: Array, pair: Any) -> Array:
    """The energies of a table.
    pair : of species; None for all."""
    name = "u" if pair is None else f"u of {pair!r}"
    energies = checked_numbers(name, u, "one energy for each r")
    if energies.shape != r.shape:
        raise ValueError(
            f"{name} must be {len(r)} energies, one for each r; its shape is {energies.shape}"
        )
    wrong = np.flatnonzero(~np.isfinite(energies))
    if wrong.size:
        k = wrong[0]
        raise ValueError(
            f"{name} must be finite; it is {shown(energies[k].item())} at r[{k}] = {r[k]:g}: leave such points out"
        )
    return energies


def _tell_of_force(r: Array, u: Array, force: Array) -> None:
    """Warn of a force that is not −du/dr, by more than slopes of u nearby differ: a table may be rounded or coarse."""
    slopes = sliding_window_view(-np.diff(u) / np.diff(r), 2 * BESIDE)
    middles = slopes.mean(axis=1)
    allowed = SAME_FORCE * np.abs(middles) + 1.5 * np.ptp(slopes, axis=1)
    wrong = BESIDE + np.flatnonzero(np.abs(force[BESIDE:-BESIDE] - middles) > allowed)
    if wrong.size:
        k = wrong[0]
        warn(
            f"the force in the table is not -du/dr at {wrong.size} distances, first at r = {r[k]:g}: it is "
            f"{force[k]:g} in the file and {middles[k - BESIDE]:g} from the energies, which minimd takes"
        )


def _table(r: Array, energies: Sequence[Array]) -> Table:
    """The splines through energies, each (n,)."""
    # here, so that importing minimd need not load it
    from scipy.interpolate import make_interp_spline

    splines = [make_interp_spline(r, u, DEGREE) for u in energies]
    powers = range(DEGREE, -1, -1)
    pieces = [[spline.derivative(k)(r[:-1]) / factorial(k) for k in powers] for spline in splines]
    coefficients = np.ascontiguousarray(np.moveaxis(np.array(pieces), 1, -1))
    return Table(r, coefficients, (len(r) - 1) / float(r[-1] - r[0]))


PairPotential.register(Tabulated)
