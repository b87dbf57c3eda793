"""How a law is declared, once: a class whose fields are its parameters, each with its dimension and what it must be.

    class HarmonicBond(Bond):
        \"\"\"Harmonic bond u(r) = ½ k (r − r₀)².\"\"\"

        law, lammps = HarmonicLaw(), LammpsStyle("harmonic", lambda k, length: (0.5 * k, length))
        k: ArrayLike = declared(each, "u = k (r − length)²/2", "stiffness", NOT_NEGATIVE)
        length: ArrayLike = declared(each, "rest length", "length", NOT_NEGATIVE)
        pairs: ArrayLike | None = declared(groups, of=2, default=None)

From it follow the constructor and its checks, the sections Parameters and Raises of its docstring, repr, the section of
a scene file with its page (minimd.scene.force_sections), and the style of LAMMPS. The kinds of parameters are below.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from inspect import cleandoc
from math import inf, pi
from typing import Any, ClassVar, NamedTuple, dataclass_transform

import numpy as np

from minimd.core.console.display import refuse_unknown_arguments
from minimd.core.console.words import shown
from minimd.core.potentials.law import checked_law
from minimd.core.potentials.term import OwnPotential
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import checked_groups, checked_pairs
from minimd.core.structure.checks import (
    checked_choice,
    checked_count,
    checked_flag,
    checked_indices,
    checked_kind,
    checked_number,
    checked_numbers,
)
from minimd.core.structure.observables import SEEDS

FINITE = "finite"
NOT_NEGATIVE = "finite and not negative"
POSITIVE = "positive and finite"
WHOLE = "whole numbers"
ANGLE = "between 0 and pi (radians)"
SIGNED_ANGLE = "between -pi and pi (radians)"
PHASE = "between -2 pi and 2 pi (radians)"
DEMANDS: Mapping[str, Callable[[Array], Any]] = {  # of finite numbers
    FINITE: lambda _: True,
    NOT_NEGATIVE: lambda x: x >= 0.0,
    POSITIVE: lambda x: x > 0.0,
    WHOLE: lambda x: (x >= 0.0) & (np.rint(x) == x),
    ANGLE: lambda x: (x >= 0.0) & (x <= pi),
    SIGNED_ANGLE: lambda x: np.abs(x) <= pi,
    PHASE: lambda x: np.abs(x) <= 2.0 * pi,
}
UNITS = {  # by dimension
    "energy": "energy", "length": "length", "time": "time", "force": "energy/length", "angle": "rad",
    "stiffness": "energy/length²", "angular stiffness": "energy/rad²", "inverse length": "1/length",
    "velocity": "length/time", "acceleration": "length/time²",
    "cubic stiffness": "energy/length³", "quartic stiffness": "energy/length⁴",
}  # fmt: skip
RAISES = "ValueError, TypeError : for numbers that are not finite or out of range, and for other shapes or kinds."
MOST_COEFFICIENTS = 6  # of the polynomial of Ryckaert and Bellemans


class Kind(NamedTuple):
    """What an argument may be.
    words : for its docstring and messages, {of} is that of its Parameter.
    check : (name, value, Parameter) → the value that is kept; raises ValueError or TypeError."""

    words: str
    check: Callable[[str, Any, Parameter], Any]


class Parameter(NamedTuple):
    """What is declared of an argument.
    words : what it is.
    dimension : a key of UNITS.
    demand : one of DEMANDS.
    of : atoms in a group, names to choose from, or, of a number, its default, which may be none."""

    kind: Kind
    words: str = ""
    dimension: str = ""
    demand: str = FINITE
    of: Any = None

    def told(self, name: str) -> str:
        """A line of a docstring."""
        unit = UNITS.get(self.dimension, "")
        choices = self.of
        what = self.kind.words.format(
            of=" or ".join(map(repr, choices)) if isinstance(choices, Mapping) else choices
        )
        return f"{name} : {what}{unit and f' [{unit}]'}{self.words and '; '}{self.words}."


class LammpsStyle(NamedTuple):
    """The style of LAMMPS for a law.
    numbers : those of LAMMPS, from the parameters of the law."""

    name: str
    numbers: Callable[..., tuple[float, ...]] = lambda *same: same


def declared(
    kind: Kind,
    words: str = "",
    dimension: str = "",
    demand: str = FINITE,
    *,
    of: Any = None,
    default: Any = MISSING,
    kw_only: Any = MISSING,
    init: bool = True,
) -> Any:
    """A field of a Declared.  See Parameter."""
    parameter = Parameter(kind, words, dimension, demand, default if kind is number else of)
    return field(default=default, kw_only=kw_only, init=init, metadata={"parameter": parameter})


@dataclass_transform(field_specifiers=(declared,))
class Declared(OwnPotential):
    """Base class of potentials that are declared.
    lammps : None if LAMMPS has no such style."""

    lammps: ClassVar[LammpsStyle | None] = None

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        refuse_unknown_arguments(dataclass(eq=False, repr=False)(cls))
        lines = [parameter.told(name) for name, parameter in cls.parameters_of().items()]
        if lines:
            sections = ["", "Parameters", "----------", *lines, "", "Raises", "------", RAISES]
            cls.__doc__ = "\n".join([cleandoc(cls.__doc__ or ""), *sections])

    def __post_init__(self) -> None:
        for name, asked in self.parameters_of().items():
            setattr(self, name, asked.kind.check(name, getattr(self, name), asked))

    @classmethod
    def parameters_of(cls) -> dict[str, Parameter]:
        """What is declared of the arguments, by name."""
        own = (argument for argument in fields(cls) if argument.init)  # type: ignore[arg-type]
        in_order = sorted(own, key=lambda argument: bool(argument.kw_only))
        return {argument.name: argument.metadata["parameter"] for argument in in_order}

    @classmethod
    def kinds(cls) -> set[Kind]:
        """The kinds of its parameters."""
        return {parameter.kind for parameter in cls.parameters_of().values()}

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        values = {name: getattr(self, name) for name in self.parameters_of()}
        return {name: getattr(type(value), "python", value) for name, value in values.items()}

    def columns(self, things: str, n: int) -> tuple[Array, ...]:
        """The numbers of the law for each of n things, as contiguous (n,) arrays.
        Raises ValueError for an array of another length."""
        for name, array in self.numbers().items():
            if array.shape not in ((), (n,)):
                wanted = f"one number, or {n} numbers, one for each of the {things}"
                raise ValueError(f"{name} must be {wanted}; its shape is {array.shape}")
        # of one type, for kernels
        return tuple(np.array(np.broadcast_to(array, n)) for array in self.numbers().values())

    def numbers(self) -> dict[str, Array]:
        """The numbers of the law by name, each one for all, or one for each."""
        numbers = {
            name: getattr(self, name)
            for name, parameter in self.parameters_of().items()
            if parameter.kind is each
        }
        own: tuple[Array, ...] = getattr(self, "parameters", ())
        return numbers | {f"parameter {k}": values for k, values in enumerate(own)}


def checked_values(
    name: str, values: Any, words: str, fits: Callable[[tuple], bool], demand: str = FINITE
) -> Array:
    """Numbers of a shape that fits.
    words : what they must be.
    demand : one of DEMANDS.
    Raises ValueError for anything else."""
    array = checked_numbers(name, values, words)
    if not fits(array.shape):
        raise ValueError(
            f"{name} must be {words}; its shape is {array.shape}, {name} = {shown(values)}"
        )
    if not (np.isfinite(array) & DEMANDS[demand](array)).all():
        raise ValueError(f"{name} must be {demand}; {name} = {shown(array.tolist())}")
    return array


def shaped(
    words: str,
    fits: Callable[[tuple], bool],
    become: Callable[[str, Array], Any] = lambda _, same: same,
) -> Kind:
    """The kind of arrays with a shape that fits.
    become : makes what is kept, from the name and the array."""
    return Kind(
        words,
        lambda name, values, asked: become(
            name, checked_values(name, values, words, fits, asked.demand)
        ),
    )


def _unit(name: str, array: Array) -> Array:
    largest = float(np.abs(array).max())
    # no square leaves the range of floats
    length = largest * float(np.linalg.norm(array / largest)) if largest > 0.0 else 0.0
    if not 0.0 < length < inf:
        raise ValueError(
            f"{name} must not be zero, nor of infinite length; {name} = {array.tolist()}"
        )
    return array / length


def _downwards(_name: str, array: Array) -> Array:
    return array if array.ndim else np.array([0.0, 0.0, -float(array)])


def _of_atoms(shape: tuple) -> bool:
    return shape == (3,) or (len(shape) == 2 and shape[1] == 3)


def _is_square(shape: tuple) -> bool:
    return len(shape) in (2, 3) and 0 < shape[-1] == shape[-2]


def _several(_name: str, array: Array) -> Array:
    return array.reshape(-1, *array.shape[-2:])


def _coefficients(name: str, values: Any, asked: Parameter) -> tuple[Array, ...]:
    is_list = isinstance(values, list | tuple) or (
        isinstance(values, np.ndarray) and values.ndim > 0
    )
    if not (is_list and 0 < len(values) <= MOST_COEFFICIENTS):
        wanted = f"a list of 1 to {MOST_COEFFICIENTS} numbers, c0 to c5"
        raise ValueError(f"{name} must be {wanted}; {name} = {shown(values)}")
    filled = [*values, *[0.0] * (MOST_COEFFICIENTS - len(values))]
    return tuple(each.check(f"{name}[{k}]", value, asked) for k, value in enumerate(filled))


def _own_parameters(name: str, values: Any, asked: Parameter) -> tuple[Array, ...]:
    checked_kind(name, values, list | tuple, "a tuple with one entry for each parameter of the law")
    return tuple(each.check(f"parameter {k}", value, asked) for k, value in enumerate(values))


def _number(name: str, value: Any, asked: Parameter) -> float | None:
    is_default = isinstance(value, float | None) and value == asked.of
    return value if is_default else checked_number(name, value, asked.demand)


def _atoms(name: str, values: Any, _asked: Parameter) -> Indices | None:
    if values is None:
        return None
    atoms = checked_indices(name, values, "a list of atoms")
    if atoms.ndim != 1 or atoms.min(initial=0) < 0 or len(np.unique(atoms)) < len(atoms):
        raise ValueError(
            f"{name} must be a list of different atoms, from 0 on; {name} = {shown(atoms.tolist())}"
        )
    return atoms


def _groups(name: str, values: Any, asked: Parameter) -> Indices | None:
    if values is None:
        return None
    return checked_pairs(name, values) if asked.of == 2 else checked_groups(name, values, asked.of)


each = shaped("one number, or one for each", lambda shape: len(shape) < 2)
stiffness = shaped("one number, or three", ((), (3,)).__contains__)
vector = shaped("three numbers", (3,).__eq__)
direction = shaped("three numbers", (3,).__eq__, _unit)
vectors = shaped("three numbers, or three for each atom", _of_atoms)
points = shaped("three numbers, or three for each atom", _of_atoms)  # a scene file lists them
weight = shaped("one number, downwards along z, or three", ((), (3,)).__contains__, _downwards)
factors = shaped("three numbers", (3,).__eq__, lambda _, same: tuple(same.tolist()))
coefficients = Kind(
    "up to six, each one number for all or one for each; missing ones are 0", _coefficients
)
maps = shaped("a square, n × n, or several of one size", _is_square, _several)
own_law = Kind("a user's function, or a law type", lambda _name, law, _asked: checked_law(law))
own_parameters = Kind("a tuple, each entry one number for all or one for each", _own_parameters)
number = Kind("one number", _number)
pairs = Kind(
    "pairs of atoms", lambda name, value, _: None if value is None else checked_pairs(name, value)
)
seed = Kind(
    "int ≥ 0 of the noise, below 2¹²⁸", lambda name, value, _: checked_count(name, value, 0, SEEDS)
)
flag = Kind("True or False", lambda name, value, _: checked_flag(name, value))
given = Kind(  # its class checks it
    "{of}",
    lambda _name, value, _: (
        dict(value)
        if isinstance(value, Mapping)
        else value.item()
        if isinstance(value, np.generic)
        else value
    ),
)
choice = Kind("one of {of}", lambda name, value, asked: checked_choice(name, value, asked.of))
atoms = Kind("indices of different atoms; all if not given", _atoms)
quadruples = Kind("quadruples of atoms", lambda name, value, _: checked_groups(name, value, 4))
groups = Kind("groups of {of} atoms; those of the system if not given", _groups)
