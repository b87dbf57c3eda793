"""Pair potentials from a table u(rᵢ): a spline through its points, and the force that is exactly its derivative."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping, Sequence
from math import factorial, nan, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.compiled.kernels import scalar, type_of
from minimd.console.words import listed, shown
from minimd.potentials.pair import UNSCALED, Label, PairPotential, Parameters
from minimd.potentials.truncation import TruncationName
from minimd.structure.checks import checked_numbers

DEGREE = 5  # of the pieces: four continuous derivatives of u, so that methods up to order 4 keep their order
FEWEST = DEGREE + 1  # points that one piece goes through


class Table(namedtuple("Table", "knots coefficients density")):
    """Splines on one set of knots. Two tables are equal if they are the same object.

    knots : (M + 1,) increasing [length], the distances of the table.
    coefficients : (K, M, 6) of K splines with M pieces; u = Σ cₖ (r − knot)^(5 − k) [energy].
    density : pieces per length, if all were equally long; it gives the piece where a search begins.
    """

    __slots__ = ()
    __eq__, __ne__, __hash__ = object.__eq__, object.__ne__, object.__hash__


@scalar
def tabulated(r2, table, parameters):
    """One of the splines of a table.

        u(r)     = S(r), a polynomial of degree 5 between two knots
        −u′(r)/r = −S′(r)/r

    r2 : squared distance [length²].  parameters : (k,) number of the spline.
    Returns u [energy], −u′/r [energy/length²]; NaN closer than the first knot, where nothing is known;
    the last piece continues beyond the last knot.
    """
    r, n = sqrt(r2), table.knots.size - 1
    if r < table.knots[0]:
        return nan, nan
    low, high = int(min((r - table.knots[0]) * table.density, n - 1.0)), n
    if not table.knots[low] <= r < table.knots[low + 1]:
        low = 0
        while high - low > 1:
            middle = (low + high) // 2
            if r < table.knots[middle]:
                high = middle
            else:
                low = middle
    k, x = int(parameters[0]), r - table.knots[low]
    u = slope = 0.0
    for power in range(DEGREE + 1):
        slope = slope * x + u
        u = u * x + table.coefficients[k, low, power]
    return u, -slope / r


TabulatedLaw = type_of(tabulated)(namedtuple("TabulatedLaw", "table"))


class Tabulated(PairPotential):
    """A pair potential from a table: the quintic spline through the points (rᵢ, uᵢ), and its exact derivative.

    The spline has four continuous derivatives and an error of order Δr⁶ in the energy, Δr⁵ in the force (not-a-knot
    ends: C. de Boor, A Practical Guide to Splines (2001), chapters IV and XIII). Noise of the table appears in the
    force, divided by Δr: smooth a measured table. Closer than the first point nothing is known: u is NaN there, and a
    run ends with NonFiniteError. So begin the table well inside the repulsive wall. Tables use the pair list,
    one pair at a time; a law with a formula is several times faster.

    Parameters
    ----------
    r : (n,) distances [length], not negative, increasing, at least six, equally spaced or not.
    u : (n,) u(rᵢ) [energy]; or a mapping from pairs of species to such arrays, all at the same r.
    cutoff : r_c [length], within the table; its end if not given. A mapping from pairs of species as for PairPotential.
    truncation, switch_start, bonded_scale : as for PairPotential.

    Raises
    ------
    ValueError : for tables that are not increasing in r, too short, not finite or of different lengths, and a cutoff
        beyond the table; and as PairPotential.
    """

    def __init__(
        self,
        r: ArrayLike,
        u: ArrayLike | Mapping[tuple[Label, Label], ArrayLike],
        cutoff: float | Mapping[tuple[Label, Label], float] | None = None,
        truncation: TruncationName = "shifted",
        *,
        switch_start: float | None = None,
        bonded_scale: Sequence[float] = UNSCALED,
    ) -> None:
        self.r = _checked_distances(r)
        by_pair = u if isinstance(u, Mapping) else {None: u}
        self.u = {pair: _checked_energies(values, self.r, pair) for pair, values in by_pair.items()}
        if not self.u:
            raise ValueError("u must be energies, or a mapping with an entry for each pair of species; it is empty")
        pairs: Any = {pair: (float(k),) for k, pair in enumerate(self.u) if pair is not None}
        law = TabulatedLaw(_table(self.r, np.array([*self.u.values()])))
        numbers: Any = {} if pairs else (0.0,)
        reach = float(self.r[-1]) if cutoff is None else cutoff
        super().__init__(
            law, numbers, reach, truncation, pairs=pairs or None, switch_start=switch_start, bonded_scale=bonded_scale
        )
        if not self.r[0] < self.shortest_length <= self.cutoff <= self.r[-1]:
            wrong = self.cutoff if self.cutoff > self.r[-1] else self.shortest_length
            ends = f"which goes from r = {self.r[0]:g} to {self.r[-1]:g}"
            hint = "give another cutoff, or a longer table"
            raise ValueError(f"cutoff must lie within the table, {ends}; cutoff = {wrong:g}: {hint}")

    def law_arguments(self) -> dict[str, Any]:
        """See PairPotential."""
        return {"r": self.r, "u": self.u if self.pairs else self.u[None]}

    def _parameters_of(self, a: Any, b: Any) -> Parameters:
        if isinstance(self.parameters, dict) and (a, b) not in self.pairs:
            raise ValueError(f"Tabulated has no table for the pair {a!r}, {b!r}; it has {listed(self.u)}")
        return super()._parameters_of(a, b)


def _checked_distances(r: Any) -> NDArray[np.float64]:
    distances = checked_numbers("r", r, "increasing distances")
    if distances.ndim != 1 or len(distances) < FEWEST:
        wanted = f"at least {FEWEST} distances, for a spline of degree {DEGREE}"
        raise ValueError(f"r must be {wanted}; its shape is {distances.shape}")
    wrong = np.flatnonzero(~(np.isfinite(distances) & (distances >= 0.0)))
    if wrong.size:
        raise ValueError(f"r must be finite and not negative; r[{wrong[0]}] = {distances[wrong[0]]:g}")
    wrong = np.flatnonzero(np.diff(distances) <= 0.0)
    if wrong.size:
        k, hint = wrong[0], "sort the table, each r once"
        raise ValueError(
            f"r must increase; r[{k + 1}] = {distances[k + 1]:g} follows r[{k}] = {distances[k]:g}: {hint}"
        )
    return distances


def _checked_energies(u: Any, r: NDArray[np.float64], pair: Any) -> NDArray[np.float64]:
    """The energies of a table.  pair : of species; None for all."""
    name = "u" if pair is None else f"u of {pair!r}"
    energies = checked_numbers(name, u, "one energy for each r")
    if energies.shape != r.shape:
        raise ValueError(f"{name} must be {len(r)} energies, one for each r; its shape is {energies.shape}")
    wrong = np.flatnonzero(~np.isfinite(energies))
    if wrong.size:
        where = f"{shown(energies[wrong[0]].item())} at r[{wrong[0]}] = {r[wrong[0]]:g}"
        raise ValueError(f"{name} must be finite; it is {where}: leave such points out")
    return energies


def _table(r: NDArray[np.float64], u: NDArray[np.float64]) -> Table:
    """The splines through K rows of energies, (K, n)."""
    from scipy.interpolate import make_interp_spline  # here, so that importing minimd need not load it

    splines = [make_interp_spline(r, row, DEGREE) for row in u]
    powers = range(DEGREE, -1, -1)
    coefficients = [
        np.stack([one.derivative(k)(r[:-1]) / factorial(k) if k else one(r[:-1]) for k in powers], axis=-1)
        for one in splines
    ]
    return Table(r, np.array(coefficients), (len(r) - 1) / float(r[-1] - r[0]))
