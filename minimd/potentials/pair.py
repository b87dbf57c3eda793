"""Pair potentials: a law or a table, its parameters for each pair of species, given or mixed, cutoff and truncation."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from inspect import signature
from math import factorial, inf, isclose, isfinite, nan, pi, sqrt
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.compiled.kernels import scalar, type_of
from minimd.console.words import listed, near, shown
from minimd.potentials.law import UserLaw, check_user_law, checked_law, evaluate_law, law_at
from minimd.potentials.laws import LennardJonesLaw
from minimd.potentials.term import OwnPotential, OwnTerm, PairLaw, no_bonds
from minimd.potentials.truncation import SWITCHES, TRUNCATIONS, TruncationName
from minimd.structure.bond_graph import checked_pairs
from minimd.structure.checks import checked_choice, checked_flag, checked_number, checked_numbers
from minimd.structure.system import System

SWITCH_FROM = 0.8  # default start of switching, in units of the cutoff
# relative errors of tail integrals: the one requested, and the one above which an integral counts as divergent
ACCURACY, CONVERGED = 1e-12, 1e-8
TRIED_AT = (0.47, 0.71, 0.93)  # of the cutoff: where a user's laws are tried
UNSCALED = (1.0, 1.0, 1.0)
MIXED = 1e-9  # relative difference between mixed parameters of a pair and of the reverse pair that rounding can explain
DEGREE = 5  # of the pieces of a table: four continuous derivatives of u, so that methods up to order 4 keep their order
FEWEST = DEGREE + 1  # points that one piece goes through

Label = str | int
Parameters = tuple[float, ...]
ByLabel = Mapping[Label, Parameters]
ByPairOfLabels = Mapping[tuple[Label, Label], Parameters]


def lorentz_berthelot(first: Parameters, second: Parameters) -> Parameters:
    """(ε, σ) of an unlike pair: ε = √(ε₁ ε₂), σ = (σ₁ + σ₂)/2.  H. A. Lorentz, Ann. Phys. 248, 127 (1881); D.
    Berthelot, C. R. 126, 1703 (1898)."""
    return sqrt(first[0] * second[0]), 0.5 * (first[1] + second[1])


def geometric(first: Parameters, second: Parameters) -> Parameters:
    """(ε, σ) of an unlike pair: ε = √(ε₁ ε₂), σ = √(σ₁ σ₂)."""
    return sqrt(first[0] * second[0]), sqrt(first[1] * second[1])


MixingName = Literal["lorentz-berthelot", "geometric"]  # the keys of MIXING
MIXING = {"lorentz-berthelot": lorentz_berthelot, "geometric": geometric}


class PairPotential(OwnPotential):
    """A law u(r) between all pairs of atoms closer than a cutoff.

    Parameters
    ----------
    law : function law(r2, *parameters) of the squared distance [length²] that returns u [energy] and −u′(r)/r
        [energy/length²]; plain Python with numbers, or already compiled by numba.njit.
    parameters : tuple of numbers for all atoms, or a mapping from species to such tuples.
    cutoff : r_c [length], or a mapping from pairs of species to it; None for none, only in scenes without periodicity.
    truncation : "shifted" (default), "truncated", "force-shifted", or a switch, "switched", "charmm" or "smooth" (for
        methods of order above 2): see minimd.potentials.truncation.
    mixing : name of a rule or a function of two parameter tuples, for pairs of species not in pairs.
    pairs : mapping from pairs of species, in either order, to their parameters;
        only together with a mapping from species.
    switch_start : r_on [length] of the switches; 0.8 r_c if not given.
    bonded_scale : factors for pairs one, two and three bonds apart; 0 excludes, 1 (default) changes nothing. In a cell
        smaller than the cutoff they hold for the nearest image of the pair only.
    tail_correction : add the energy and virial of the pairs that the truncation leaves out, at uniform density
        (g = 1). For "truncated" and the switches.
    exclusions : (P, 2) int, pairs of atoms on which the law does not act, whatever bonded_scale says; their nearest
        images, too.

    Raises
    ------
    ValueError : for a cutoff that is not positive, an unknown truncation or mixing rule, factors or parameters that are
        not finite, pairs without a mapping from species, a switch that does not start inside the cutoff.
    TypeError : for a law that is not a function.
    """

    def __init__(
        self,
        law: Callable | tuple,
        parameters: Parameters | ByLabel = (),
        cutoff: float | Mapping[tuple[Label, Label], float] | None = None,
        truncation: TruncationName = "shifted",
        *,
        mixing: MixingName | Callable[[Parameters, Parameters], Parameters] | None = None,
        pairs: ByPairOfLabels | None = None,
        switch_start: float | None = None,
        bonded_scale: Sequence[float] = UNSCALED,
        tail_correction: bool = False,
        exclusions: ArrayLike | None = None,
    ) -> None:
        self.plain_law = checked_law(law)
        self._is_tried = not isinstance(self.plain_law, UserLaw)
        self._cutoffs = _checked_cutoffs(cutoff)
        self.cutoff = max(self._cutoffs.values())
        self.truncation = checked_choice("truncation", truncation, TRUNCATIONS)
        self.law = TRUNCATIONS[truncation].around(self.plain_law)
        self.mixing = mixing if callable(mixing) or mixing is None else MIXING[checked_choice("mixing", mixing, MIXING)]
        self.parameters, self.pairs = self._checked_parameters(parameters, pairs)
        self.switch_start = self._checked_switch_start(switch_start)
        self.bonded_scale, self.exclusions = _checked_factors(bonded_scale), checked_pairs("exclusions", exclusions)
        self.tail_correction = checked_flag("tail_correction", tail_correction)
        if tail_correction and (truncation not in ("truncated", *SWITCHES) or self.cutoff == inf):
            needed = f"a cutoff and truncation 'truncated', {listed(SWITCHES)}"
            given = f"cutoff = {self.cutoff}, truncation = {truncation!r}"
            raise ValueError(f"tail_correction needs {needed}; there is no tail with {given}")

    def bind(self, system: System) -> PairTerm:
        """The term of this potential in a system.  Raises ValueError as table; for a periodic cell without a cutoff,
        an open one with a tail correction, or pairs of species that are neither in the parameters nor in the system."""
        if self.cutoff == inf and system.cell.is_periodic:
            raise ValueError(f"cutoff must be given in a periodic cell; that of {type(self).__name__} is None")
        own = self.parameters if isinstance(self.parameters, dict) else {}
        known = [*own, *(name for name in system.species_names if name not in own)]
        for name in (name for pair in self.pairs if self.parameters for name in pair):
            if name not in known:
                wanted = f"of known species, {listed(known)}; they name {name!r}{near(name, known)}"
                raise ValueError(f"pairs of {type(self).__name__} must be {wanted}")
        if self.tail_correction:
            _volume(system)
        return PairTerm(self, system)

    def table(self, species_names: Sequence[Label]) -> NDArray[np.float64]:
        """Numbers of the truncated law for each pair of species: (S, S, 1 + P), the squared cutoff first; S is 1 if all
        atoms are alike. Raises ValueError for a species, or an unlike pair, without parameters or a mixing rule."""
        names = species_names if self.depends_on_species else (None,)
        return np.array([[self._numbers(a, b) for b in names] for a in names], dtype=np.float64)

    @property
    def shortest_length(self) -> float:
        """The smallest cutoff, with which rounding errors of separations are compared [length]; inf without one."""
        return min(self._cutoffs.values())

    @property
    def depends_on_species(self) -> bool:
        """False if one tuple of parameters and one cutoff serve all pairs."""
        return isinstance(self.parameters, dict) or None not in self._cutoffs

    def law_arguments(self) -> dict[str, Any]:
        """The arguments that belong to the law, by name, for display."""
        return {"law": type(self.plain_law).python, "parameters": self.parameters}

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        mixing = next((name for name, rule in MIXING.items() if rule is self.mixing), self.mixing)
        number = None if self.cutoff == inf else self.cutoff
        cutoff = number if None in self._cutoffs else _one_order(self._cutoffs)
        told = {"cutoff": cutoff, "truncation": self.truncation, "mixing": mixing}
        told |= {"pairs": _one_order(self.pairs) or None, "switch_start": self.switch_start}
        told |= {"bonded_scale": self.bonded_scale, "tail_correction": self.tail_correction}
        told |= {"exclusions": self.exclusions if len(self.exclusions) else None}
        taken = signature(type(self)).parameters
        return self.law_arguments() | {name: value for name, value in told.items() if name in taken}

    def pair_energy(self, r: ArrayLike, first: Label | None = None, second: Label | None = None) -> NDArray[np.float64]:
        """u [energy] of two atoms of given species at distances r > 0 [length], truncation included;
        an array of r's shape. Raises ValueError for distances that are not positive, and as table."""
        cutoff2, *numbers = self._numbers(first, second)
        distances = checked_numbers("r", r, "positive distances")
        if not (distances > 0.0).all():
            raise ValueError(f"r must be positive distances; r = {shown(r)}")
        law, every = self.law, distances.ravel().tolist()
        inside = [law_at(law, x, tuple(numbers))[0] if x * x < cutoff2 else 0.0 for x in every]
        return np.array(inside).reshape(distances.shape)

    def tail(self, counts: NDArray[np.int64], species_names: Sequence[Label], volume: float) -> tuple[float, float]:
        """Energy and trace of the virial of what the truncation left out, for g(r) = 1 [energy].

            U = 2π/V Σ_ab N_a N_b ∫ (u − u_truncated) r² dr,   tr W = 2π/V Σ_ab N_a N_b ∫ (f − f_truncated) r⁴ dr

        counts : (S,) atoms of each species.  M. P. Allen, D. J. Tildesley (2017), eq. 2.144.
        """
        crowds = [*zip(species_names, counts, strict=True)] if self.depends_on_species else [(None, counts.sum())]
        terms = [2.0 * pi * n_a * n_b / volume * self._tail_integrals(a, b) for a, n_a in crowds for b, n_b in crowds]
        return float(sum(u for u, _ in terms)), float(sum(w for _, w in terms))

    def _numbers(self, a: Any, b: Any) -> tuple[float, ...]:
        """The squared cutoff, and the numbers of the truncated law, of a pair of species."""
        if (cutoff := self._cutoffs.get((a, b), self._cutoffs.get(None))) is None:
            pair = f"the pair of species {a!r}, {b!r}"
            raise ValueError(f"cutoff has no entry for {pair}; it has {listed(self._cutoffs)}")
        parameters = self._parameters_of(a, b)
        if not self._is_tried:
            check_user_law(self.plain_law, parameters, [x * (cutoff if isfinite(cutoff) else 1.0) for x in TRIED_AT])
            self._is_tried = True
        extra = TRUNCATIONS[self.truncation].numbers(self.plain_law, parameters, cutoff, self._switch_start_for(cutoff))
        if not all(map(isfinite, extra)) and self.truncation not in SWITCHES:
            hint = "a cutoff" if cutoff == inf else f"another cutoff than {cutoff:g}"
            where = f"at the cutoff, where it is {self.truncation}; it is {extra[0]}"
            raise ValueError(f"the law must be finite {where}: give {hint}, or 'truncated'")
        return (cutoff * cutoff, *extra, *parameters)

    def _parameters_of(self, a: Any, b: Any) -> Parameters:
        if not isinstance(self.parameters, dict):
            return self.parameters
        if (a, b) in self.pairs:
            return self.pairs[a, b]
        own, lacking = self.parameters, f"{type(self).__name__} has no parameters for"
        for name in (a, b):
            if name not in own:
                raise ValueError(f"{lacking} species {name!r}; it has {listed(own)}")
        if a == b:
            return own[a]
        if self.mixing is None:
            raise ValueError(f"{lacking} the pair {a!r}, {b!r}; give them in pairs, or a mixing rule")
        mixed, reverse = (self._checked_numbers(self.mixing(own[x], own[y]), (x, y)) for x, y in ((a, b), (b, a)))
        is_same = all(map(partial(isclose, rel_tol=MIXED), mixed, reverse))
        if not (len(mixed) == len(reverse) == len(own[a]) and is_same):
            wanted = f"all parameters, the same for {a!r}, {b!r} as for {b!r}, {a!r}"
            raise ValueError(f"mixing must give {wanted}; it gives {mixed} and {reverse}")
        return mixed

    def _checked_parameters(self, given: Any, pairs: Any) -> tuple[Parameters | dict[Label, Parameters], dict]:
        """Parameters of all atoms or of each species, and those of pairs in both orders."""
        if not isinstance(given, Mapping):
            if pairs is not None and len(pairs):
                wanted = f"need parameters that are a mapping from species; parameters = {shown(given)}"
                raise ValueError(f"pairs of {type(self).__name__} {wanted}")
            return self._checked_numbers(given, None), {}
        by_label = {label: self._checked_numbers(numbers, label) for label, numbers in given.items()}
        both_orders = _symmetric("pairs", {} if pairs is None else pairs)
        by_pair = {pair: self._checked_numbers(numbers, pair) for pair, numbers in both_orders.items()}
        if len({len(numbers) for numbers in (*by_label.values(), *by_pair.values())}) > 1:
            told = shown(by_label | by_pair)
            raise ValueError(f"all species and pairs must have the same number of parameters; they are {told}")
        return by_label, by_pair

    def _checked_numbers(self, numbers: Any, of: Any) -> Parameters:
        """Parameters of one law.  of : a species, a pair; None for all.  Raises ValueError unless they are finite."""
        values = checked_numbers("parameters", numbers, "a tuple of finite numbers")
        if values.ndim != 1 or not np.isfinite(values).all():
            whose = "of all atoms" if of is None else f"of {of!r}"
            raise ValueError(f"parameters must be a tuple of finite numbers; those {whose} are {shown(numbers)}")
        return tuple(values.tolist())

    def _tail_integrals(self, a: Label | None, b: Label | None) -> NDArray[np.float64]:
        """∫ (u − u_truncated) r² dr and ∫ (f − f_truncated) r⁴ dr, from the beginning of the truncation to infinity.
        Raises ValueError if they do not converge."""
        from scipy.integrate import quad  # here, so that importing minimd need not load it

        cutoff2, *numbers = self._numbers(a, b)
        cutoff, parameters = cutoff2**0.5, self._parameters_of(a, b)

        def left_out(k: int, x: float) -> float:
            r = x * cutoff
            inside = evaluate_law(self.law, r * r, tuple(numbers))[k] if x < 1.0 else 0.0
            return cutoff * (evaluate_law(self.plain_law, r * r, parameters)[k] - inside) * r ** (2 + 2 * k)

        def integral(k: int, low: float, high: float) -> float:
            value, error = quad(partial(left_out, k), low, high, epsabs=0.0, epsrel=ACCURACY, full_output=1)[:2]
            if not error <= CONVERGED * abs(value):
                told = f"its integral is {value:.3g} ± {error:.1g}"
                raise ValueError(f"tail_correction needs a law that falls off faster than 1/r³; {told}")
            return value

        switched = [] if self.truncation == "truncated" else [(self._switch_start_for(cutoff) / cutoff, 1.0)]
        return np.array([sum(integral(k, *limits) for limits in [*switched, (1.0, inf)]) for k in (0, 1)])

    def _switch_start_for(self, cutoff: float) -> float:
        return SWITCH_FROM * cutoff if self.switch_start is None else self.switch_start

    def _checked_switch_start(self, start: float | None) -> float | None:
        if self.cutoff == inf and self.truncation not in ("truncated", "shifted"):
            raise ValueError(f"cutoff must be given for truncation {self.truncation!r}; it is None")
        if start is None:
            return None
        if self.truncation not in SWITCHES:
            raise ValueError(f"switch_start is for truncation {listed(SWITCHES)}; truncation = {self.truncation!r}")
        if not 0.0 < checked_number("switch_start", start) < self.shortest_length:
            limits = f"0 and the cutoff {self.shortest_length}"
            raise ValueError(f"switch_start must lie between {limits}; switch_start = {start}")
        return float(start)


class PairTerm(OwnTerm):
    """A pair potential in a system: a law for the planner to run on a list of neighbors, and its tail."""

    def __init__(self, potential: PairPotential, system: System) -> None:
        table = potential.table(system.species_names)
        name, cutoff = type(potential).__name__, potential.cutoff
        left_out = checked_pairs("exclusions", potential.exclusions, len(system))
        self.pair_law = PairLaw(name, potential.law, table, cutoff, potential.bonded_scale, exclusions=left_out)
        self.cutoff, self.shortest_length, self._potential = cutoff, potential.shortest_length, potential
        self._species = np.bincount(system.species_index, minlength=len(system.species_names)), system.species_names
        if potential.bonded_scale != UNSCALED and not len(system.bonds):
            self.warning = no_bonds(f"bonded_scale of {potential!r}")

    @cached_property
    def _tail_times_volume(self) -> tuple[float, float]:
        return self._potential.tail(*self._species, volume=1.0)

    def tail(self, system: System) -> tuple[float, float]:
        """See Term. Raises ValueError if the cell has no volume."""
        if not self._potential.tail_correction:
            return 0.0, 0.0
        volume, (energy, virial) = _volume(system), self._tail_times_volume
        return energy / volume, virial / volume


def _volume(system: System) -> float:
    if system.volume is None:
        raise ValueError("tail_correction needs a density: a cell that is periodic in all three directions")
    return system.volume


def _checked_cutoffs(cutoff: Any) -> dict[Any, float]:
    """The cutoffs of pairs of species, in both orders; or of all pairs, infinite if none is given, under None."""
    if not isinstance(cutoff, Mapping):
        return {None: inf if cutoff is None else checked_number("cutoff", cutoff, "positive and finite")}
    if not cutoff:
        raise ValueError("cutoff must be a number, or a mapping with an entry for each pair of species; it is empty")
    checked = {pair: checked_number(f"cutoff of {pair!r}", one, "positive and finite") for pair, one in cutoff.items()}
    return _symmetric("cutoff", checked)


def _symmetric(name: str, by_pair: Any) -> dict:
    """The same mapping with each pair of species in both orders."""
    if not isinstance(by_pair, Mapping) or not all(isinstance(pair, tuple) and len(pair) == 2 for pair in by_pair):
        wanted = "a mapping from pairs of species, such as ('A', 'B')"
        raise ValueError(f"{name} must be {wanted}; {name} = {shown(by_pair)}")
    for (a, b), value in by_pair.items():
        if np.any(by_pair.get((b, a), value) != value):
            raise ValueError(f"the pair {a!r}, {b!r} must be given once; it has {value} and {by_pair[b, a]}")
    return {key: value for (a, b), value in by_pair.items() for key in ((a, b), (b, a))}


def _one_order(by_pair: Mapping[tuple[Label, Label], Any]) -> dict[tuple[Label, Label], Any]:
    """A symmetric mapping reduced to one entry for each pair of species, the one that came first."""
    return {pair: value for k, (pair, value) in enumerate(by_pair.items()) if pair[::-1] not in [*by_pair][:k]}


def curvature_at_minimum(epsilon: Any, sigma: Any) -> Any:
    """u″ of the Lennard-Jones law at its minimum, r = 2^(1/6) σ: 72 ε / (2^(1/3) σ²) [energy/length²]; or arrays."""
    return 72.0 * epsilon / (2.0 ** (1.0 / 3.0) * sigma * sigma)


class LennardJones(PairPotential):
    """Lennard-Jones 12-6 potential u(r) = 4ε [(σ/r)¹² − (σ/r)⁶].

    Parameters
    ----------
    epsilon : ε, depth of the well [energy]; or a mapping from species to (ε, σ), and no sigma.
    sigma : σ, distance where u = 0 [length].
    cutoff, truncation, pairs, switch_start, bonded_scale, tail_correction, exclusions : as for PairPotential.
    mixing : "lorentz-berthelot" (default), "geometric", or a function of two (ε, σ), for unlike pairs not in pairs.

    Raises
    ------
    ValueError : if ε is negative or σ not positive, and as PairPotential does.
    """

    def __init__(
        self,
        epsilon: float | Mapping[Label, tuple[float, float]],
        sigma: float | None = None,
        cutoff: float | Mapping[tuple[Label, Label], float] | None = None,
        truncation: TruncationName = "shifted",
        *,
        mixing: MixingName | Callable[[Parameters, Parameters], Parameters] | None = "lorentz-berthelot",
        pairs: ByPairOfLabels | None = None,
        switch_start: float | None = None,
        bonded_scale: Sequence[float] = UNSCALED,
        tail_correction: bool = False,
        exclusions: ArrayLike | None = None,
    ) -> None:
        if isinstance(epsilon, Mapping) == (sigma is not None):
            raise ValueError(
                "give LennardJones either epsilon and sigma, or one mapping from species to (epsilon, sigma)"
            )
        parameters: Any = epsilon if isinstance(epsilon, Mapping) else (epsilon, sigma)
        own = partial(super().__init__, LennardJonesLaw(), parameters, cutoff, truncation, mixing=mixing, pairs=pairs)
        own = partial(own, switch_start=switch_start, bonded_scale=bonded_scale)
        own(tail_correction=tail_correction, exclusions=exclusions)

    def law_arguments(self) -> dict[str, Any]:
        """See PairPotential."""
        if isinstance(self.parameters, dict):
            return {"epsilon": self.parameters}
        return dict(zip(("epsilon", "sigma"), self.parameters, strict=True))

    @property
    def shortest_length(self) -> float:
        """See PairPotential; without a cutoff the smallest σ [length]."""
        if self.cutoff < inf:
            return super().shortest_length
        parameters = self.parameters.values() if isinstance(self.parameters, dict) else [self.parameters]
        return min((sigma for _, sigma in (*parameters, *self.pairs.values())), default=inf)

    def _checked_numbers(self, numbers: Any, of: Any) -> Parameters:
        if not isinstance(numbers, Sequence | np.ndarray) or len(numbers) != 2:
            raise ValueError(f"Lennard-Jones parameters are (epsilon, sigma); those of {of!r} are {shown(numbers)}")
        whose = "" if of is None else f" of {of!r}"
        epsilon = checked_number(f"epsilon{whose}", numbers[0], "finite and not negative")
        return epsilon, checked_number(f"sigma{whose}", numbers[1], "positive and finite")


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
        law, reach = TabulatedLaw(_table(self.r, [*self.u.values()])), float(self.r[-1]) if cutoff is None else cutoff
        numbers: Any = {} if pairs else (0.0,)
        own = partial(super().__init__, law, numbers, reach, truncation, pairs=pairs or None)
        own(switch_start=switch_start, bonded_scale=bonded_scale)
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


def _checked_factors(bonded_scale: Any) -> tuple[float, ...]:
    """Factors for pairs one, two and three bonds apart.  Raises ValueError for anything but three finite numbers."""
    expected = "three finite factors, for pairs one, two and three bonds apart"
    factors = checked_numbers("bonded_scale", bonded_scale, expected)
    if factors.shape != (3,) or not np.isfinite(factors).all():
        raise ValueError(f"bonded_scale must be {expected}; it is {shown(bonded_scale)}")
    return tuple(factors.tolist())


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


def _table(r: NDArray[np.float64], energies: Sequence[NDArray[np.float64]]) -> Table:
    """The splines through energies, each (n,)."""
    from scipy.interpolate import make_interp_spline  # here, so that importing minimd need not load it

    splines, powers = [make_interp_spline(r, u, DEGREE) for u in energies], range(DEGREE, -1, -1)
    pieces = [[one.derivative(k)(r[:-1]) / factorial(k) if k else one(r[:-1]) for k in powers] for one in splines]
    return Table(r, np.ascontiguousarray(np.moveaxis(np.array(pieces), 1, -1)), (len(r) - 1) / float(r[-1] - r[0]))
