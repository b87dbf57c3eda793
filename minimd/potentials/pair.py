"""Pair potentials: a law, its parameters for each pair of species, a cutoff and a truncation."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import inf, isfinite, pi
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.potentials.law import UserLaw, check_user_law, evaluate_law, user_law
from minimd.potentials.mixing import MIXING, Parameters
from minimd.potentials.truncation import SWITCHES, TRUNCATIONS

SWITCH_FROM = 0.8  # default start of switching, in units of the cutoff
HUGE = 1e75  # [length]: no scene is so large
NODES = (64, 32)  # of two Gauss-Legendre rules; where they differ by more than this, relatively, an integral does not exist
CONVERGED = 1e-8
TRIED_AT = (0.47, 0.71, 0.93)  # of the cutoff: where laws of the user's are tried

Label = str | int
ByLabel = Mapping[Label, Parameters]
ByPairOfLabels = Mapping[tuple[Label, Label], Parameters]


class PairPotential:
    """A law u(r) between all pairs of atoms closer than a cutoff.

    Parameters
    ----------
    law : function law(r2, *parameters) of the squared distance [length²] that returns u [energy] and −u′(r)/r
        [energy/length²]; plain Python of numbers, or already compiled by numba.njit.
    parameters : tuple of numbers for all atoms alike, or a mapping from species to such tuples.
    cutoff : r_c [length], or a mapping from pairs of species to it; None for none, in scenes without periodicity only.
    truncation : "shifted" (default), "truncated", "force-shifted", or a switch, "switched", "charmm" or "smooth" (for
        methods of order above 2): see minimd.potentials.truncation.
    mixing : name of a rule or a function of two parameter tuples, for pairs of species not in pairs.
    pairs : mapping from pairs of species, in either order, to their parameters.
    switch_start : r_on [length] of the switches; 0.8 r_c if not given.
    bonded_scale : factors for pairs one, two and three bonds apart; 0 excludes, 1 (default) changes nothing. In a cell
        smaller than the cutoff they hold for the nearest image of the pair only.
    tail_correction : add the energy and virial of the pairs that the truncation leaves out, at uniform density
        (g = 1). For "truncated" and the switches.

    Raises
    ------
    ValueError : for a cutoff that is not positive, an unknown truncation or mixing rule, factors or parameters that are
        not finite, a switch that does not start inside the cutoff. TypeError : for a law that is not a function.
    """

    def __init__(
        self,
        law: Callable | tuple,
        parameters: Parameters | ByLabel = (),
        cutoff: float | Mapping[tuple[Label, Label], float] | None = None,
        truncation: str = "shifted",
        *,
        mixing: str | Callable[[Parameters, Parameters], Parameters] | None = None,
        pairs: ByPairOfLabels | None = None,
        switch_start: float | None = None,
        bonded_scale: Sequence[float] = (1.0, 1.0, 1.0),
        tail_correction: bool = False,
    ) -> None:
        self.plain_law = law if isinstance(law, tuple) else user_law(law)
        self.parameters = _checked_parameters(parameters)
        self._cutoffs = _symmetric(cutoff) if isinstance(cutoff, Mapping) else cutoff
        self.cutoff = _checked_cutoff(cutoff)
        self.truncation = _choice("truncation", truncation, TRUNCATIONS)
        self.law = TRUNCATIONS[truncation].around(self.plain_law)
        self.mixing = mixing if callable(mixing) or mixing is None else MIXING[_choice("mixing", mixing, MIXING)]
        self.pairs = _symmetric(pairs or {})
        self.switch_start = self._checked_switch_start(switch_start)
        self.bonded_scale = _checked_scale(bonded_scale)
        self.tail_correction = tail_correction
        if tail_correction and (truncation not in ("truncated", *SWITCHES) or self.cutoff == inf):
            raise ValueError(
                f"tail_correction needs a cutoff and truncation 'truncated', {_listed(SWITCHES)}; "
                f"cutoff = {self.cutoff}, truncation = {truncation!r} have no tail"
            )

    def table(self, species_names: Sequence[Label]) -> NDArray[np.float64]:
        """Numbers of the truncated law for each pair of species: (S, S, 1 + P), the squared cutoff first.

        S is 1 if all atoms are alike to this potential.

        Raises
        ------
        ValueError : if a species has no parameters, or an unlike pair neither its own nor a mixing rule.
        """
        names = tuple(species_names) if self.depends_on_species else (None,)
        return np.array([[self._numbers(a, b) for b in names] for a in names], dtype=np.float64)

    @property
    def depends_on_species(self) -> bool:
        """False if one tuple of parameters and one cutoff serve all pairs."""
        return isinstance(self.parameters, dict) or isinstance(self._cutoffs, dict)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.parameters}, cutoff={self._cutoffs}, truncation={self.truncation!r})"

    def pair_energy(self, r: ArrayLike, first: Label | None = None, second: Label | None = None) -> NDArray[np.float64]:
        """u [energy] of two atoms of given species at distances r [length], truncation included; an array of r's shape."""
        cutoff2, *numbers = self._numbers(first, second)
        distances = np.asarray(r, dtype=np.float64)
        inside = [evaluate_law(self.law, x * x, tuple(numbers))[0] if x * x < cutoff2 else 0.0 for x in distances.ravel().tolist()]
        return np.array(inside).reshape(distances.shape)

    def tail(self, counts: NDArray[np.int64], species_names: Sequence[Label], volume: float) -> tuple[float, float]:
        """Energy and trace of the virial of what the truncation left out, for g(r) = 1 [energy].

            U = 2π/V Σ_ab N_a N_b ∫ (u − u_truncated) r² dr,   tr W = 2π/V Σ_ab N_a N_b ∫ (f − f_truncated) r⁴ dr

        counts : (S,) atoms of each species.  M. P. Allen, D. J. Tildesley (2017), eq. 2.144.
        """
        names = tuple(species_names) if self.depends_on_species else (None,)
        numbers = counts if self.depends_on_species else np.array([counts.sum()])
        energy = virial = 0.0
        for a, n_a in zip(names, numbers, strict=True):
            for b, n_b in zip(names, numbers, strict=True):
                u, w = 2.0 * pi * n_a * n_b / volume * self._tail_integrals(a, b)
                energy, virial = energy + u, virial + w
        return float(energy), float(virial)

    def _numbers(self, a: Label | None, b: Label | None) -> tuple[float, ...]:
        cutoff, parameters = self._cutoff_of(a, b), self._parameters_of(a, b)
        if isinstance(self.plain_law, UserLaw):
            check_user_law(self.plain_law, parameters, [x * (cutoff if isfinite(cutoff) else 1.0) for x in TRIED_AT])
        extra = TRUNCATIONS[self.truncation].numbers(self.plain_law, parameters, cutoff, self._switch_start_for(cutoff))
        return (cutoff * cutoff, *extra, *parameters)

    def _cutoff_of(self, a: Any, b: Any) -> float:
        if not isinstance(self._cutoffs, dict):
            return self.cutoff
        if (a, b) not in self._cutoffs:
            raise ValueError(f"cutoff has no entry for the pair of species {a!r}, {b!r}; it has {_listed(self._cutoffs)}")
        return self._cutoffs[a, b]

    def _parameters_of(self, a: Any, b: Any) -> Parameters:
        if not isinstance(self.parameters, dict):
            return self.parameters
        for name in (a, b):
            if name not in self.parameters and (a, b) not in self.pairs:
                raise ValueError(f"{type(self).__name__} has no parameters for species {name!r}; it has {_listed(self.parameters)}")
        if (a, b) in self.pairs:
            return self.pairs[a, b]
        if a == b:
            return self.parameters[a]
        if self.mixing is None:
            raise ValueError(f"{type(self).__name__} has no parameters for the pair {a!r}, {b!r}; give them in pairs, or a mixing rule")
        return self.mixing(self.parameters[a], self.parameters[b])

    def _tail_integrals(self, a: Label | None, b: Label | None) -> NDArray[np.float64]:
        """∫ (u − u_truncated) r² dr and ∫ (f − f_truncated) r⁴ dr: beyond the cutoff with x = r_c/r, and where it is switched."""
        cutoff2, *numbers = self._numbers(a, b)
        cutoff, parameters = cutoff2**0.5, self._parameters_of(a, b)
        start = self._switch_start_for(cutoff)

        def beyond(x: float) -> tuple[float, float]:
            r = cutoff / x
            u, f = evaluate_law(self.plain_law, r * r, parameters)
            return u * cutoff**3 / x**4, f * r * r * cutoff**3 / x**4

        def switched(x: float) -> tuple[float, float]:
            r = start + x * (cutoff - start)
            u, f = evaluate_law(self.plain_law, r * r, parameters)
            u_cut, f_cut = evaluate_law(self.law, r * r, tuple(numbers))
            return (cutoff - start) * (u - u_cut) * r**2, (cutoff - start) * (f - f_cut) * r**4

        return _integral(beyond) + (0.0 if self.truncation == "truncated" else _integral(switched))

    def _switch_start_for(self, cutoff: float) -> float:
        return SWITCH_FROM * cutoff if self.switch_start is None else self.switch_start

    def _checked_switch_start(self, start: float | None) -> float | None:
        if self.cutoff == inf and self.truncation not in ("truncated", "shifted"):
            raise ValueError(f"cutoff must be given for truncation {self.truncation!r}; it is None")
        smallest = min(self._cutoffs.values()) if isinstance(self._cutoffs, dict) else self.cutoff
        if start is not None and self.truncation not in SWITCHES:
            raise ValueError(f"switch_start is for truncation {_listed(SWITCHES)}; truncation = {self.truncation!r}")
        if start is not None and not 0.0 < start < smallest:
            raise ValueError(f"switch_start must lie between 0 and the cutoff {smallest}; switch_start = {start}")
        return start


def _integral(function: Callable[[float], tuple[float, float]]) -> NDArray[np.float64]:
    """∫₀¹ of a function with two values, (2,).

    Raises
    ------
    ValueError : if two rules disagree, as they do where the integral does not exist.
    """
    finer, coarser = (_gauss_legendre(function, n) for n in NODES)
    if not np.all(np.abs(finer - coarser) <= CONVERGED * np.abs(finer)):
        raise ValueError(f"tail_correction needs a law that falls off faster than 1/r³; its integral is {coarser[0]:.3g} or {finer[0]:.3g}")
    return finer


def _gauss_legendre(function: Callable[[float], tuple[float, float]], n: int) -> NDArray[np.float64]:
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return 0.5 * weights @ np.array([function(0.5 * (x + 1.0)) for x in nodes])


def _checked_parameters(parameters: Parameters | ByLabel) -> Parameters | dict[Label, Parameters]:
    if isinstance(parameters, Mapping):
        return {label: _checked_tuple(numbers) for label, numbers in parameters.items()}
    return _checked_tuple(parameters)


def _checked_tuple(numbers: Parameters) -> Parameters:
    values = tuple(float(number) for number in numbers)
    if not all(isfinite(value) for value in values):
        raise ValueError(f"parameters must be finite; they are {values}")
    return values


def _checked_cutoff(cutoff: float | Mapping[tuple[Label, Label], float] | None) -> float:
    """The largest cutoff; infinite for None."""
    if cutoff is None:
        return inf
    values = list(cutoff.values()) if isinstance(cutoff, Mapping) else [cutoff]
    for value in values:
        if not (isinstance(value, Real) and 0.0 < value < HUGE):
            raise ValueError(f"cutoff must be positive and finite, below {HUGE:g}; cutoff = {value!r}; leave it out for none")
    return float(max(values))


def _checked_scale(bonded_scale: Sequence[float]) -> tuple[float, ...]:
    factors = tuple(float(factor) for factor in bonded_scale) if isinstance(bonded_scale, Iterable) else ()
    if len(factors) != 3 or not all(isfinite(factor) for factor in factors):
        raise ValueError(f"bonded_scale must be three finite factors, for pairs one, two and three bonds apart; it is {bonded_scale!r}")
    return factors


def _choice(name: str, value: str, allowed: Mapping) -> str:
    if value not in allowed:
        raise ValueError(f"{name} must be one of {_listed(allowed)}; {name} = {value!r}")
    return value


def _symmetric(by_pair: Mapping) -> dict:
    for (a, b), value in by_pair.items():
        if by_pair.get((b, a), value) != value:
            raise ValueError(f"the pair {a!r}, {b!r} must be given once; it has {value} and {by_pair[b, a]}")
    return {key: value for (a, b), value in by_pair.items() for key in ((a, b), (b, a))}


def _listed(keys: Iterable) -> str:
    return ", ".join(repr(key) for key in keys)
