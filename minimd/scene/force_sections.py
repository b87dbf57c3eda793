"""The sections of a scene file for declared laws: charges, bonds, angles, dihedrals, impropers, fields, springs, walls.

The type of a section is the name of the class, as harmonic-bond; its keys are the arguments. A length, an energy or
another quantity that is not zero by default must be given, since units differ between scenes.
"""

import functools
import operator
import re
from collections.abc import Iterator
from dataclasses import MISSING, fields
from importlib import import_module
from math import inf
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat, NonNegativeInt, create_model

from minimd import potentials
from minimd.core.console.lazy import places_of
from minimd.core.potentials import declared as law
from minimd.core.potentials.bonded import Bonded
from minimd.scene.section import (
    Atoms,
    Dimension,
    NotNegative,
    PairOfAtoms,
    Positive,
    Section,
    Vector,
)

NUMBERS = {
    law.NOT_NEGATIVE: NotNegative,
    law.POSITIVE: Positive,
    law.WHOLE: NonNegativeInt,
    law.ANGLE: NotNegative,
}
GROUPS: dict[int, Any] = {
    n: list[Annotated[list[int], Field(min_length=n, max_length=n)]] for n in (2, 3, 4)
}
KINDS: dict[Any, Any] = dict.fromkeys(
    (law.vector, law.vectors, law.weight, law.direction, law.factors), Vector
) | {
    law.points: Annotated[list[Vector], Field(min_length=1)],
    law.coefficients: Annotated[
        list[FiniteFloat], Field(min_length=1, max_length=law.MOST_COEFFICIENTS)
    ],
    law.atoms: Atoms,
    law.pairs: list[PairOfAtoms],
}


def key(one: Any, made: type[law.Declared]) -> tuple[Any, Any]:
    """Type and default of a field of a section, from one of a class; the default is ... if the key must be given."""
    asked = one.metadata["parameter"]
    default = one.default
    kind: Any = KINDS.get(asked.kind) or NUMBERS.get(asked.demand, FiniteFloat)
    words = asked.words
    if issubclass(made, Bonded) and asked.kind is law.groups:
        words = f"{one.name} of atoms{words and ', '}{words}; the {made.acts_on} of the structure"
        kind = GROUPS[asked.of]
        words = words + (" if not given" if made.acts_on == "bonds" else " file if not given")
    elif asked.kind is law.atoms:
        words = "atoms on which the potential acts; all if not given"
    elif asked.kind is law.choice:
        kind = Literal[tuple(asked.of)]
    if default in (None, inf):
        kind = kind | None
        default = None
    elif default is MISSING or (asked.dimension and default != 0.0):
        default = ...
    told = Field(description=words)
    return Annotated[kind, told, Dimension(asked.dimension)] if asked.dimension else Annotated[
        kind, told
    ], default


class OfForces(Section):
    """[[potential]] with one of the types in MADE."""

    def potential(self) -> Any:
        """The potential that the section describes."""
        given = {name: value for name, value in self if name != "type" and value is not None}
        if len(given.get("points", ())) == 1:  # for all atoms
            given["points"] = given["points"][0]
        return MADE[self.type](**given)  # type: ignore[attr-defined]


def declared_laws() -> Iterator[tuple[str, type[law.Declared]]]:
    """The public potentials whose arguments are all numbers, texts and atoms, with their types."""
    for name, place in places_of(potentials.__name__).items():
        potential: Any = (
            getattr(import_module(place), name) if place.startswith("minimd.core.") else None
        )
        is_declared = isinstance(potential, type) and issubclass(potential, law.Declared)
        if is_declared and not {law.own_law, law.given} & potential.kinds():
            yield (
                re.sub("(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "-", name).lower(),
                potential,
            )


MADE = dict(declared_laws())
ForceSection = functools.reduce(
    operator.or_,
    (
        create_model(  # type: ignore[call-overload]
            f"{made.__name__}Section",
            __base__=OfForces,
            __module__=__name__,
            type=(Literal[kind], ...),
            **{one.name: key(one, made) for one in fields(made)},  # type: ignore[arg-type]
        )
        for kind, made in MADE.items()
    ),
)
