"""Pair potentials: a law, its parameters for each pair of species, given or mixed, cutoff and truncation."""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY
from functools import cached_property, partial
from itertools import combinations
from math import inf, isclose, isfinite, pi, sqrt
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.display import Rows, as_text
from minimd.core.console.words import listed, near, shown
from minimd.core.potentials import declared as kind
from minimd.core.potentials.declared import NOT_NEGATIVE, POSITIVE, Declared, LammpsStyle, declared
from minimd.core.potentials.law import check_user_law, evaluate_law, is_user_law, law_at
from minimd.core.potentials.laws import LennardJonesLaw, MieLaw, SoftRepulsionLaw
from minimd.core.potentials.term import Embedding, OwnTerm, PairLaw, no_bonds
from minimd.core.potentials.truncation import SWITCHES, TRUNCATIONS, TruncationName
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import checked_pairs
from minimd.core.structure.checks import (
    checked_choice,
    checked_kind,
    checked_number,
    checked_numbers,
)
from minimd.core.structure.system import System

SWITCH_FROM = 0.8  # default start of switching, in units of the cutoff
# relative errors of tail integrals: the one requested, and the one above which an integral counts as divergent
ACCURACY = 1e-12
CONVERGED = 1e-8
TRIED_AT = (0.47, 0.71, 0.93)  # of the cutoff: where a user's laws are tried
UNSCALED = (1.0, 1.0, 1.0)
# relative difference between mixed parameters of a pair and of the reverse pair that rounding can explain
MIXED = 1e-9
MOST_SHOWN = 6  # species whose mixed parameters are displayed

Label = str | int
Parameters = tuple[float, ...]
ByLabel = Mapping[Label, Parameters]
ByPairOfLabels = Mapping[tuple[Label, Label], Parameters]
Cutoff = float | Mapping[tuple[Label, Label], float]
Rule = Callable[[Parameters, Parameters], Parameters]


def lorentz_berthelot(first: Parameters, second: Parameters) -> Parameters:
    """(ε, σ) of an unlike pair: ε = √(ε₁ ε₂), σ = (σ₁ + σ₂)/2.  H. A. Lorentz, Ann. Phys. 248, 127 (1881); D.
    Berthelot, C. R. 126, 1703 (1898)."""
    return sqrt(first[0] * second[0]), 0.5 * (first[1] + second[1])


def geometric(first: Parameters, second: Parameters) -> Parameters:
    """(ε, σ) of an unlike pair: ε = √(ε₁ ε₂), σ = √(σ₁ σ₂)."""
    return sqrt(first[0] * second[0]), sqrt(first[1] * second[1])


MixingName = Literal["lorentz-berthelot", "geometric"]  # the keys of MIXING
MIXING = {"lorentz-berthelot": lorentz_berthelot, "geometric": geometric}
# what arguments are, and what they do
FOR_PAIRS = "one number, or a mapping from pairs of species"
R_C = "r_c; none only in scenes without periodicity"
HEIGHTS = "one number, or a mapping from species to (A,)"
MIE_WELLS = "one number, or a mapping from species to (ε, σ, n, m) and no others"
WELLS = "one number, or a mapping from species to (ε, σ) and no sigma"
A_RULE = "'lorentz-berthelot', 'geometric', or a function of two tuples of parameters"
OF_PAIRS = (
    "a mapping from pairs of species, in either order, to their parameters, beside one from species"
)
OTHERS = "for pairs of species not in pairs"
SEE = "see minimd.core.potentials.truncation"
R_ON = "r_on of the switches; 0.8 r_c if not given"
FACTORS = "factors for pairs one, two and three bonds apart; 0 excludes, 1 changes nothing"
TAIL = "add energy and virial of what truncation leaves out, at uniform density (g = 1); for truncated and the switches"
LEFT_OUT = "on which the law does not act, whatever bonded_scale says; their nearest images, too"
# arguments of several classes
SIGMA = declared(kind.given, "where u = 0", "length", of="one number", default=None)
CUTOFF = declared(kind.given, R_C, "length", of=FOR_PAIRS, default=None)
TRUNCATION = declared(kind.choice, SEE, of=TRUNCATIONS, default="shifted")


class Nonbonded(Declared, metaclass=ABCMeta):
    """Base class of laws u(r) between all pairs of atoms closer than a cutoff.

    plain_law, law : law type, without and with the truncation.
    cutoff : the largest [length], infinite without one.
    alone : the parameters of the law, before those of the table, of two atoms that have no other neighbors.
    """

    alone: ClassVar[Parameters] = ()

    _: KW_ONLY
    mixing: MixingName | Rule | None = declared(kind.given, OTHERS, of=A_RULE, default=None)
    pairs: ByPairOfLabels | None = declared(kind.given, of=OF_PAIRS, default=None)
    switch_start: float | None = declared(kind.number, R_ON, "length", default=None)
    bonded_scale: Sequence[float] = declared(kind.factors, FACTORS, default=UNSCALED)
    tail_correction: bool = declared(kind.flag, TAIL, default=False)
    exclusions: ArrayLike | None = declared(kind.pairs, LEFT_OUT, default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.plain_law, parameters, by_pair = self.as_law()
        self._is_tried = not is_user_law(self.plain_law)
        # each class has a cutoff and a truncation, in their places among its arguments
        given: Any = self
        self.truncation: TruncationName = given.truncation
        self._given_cutoff = given.cutoff
        self._cutoffs = checked_cutoffs(self._given_cutoff)
        self.law: Any = self._truncated_law()
        self.cutoff: Any = max(self._cutoffs.values())
        if not callable(self.mixing) and self.mixing is not None:
            checked_choice("mixing", self.mixing, MIXING)
        own, self._by_pair = self._checked_parameters(parameters, by_pair)
        self.parameters: Any = own
        if not self._by_pair:
            self.pairs = None
        self._check_truncation()

    @abstractmethod
    def as_law(self) -> tuple[Any, Any, Any]:
        """The law type, the parameters of all atoms or by species, and those of pairs of species, not checked yet."""

    def _truncated_law(self) -> Any:
        """The law type with the truncation."""
        return TRUNCATIONS[self.truncation].around(self.plain_law)

    def embedding(self, species_names: Sequence[Label]) -> Embedding | None:
        """Of atoms of these species in the density of their neighbors, if the potential has one."""
        return None

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        own = {"law": type(self.plain_law).python, "cutoff": self._given_cutoff}
        return {name: own.get(name, value) for name, value in super().arguments().items()}

    def display_rows(self) -> Rows:
        """See Displayed. Pairs of at most MOST_SHOWN species follow with their mixed parameters, if they have some."""
        rows = super().display_rows()
        own = self.parameters if self.mixing and isinstance(self.parameters, dict) else ()
        for a, b in combinations(own, 2) if len(own) <= MOST_SHOWN else ():
            with suppress(Exception):  # errors of a user's rule are raised in a system
                if (a, b) not in self._by_pair:
                    rows.append((f"{a}-{b}", as_text(self._parameters_of(a, b))))
        return rows

    def bind(self, system: System) -> PairTerm:
        """The term of this potential in a system.
        Raises ValueError as table; for a periodic cell without a cutoff, an open one with a tail correction, or pairs
            of species that are neither in the parameters nor in the system."""
        if self.cutoff == inf and system.cell.is_periodic:
            raise ValueError(
                f"cutoff must be given in a periodic cell; that of {type(self).__name__} is None"
            )
        own = self.parameters if isinstance(self.parameters, dict) else {}
        known = own | dict.fromkeys(system.species_names)

        for pair in self._by_pair if own else ():
            for name in pair:
                if name not in known:
                    raise ValueError(
                        f"pairs of {type(self).__name__} must be of known species, {listed(known)}; "
                        f"they name {name!r}{near(name, known)}"
                    )
        if self.tail_correction and (system.volume is None or system.dimensions == 2):
            raise ValueError(
                "tail_correction needs a density: a cell that is periodic in all three directions, not a plane"
            )
        return PairTerm(self, system)

    def table(self, species_names: Sequence[Label]) -> Array:
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

    def pair_energy(
        self, r: ArrayLike, first: Label | None = None, second: Label | None = None
    ) -> Array:
        """u [energy] of two atoms of given species at distances r > 0 [length], truncation included;
        an array of r's shape. Raises ValueError for distances that are not positive, and as table."""
        for label in first, second:
            checked_kind("first, second", label, Label | None, "labels of species")
        cutoff2, *numbers = self._numbers(first, second)
        distances = checked_numbers("r", r, "positive distances")
        if not (distances > 0.0).all():
            raise ValueError(f"r must be positive distances; r = {shown(r)}")
        energies = [
            self._energy_at(x, tuple(numbers), first, second) if x * x < cutoff2 else 0.0
            for x in distances.ravel().tolist()
        ]
        return np.array(energies).reshape(distances.shape)

    def _energy_at(self, r: float, numbers: Parameters, first: Any, second: Any) -> float:
        """u [energy] of two atoms at a distance below the cutoff [length], of species with these numbers."""
        return law_at(self.law, r, (*self.alone, *numbers))[0]

    def tail(
        self, counts: Indices, species_names: Sequence[Label], volume: float
    ) -> tuple[float, float]:
        """Energy and trace of the virial of what the truncation left out, for g(r) = 1 [energy].

            U = 2π/V Σ_ab N_a N_b ∫ (u − u_truncated) r² dr,   tr W = 2π/V Σ_ab N_a N_b ∫ (f − f_truncated) r⁴ dr

        counts : (S,) atoms of each species.  M. P. Allen, D. J. Tildesley (2017), eq. 2.144.
        """
        crowds: list[tuple[Any, Any]] = [(None, counts.sum())]
        if self.depends_on_species:
            crowds = [*zip(species_names, counts, strict=True)]
        total = np.zeros(2)
        for a, n_a in crowds:
            for b, n_b in crowds:
                total += 2.0 * pi * n_a * n_b / volume * self._tail_integrals(a, b)
        energy, virial = total.tolist()
        return energy, virial

    def _numbers(self, a: Any, b: Any) -> tuple[float, ...]:
        """The squared cutoff, and the numbers of the truncated law, of a pair of species."""
        cutoff = self._cutoffs.get((a, b), self._cutoffs.get(None))
        if cutoff is None:
            raise ValueError(
                f"cutoff has no entry for the species {a!r}, {b!r}; it has {listed(self._cutoffs)}"
            )
        parameters = self._parameters_of(a, b)
        if not self._is_tried:
            length = cutoff if isfinite(cutoff) else 1.0
            self._try_laws(parameters, [x * length for x in TRIED_AT])
            self._is_tried = True
        return (cutoff * cutoff, *self._numbers_of_laws(parameters, cutoff))

    def _try_laws(self, parameters: Parameters, distances: Sequence[float]) -> None:
        """Raise TypeError or ValueError for a user's law that is none."""
        check_user_law(self.plain_law, parameters, distances)

    def _numbers_of_laws(self, parameters: Parameters, cutoff: float) -> Parameters:
        """The numbers of the truncated law."""
        return self._truncated(self.plain_law, parameters, cutoff)

    def _truncated(self, law: Any, parameters: Parameters, cutoff: float) -> Parameters:
        """Those of the truncation of a law, and its own."""
        extra = TRUNCATIONS[self.truncation].numbers(
            law, parameters, cutoff, self._switch_start_for(cutoff)
        )
        if not all(map(isfinite, extra)) and self.truncation not in SWITCHES:
            raise ValueError(
                f"the law is {extra[0]} at the cutoff {cutoff:g}, where it must be finite to be {self.truncation}: "
                "give another cutoff, or truncation='truncated'"
            )
        return (*extra, *parameters)

    def _parameters_of(self, a: Any, b: Any) -> Parameters:
        own = self.parameters
        if not isinstance(own, dict):
            return own
        if (a, b) in self._by_pair:
            return self._by_pair[a, b]
        if not own:
            raise ValueError(
                f"{type(self).__name__} has nothing for the pair {a!r}, {b!r}; it has {listed(self._by_pair)}"
            )

        for name in (a, b):
            if name not in own:
                raise ValueError(
                    f"{type(self).__name__} has no parameters for species {name!r}; it has {listed(own)}"
                )
        if a == b:
            return own[a]
        if self.mixing is None:
            raise ValueError(
                f"{type(self).__name__} has no parameters for the pair {a!r}, {b!r}; "
                "give pairs={...}, or a mixing rule"
            )
        mixed = self._checked_numbers(self.mixed(own[a], own[b]), (a, b))
        reverse = self._checked_numbers(self.mixed(own[b], own[a]), (b, a))
        is_complete = len(mixed) == len(reverse) == len(own[a])
        if not (is_complete and all(map(partial(isclose, rel_tol=MIXED), mixed, reverse))):
            raise ValueError(
                f"mixing must give all parameters, the same for ({a!r}, {b!r}) as for ({b!r}, {a!r}); "
                f"it gives {mixed} for the first and {reverse} for the second"
            )
        return mixed

    def mixed(self, first: Parameters, second: Parameters) -> Parameters:
        """The parameters of an unlike pair, by the mixing rule."""
        rule: Any = MIXING[self.mixing] if isinstance(self.mixing, str) else self.mixing
        return rule(first, second)

    def _checked_parameters(
        self, parameters: Any, pairs: Any
    ) -> tuple[Parameters | dict[Label, Parameters], dict]:
        """Parameters of all atoms or of each species, and those of pairs in both orders."""
        by_pair = _symmetric("pairs", {} if pairs is None else pairs)
        if not isinstance(parameters, Mapping):
            if by_pair:
                raise ValueError(
                    f"pairs of {type(self).__name__} need parameters that are a mapping from species; "
                    f"parameters = {shown(parameters)}"
                )
            return self._checked_numbers(parameters, None), {}
        own = {name: self._checked_numbers(numbers, name) for name, numbers in parameters.items()}
        by_pair = {pair: self._checked_numbers(numbers, pair) for pair, numbers in by_pair.items()}
        if len({len(numbers) for numbers in (*own.values(), *by_pair.values())}) > 1:
            raise ValueError(
                f"all species and pairs must have the same number of parameters; these are {shown(own | by_pair)}"
            )
        return own, by_pair

    def _checked_numbers(self, numbers: Any, of: Any) -> Parameters:
        """Parameters of one law.
        of : a species, a pair; None for all.
        Raises ValueError unless they are finite."""
        values = checked_numbers("parameters", numbers, "a tuple of finite numbers")
        if values.ndim != 1 or not np.isfinite(values).all():
            whose = "of all atoms" if of is None else f"of {of!r}"
            raise ValueError(
                f"parameters must be a tuple of finite numbers; those {whose} are {shown(numbers)}"
            )
        return tuple(values.tolist())

    def _tail_integrals(self, a: Label | None, b: Label | None) -> Array:
        """∫ (u − u_truncated) r² dr and ∫ (f − f_truncated) r⁴ dr, from the beginning of the truncation to infinity.
        Raises ValueError if they do not converge."""
        from scipy.integrate import quad  # here, so that importing minimd need not load it

        cutoff2, *numbers = self._numbers(a, b)
        cutoff = cutoff2**0.5
        parameters = self._parameters_of(a, b)
        limits = [(1.0, inf)]  # of x = r/r_c
        if self.truncation != "truncated":
            limits.insert(0, (self._switch_start_for(cutoff) / cutoff, 1.0))

        def left_out(x: float, k: int) -> float:
            r = x * cutoff
            difference = evaluate_law(self.plain_law, r * r, parameters)[k]
            if x < 1.0:
                difference -= evaluate_law(self.law, r * r, tuple(numbers))[k]
            return cutoff * difference * r ** (2 + 2 * k)

        integrals = np.zeros(2)
        for k in (0, 1):
            for low, high in limits:
                value, error = quad(
                    left_out, low, high, (k,), full_output=1, epsabs=0.0, epsrel=ACCURACY
                )[:2]
                if not error <= CONVERGED * abs(value):
                    raise ValueError(
                        "tail_correction needs a law that falls off faster than 1/r³; "
                        f"its integral is {value:.3g} ± {error:.1g}"
                    )
                integrals[k] += value

        return integrals

    def _switch_start_for(self, cutoff: float) -> float:
        return SWITCH_FROM * cutoff if self.switch_start is None else self.switch_start

    def _check_truncation(self) -> None:
        start = self.switch_start
        if self.cutoff == inf and self.truncation not in ("truncated", "shifted"):
            raise ValueError(f"cutoff must be given for truncation {self.truncation!r}; it is None")
        if start is not None:
            if self.truncation not in SWITCHES:
                raise ValueError(
                    f"switch_start is for truncation {listed(SWITCHES)}; truncation = {self.truncation!r}"
                )
            if not 0.0 < start < self.shortest_length:
                raise ValueError(
                    f"switch_start must lie between 0 and the cutoff {self.shortest_length}; switch_start = {start}"
                )
        has_tail = self.truncation in ("truncated", *SWITCHES) and self.cutoff < inf
        if self.tail_correction and not has_tail:
            raise ValueError(
                f"tail_correction needs a cutoff and truncation 'truncated', {listed(SWITCHES)}; "
                f"there is no tail with cutoff = {self.cutoff}, truncation = {self.truncation!r}"
            )


class PairPotential(Nonbonded):
    """A law u(r) between all pairs of atoms closer than a cutoff.

    law(r2, *parameters) of the squared distance [length²] returns u [energy] and −u′(r)/r [energy/length²]; it is plain
    Python with numbers, or already compiled by numba.njit. A scene without periodicity needs no cutoff. In a cell
    smaller than the cutoff, bonded_scale and exclusions hold for the nearest image of a pair only.
    """

    law: Callable | tuple = declared(kind.own_law, "law(r2, *parameters)")
    parameters: Parameters | ByLabel = declared(
        kind.given, of="a tuple, or a mapping from species to them", default=()
    )
    cutoff: Cutoff | None = CUTOFF
    truncation: TruncationName = TRUNCATION

    def as_law(self) -> tuple[Any, Any, Any]:
        """See Nonbonded."""
        return self.law, self.parameters, self.pairs


class PairTerm(OwnTerm):
    """A pair potential in a system: a law for the planner to run on a list of neighbors, and its tail."""

    def __init__(self, potential: Nonbonded, system: System) -> None:
        self.cutoff = potential.cutoff
        self.shortest_length = potential.shortest_length
        self.pair_law = PairLaw(
            type(potential).__name__,
            potential.law,
            potential.table(system.species_names),
            potential.cutoff,
            tuple(potential.bonded_scale),
            exclusions=checked_pairs("exclusions", potential.exclusions, len(system)),
            embedding=potential.embedding(system.species_names),
        )
        self._potential = potential
        self._names = system.species_names
        self._counts = np.bincount(system.species_index, minlength=len(self._names))
        if potential.bonded_scale != UNSCALED and not len(system.bonds):
            self.warning = no_bonds(f"bonded_scale of {potential!r}")

    @cached_property
    def _tail_times_volume(self) -> tuple[float, float]:
        return self._potential.tail(self._counts, self._names, volume=1.0)

    def tail(self, system: System) -> tuple[float, float]:
        """See Term."""
        if not self._potential.tail_correction or system.volume is None:
            return 0.0, 0.0
        energy, virial = self._tail_times_volume
        return energy / system.volume, virial / system.volume


def checked_cutoffs(cutoff: Any) -> dict[Any, float]:
    """The cutoffs of pairs of species, in both orders; or of all pairs, infinite if none is given, under None."""
    if cutoff is None:
        return {None: inf}
    if not isinstance(cutoff, Mapping):
        return {None: checked_number("cutoff", cutoff, "positive and finite")}
    if not cutoff:
        raise ValueError(
            "cutoff must be a number, or a mapping with an entry for each pair of species; it is empty"
        )
    checked = {
        pair: checked_number(f"cutoff of {pair!r}", length, "positive and finite")
        for pair, length in cutoff.items()
    }
    return _symmetric("cutoff", checked)


def _symmetric(name: str, by_pair: Any) -> dict:
    """The same mapping with each pair of species in both orders."""
    if not isinstance(by_pair, Mapping) or not all(
        isinstance(pair, tuple) and len(pair) == 2 for pair in by_pair
    ):
        raise ValueError(
            f"{name} must be a mapping from pairs of species, such as ('A', 'B'); {name} = {shown(by_pair)}"
        )
    both_orders = {}
    for (a, b), value in by_pair.items():
        if np.any(by_pair.get((b, a), value) != value):
            raise ValueError(
                f"the pair {a!r}, {b!r} must be given once; it has {value} and {by_pair[b, a]}"
            )
        both_orders[a, b] = value
        both_orders[b, a] = value
    return both_orders


def curvature_at_minimum(epsilon: Any, sigma: Any) -> Any:
    """u″ of the Lennard-Jones law at its minimum, r = 2^(1/6) σ: 72 ε / (2^(1/3) σ²) [energy/length²]; or arrays."""
    return 72.0 * epsilon / (2.0 ** (1.0 / 3.0) * sigma * sigma)


class Well(Nonbonded):
    """Base class of wells with numbers of their own: for all atoms, or a mapping from species in place of the first.

    well : law type.
    numbers_of_well : what each must be, by name, σ second.
    """

    well: ClassVar[Any]
    numbers_of_well: ClassVar[Mapping[str, str]] = {"epsilon": NOT_NEGATIVE, "sigma": POSITIVE}

    def as_law(self) -> tuple[Any, Any, Any]:
        """See Nonbonded."""
        first, *others = (getattr(self, name) for name in self.numbers_of_well)
        is_by_species = isinstance(first, Mapping)
        n_missing = sum(number is None for number in others)
        if n_missing != (len(others) if is_by_species else 0):
            names = ", ".join(self.numbers_of_well)
            raise ValueError(
                f"give {type(self).__name__} either all of {names}, or one mapping from species to ({names})"
            )
        return self.well, first if is_by_species else (first, *others), self.pairs

    @property
    def shortest_length(self) -> float:
        """See Nonbonded; without a cutoff the smallest σ [length]."""
        shortest = super().shortest_length
        if shortest < inf:
            return shortest
        own = self.parameters
        parameters = [*own.values()] if isinstance(own, dict) else [own]
        return min((sigma for _, sigma, *_ in (*parameters, *self._by_pair.values())), default=inf)

    def _checked_numbers(self, numbers: Any, of: Any) -> Parameters:
        demands = self.numbers_of_well
        if not isinstance(numbers, Sequence | np.ndarray) or len(numbers) != len(demands):
            raise ValueError(
                f"{type(self).__name__} parameters are ({', '.join(demands)}); those of {of!r} are {shown(numbers)}"
            )
        whose = "" if of is None else f" of {of!r}"
        named = zip(demands.items(), numbers, strict=True)
        return tuple(
            checked_number(f"{name}{whose}", value, demand) for (name, demand), value in named
        )


class LennardJones(Well):
    """Lennard-Jones 12-6 potential u(r) = 4ε [(σ/r)¹² − (σ/r)⁶]."""

    well = LennardJonesLaw()
    lammps = LammpsStyle("lj/cut")
    epsilon: float | Mapping[Label, tuple[float, float]] = declared(
        kind.given, "depth of the well", "energy", of=WELLS
    )
    sigma: float | None = SIGMA
    cutoff: Cutoff | None = CUTOFF
    truncation: TruncationName = TRUNCATION
    mixing: MixingName | Rule | None = declared(
        kind.given, OTHERS, of=A_RULE, default="lorentz-berthelot", kw_only=True
    )


class Mie(Well):
    """Mie potential u(r) = C ε [(σ/r)ⁿ − (σ/r)ᵐ], C = n/(n − m) (n/m)^(m/(n − m)), whose well is ε deep.

    n = 12, m = 6 is Lennard-Jones. The named mixing rules are for species with the same exponents; for others, mixing
    is a function of two tuples (ε, σ, n, m), or pairs has their numbers. LAMMPS' `pair_style mie/cut`.
    """

    well = MieLaw()
    numbers_of_well: ClassVar[Mapping[str, str]] = {
        **Well.numbers_of_well,
        "n": POSITIVE,
        "m": POSITIVE,
    }
    lammps = LammpsStyle("mie/cut")
    epsilon: float | Mapping[Label, tuple[float, float, float, float]] = declared(
        kind.given, "depth of the well", "energy", of=MIE_WELLS
    )
    sigma: float | None = SIGMA
    n: float | None = declared(kind.given, "exponent of repulsion", of="one number", default=None)
    m: float | None = declared(
        kind.given, "exponent of attraction, below n", of="one number", default=None
    )
    cutoff: Cutoff | None = CUTOFF
    truncation: TruncationName = TRUNCATION
    mixing: MixingName | Rule | None = declared(
        kind.given, OTHERS, of=A_RULE, default="lorentz-berthelot", kw_only=True
    )

    def mixed(self, first: Parameters, second: Parameters) -> Parameters:
        """See Nonbonded."""
        if not isinstance(self.mixing, str):
            return super().mixed(first, second)
        if first[2:] != second[2:]:
            raise ValueError(
                f"mixing {self.mixing!r} is for Mie potentials with the same n and m; these are {first[2:]} and "
                f"{second[2:]}: give pairs={{...}}, or a function"
            )
        return (*super().mixed(first, second), *first[2:])

    def _checked_numbers(self, numbers: Any, of: Any) -> Parameters:
        checked = super()._checked_numbers(numbers, of)
        if not checked[2] > checked[3]:
            raise ValueError(f"n must be larger than m; those of {of!r} are {checked[2:]}")
        return checked


class SoftRepulsion(Well):
    """Soft repulsion u(r) = A [1 + cos(πr/r_c)], which lets atoms pass through each other and pushes them apart.

    It is 2A high at r = 0, where it has no force, and goes to zero at r_c with its force. LAMMPS' `pair_style soft`.
    """

    well = SoftRepulsionLaw()
    numbers_of_well: ClassVar[Mapping[str, str]] = {"height": NOT_NEGATIVE}
    lammps = LammpsStyle("soft", lambda height, _reach: (height,))
    height: float | Mapping[Label, tuple[float]] = declared(
        kind.given, "A, half of u at r = 0", "energy", of=HEIGHTS
    )
    cutoff: Cutoff = declared(kind.given, "r_c, where u and force vanish", "length", of=FOR_PAIRS)
    truncation: TruncationName = declared(
        kind.choice, of=TRUNCATIONS, init=False, default="truncated"
    )

    def _numbers_of_laws(self, parameters: Parameters, cutoff: float) -> Parameters:
        return (*parameters, checked_number("cutoff", cutoff, "positive and finite"))


# for isinstance: constructors differ, so that none can inherit another
PairPotential.register(LennardJones)
PairPotential.register(Mie)
PairPotential.register(SoftRepulsion)
