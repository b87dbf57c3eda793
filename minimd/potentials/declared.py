"""How a law is declared, once: a class whose fields are its parameters, each with its dimension and what it must be.

    class HarmonicBond(Bond):
        \"\"\"Harmonic bond u(r) = ½ k (r − r₀)².\"\"\"

        law, lammps = HarmonicLaw(), LammpsStyle("harmonic", lambda k, length: (0.5 * k, length))
        k: ArrayLike = declared(each, "u = k (r − length)²/2", "stiffness", NOT_NEGATIVE)
        length: ArrayLike = declared(each, "at rest", "length", NOT_NEGATIVE)
        pairs: ArrayLike | None = declared(groups, of=2, default=None)

From it follow the constructor and its checks, the sections Parameters and Raises of its docstring, repr, the section of
a scene file with its page (minimd.document.force_sections), and the style of LAMMPS. The kinds of parameters are the
functions below: each returns the value that is kept, or raises ValueError.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from inspect import cleandoc
from math import inf, pi
from typing import Any, ClassVar, NamedTuple, dataclass_transform

import numpy as np
from numpy.typing import NDArray

from minimd.console.words import shown
from minimd.potentials.law import checked_law
from minimd.potentials.term import OwnPotential
from minimd.structure.bond_graph import checked_groups, checked_pairs
from minimd.structure.checks import checked_choice, checked_indices, checked_number, checked_numbers

Array = NDArray[np.float64]
FINITE, NOT_NEGATIVE, POSITIVE, WHOLE = "finite", "finite and not negative", "positive and finite", "whole numbers"
ANGLE, SIGNED_ANGLE = "between 0 and pi (radians)", "between -pi and pi (radians)"
DEMANDS: Mapping[str, Callable[[Array], Any]] = {  # of finite numbers
    FINITE: lambda _: True,
    NOT_NEGATIVE: lambda x: x >= 0.0,
    POSITIVE: lambda x: x > 0.0,
    WHOLE: lambda x: (x >= 0.0) & (np.rint(x) == x),
    ANGLE: lambda x: (x >= 0.0) & (x <= pi),
    SIGNED_ANGLE: lambda x: np.abs(x) <= pi,
}
UNITS = {  # by dimension
    "energy": "energy", "length": "length", "time": "time", "force": "energy/length", "angle": "rad",
    "stiffness": "energy/length²", "angular stiffness": "energy/rad²", "inverse length": "1/length",
    "velocity": "length/time", "acceleration": "length/time²",
}  # fmt: skip
RAISES = "ValueError, TypeError : for numbers that are not finite or out of range, and for other shapes or kinds."
MOST_COEFFICIENTS = 6  # of the polynomial of Ryckaert and Bellemans


class Parameter(NamedTuple):
    """What is declared of an argument.  kind : one of the functions below.  words : what it is.

    dimension : a key of UNITS.  demand : one of DEMANDS.  of : atoms in a group, names to choose from, or what stands
    for no number.
    """

    kind: Callable[[str, Any, Parameter], Any]
    words: str = ""
    dimension: str = ""
    demand: str = FINITE
    of: Any = None

    def told(self, name: str) -> str:
        """A line of a docstring."""
        unit, what = UNITS.get(self.dimension, ""), (self.kind.__doc__ or "").partition(".")[0]
        what = what.format(of=" or ".join(map(repr, self.of)) if isinstance(self.of, Mapping) else self.of)
        return f"{name} : {what[:1].lower()}{what[1:]}{unit and f' [{unit}]'}{self.words and '; '}{self.words}."


class LammpsStyle(NamedTuple):
    """The style of LAMMPS for a law.  numbers : those of LAMMPS, from the parameters of the law."""

    name: str
    numbers: Callable[..., tuple[float, ...]] = lambda *same: same


def declared(
    kind: Callable,
    words: str = "",
    dimension: str = "",
    demand: str = FINITE,
    *,
    of: Any = None,
    default: Any = MISSING,
    kw_only: bool = False,
) -> Any:
    """A field of a Declared.  See Parameter."""
    parameter = Parameter(kind, words, dimension, demand, of)
    return field(default=default, kw_only=kw_only, metadata={"parameter": parameter})


@dataclass_transform(field_specifiers=(declared,))
class Declared(OwnPotential):
    """Base class of potentials that are declared.  lammps : None if LAMMPS has no such style."""

    lammps: ClassVar[LammpsStyle | None] = None

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        dataclass(eq=False, repr=False)(cls)
        if told := [one.told(name) for name, one in cls.parameters_of().items()]:
            sections = ["", "Parameters", "----------", *told, "", "Raises", "------", RAISES]
            cls.__doc__ = "\n".join([cleandoc(cls.__doc__ or ""), *sections])

    def __post_init__(self) -> None:
        for name, asked in self.parameters_of().items():
            setattr(self, name, asked.kind(name, getattr(self, name), asked))

    @classmethod
    def parameters_of(cls) -> dict[str, Parameter]:
        """What is declared of the arguments, by name."""
        return {one.name: one.metadata["parameter"] for one in fields(cls)}  # type: ignore[arg-type]

    @classmethod
    def kinds(cls) -> set[Callable]:
        """The kinds of its parameters."""
        return {one.kind for one in cls.parameters_of().values()}

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        values = {name: getattr(self, name) for name in self.parameters_of()}
        return {name: getattr(type(value), "python", value) for name, value in values.items()}

    def columns(self, things: str, n: int) -> tuple[Array, ...]:
        """The numbers of the law for each of n things, as contiguous (n,) arrays.
        Raises ValueError for an array of another length."""
        for name, array in self.numbers().items():
            if array.shape not in ((), (n,)):
                wanted = f"one number or {n}, one for each of the {things}"
                raise ValueError(f"{name} must be {wanted}; its shape is {array.shape}")
        return tuple(np.array(np.broadcast_to(one, n)) for one in self.numbers().values())  # of one type, for kernels

    def numbers(self) -> dict[str, Array]:
        """The numbers of the law by name, each one for all, or one for each."""
        found = {name: getattr(self, name) for name, one in self.parameters_of().items() if one.kind is each}
        own: tuple[Array, ...] = getattr(self, "parameters", ())
        return found | {f"parameter {k}": values for k, values in enumerate(own)}


def checked_values(name: str, values: Any, words: str, fits: Callable[[tuple], bool], demand: str = FINITE) -> Array:
    """Numbers of a shape that fits.  words : what they must be.  demand : one of DEMANDS.
    Raises ValueError for anything else."""
    array = checked_numbers(name, values, words)
    if not fits(array.shape):
        raise ValueError(f"{name} must be {words}; its shape is {array.shape}")
    if not (np.isfinite(array) & DEMANDS[demand](array)).all():
        raise ValueError(f"{name} must be {demand}; {name} = {shown(array.tolist())}")
    return array


def each(name: str, values: Any, asked: Parameter) -> Array:
    """One number, or one for each."""
    return checked_values(name, values, "one number, or one for each", lambda shape: len(shape) < 2, asked.demand)


def vector(name: str, values: Any, _asked: Parameter) -> Array:
    """Three numbers."""
    return checked_values(name, values, "three numbers", (3,).__eq__)


def direction(name: str, values: Any, asked: Parameter) -> Array:
    """Three numbers.  Returns them with the length 1."""
    array = vector(name, values, asked)
    largest = float(np.abs(array).max())
    # no square leaves the range of floats
    length = largest * float(np.linalg.norm(array / largest)) if largest > 0.0 else 0.0
    if not 0.0 < length < inf:
        raise ValueError(f"{name} must not be zero, nor of infinite length; {name} = {array.tolist()}")
    return array / length


def vectors(name: str, values: Any, _asked: Parameter) -> Array:
    """Three numbers, or (n, 3)."""

    def fits(shape: tuple) -> bool:
        return shape == (3,) or (len(shape) == 2 and shape[1] == 3)

    return checked_values(name, values, "three numbers, or three for each atom", fits)


def points(name: str, values: Any, asked: Parameter) -> Array:
    """Three numbers, or (n, 3).  A scene file lists them."""
    return vectors(name, values, asked)


def weight(name: str, values: Any, _asked: Parameter) -> Array:
    """Three numbers, or one, downwards along z."""
    given = checked_values(name, values, "one number, downwards, or three", ((), (3,)).__contains__)
    return given if given.ndim else np.array([0.0, 0.0, -float(given)])


def stiffness(name: str, values: Any, asked: Parameter) -> Array:
    """One number, or three."""
    return checked_values(name, values, "one number, or three", ((), (3,)).__contains__, asked.demand)


def coefficients(name: str, values: Any, asked: Parameter) -> tuple[Array, ...]:
    """Up to six, each one number for all or one for each; missing ones are 0.  Raises TypeError for no list."""
    try:
        given = list(values)
    except TypeError:
        raise TypeError(f"{name} must be a list, c0 to c5 at most; {name} = {shown(values)}") from None
    if len(given) > MOST_COEFFICIENTS:
        raise ValueError(f"{name} must be at most {MOST_COEFFICIENTS}, c0 to c5; there are {len(given)}")
    given += [0.0] * (MOST_COEFFICIENTS - len(given))
    return tuple(each(f"c{k}", one, asked) for k, one in enumerate(given))


def own_law(_name: str, law: Any, _asked: Parameter) -> Any:
    """A user's function, or a law type.  Raises TypeError for anything else."""
    return checked_law(law)


def own_parameters(name: str, values: Any, asked: Parameter) -> tuple[Array, ...]:
    """A tuple, each entry one number for all or one for each.  Raises TypeError for no tuple or list."""
    if not isinstance(values, Sequence) or isinstance(values, str):
        wanted = "a tuple with one entry for each parameter of the law"
        raise TypeError(f"{name} must be {wanted}; {name} = {shown(values)}")
    return tuple(each(f"parameter {k}", one, asked) for k, one in enumerate(values))


def number(name: str, value: Any, asked: Parameter) -> float | None:
    """One number."""
    is_none = value is None or (isinstance(value, float) and value == inf)
    return value if is_none and value == asked.of else checked_number(name, value, asked.demand)


def choice(name: str, value: Any, asked: Parameter) -> str:
    """One of {of}."""
    return checked_choice(name, value, asked.of)


def atoms(name: str, values: Any, _asked: Parameter) -> NDArray[np.int64] | None:
    """Indices of different atoms; all if not given."""
    if values is None:
        return None
    found = checked_indices(name, values, "a list of atoms")
    if found.ndim != 1 or found.min(initial=0) < 0 or len(np.unique(found)) < len(found):
        raise ValueError(f"{name} must be a list of different atoms, from 0 on; {name} = {shown(found.tolist())}")
    return found


def groups(name: str, values: Any, asked: Parameter) -> NDArray[np.int64] | None:
    """Groups of {of} atoms; those of the system if not given.  Returns (G, n) int, or None."""
    if values is None:
        return None
    return checked_pairs(name, values) if asked.of == 2 else checked_groups(name, values, asked.of)
