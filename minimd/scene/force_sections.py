"""The sections of a scene file for declared laws: charges, bonds, angles, dihedrals, impropers, fields, springs, walls.

The type of a section is the name of the class, as harmonic-bond; its keys are the arguments. A length, an energy or
another quantity that is not zero by default must be given, since units differ between scenes.
"""

import re
from collections.abc import Iterator
from dataclasses import MISSING, fields
from importlib import import_module
from math import inf
from typing import Annotated, Any, Literal, Union

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
    law.seed: NonNegativeInt,
    law.pairs: list[PairOfAtoms],
    law.quadruples: GROUPS[4],
    law.maps: list[list[FiniteFloat]],
}


def key(argument: Any, potential: type[law.Declared]) -> tuple[Any, Any]:
    """Type and default of a field of a section, from one of a class; the default is ... if the key must be given."""
    parameter = argument.metadata["parameter"]
    default = argument.default
    kind: Any = KINDS.get(parameter.kind) or NUMBERS.get(parameter.demand, FiniteFloat)
    text = parameter.words
    if issubclass(potential, Bonded) and parameter.kind is law.groups:
        kind = GROUPS[parameter.of]
        group = f"{argument.name} of atoms, {text}" if text else f"{argument.name} of atoms"
        source = "structure" if potential.acts_on == "bonds" else "structure file"
        text = f"{group}; the {potential.acts_on} of the {source} if not given"
    elif parameter.kind is law.atoms:
        text = "atoms on which the potential acts; all if not given"
    elif parameter.kind is law.choice:
        kind = Literal[tuple(parameter.of)]

    if default in (None, inf):
        kind = kind | None
        default = None
    elif default is MISSING or (parameter.dimension and default != 0.0):
        default = ...

    marks = [Field(description=text)]
    if parameter.dimension:
        marks.append(Dimension(parameter.dimension))
    return Annotated[kind, *marks], default


class OfForces(Section):
    """[[potential]] with one of the types in LAWS."""

    def potential(self) -> Any:
        """The potential that the section describes."""
        arguments = {name: value for name, value in self if name != "type" and value is not None}
        if len(arguments.get("points", ())) == 1:  # for all atoms
            arguments["points"] = arguments["points"][0]
        return LAWS[self.type](**arguments)  # type: ignore[attr-defined]


def declared_laws() -> Iterator[tuple[str, type[law.Declared]]]:
    """The public potentials whose arguments are all numbers, texts and atoms, with their types."""
    for name, place in places_of(potentials.__name__).items():
        if place.startswith("minimd.core."):
            potential: Any = getattr(import_module(place), name)
            is_declared = isinstance(potential, type) and issubclass(potential, law.Declared)
            if is_declared and not {law.own_law, law.given} & potential.kinds():
                kind = re.sub("(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "-", name).lower()
                yield kind, potential


def section_of(kind: str, potential: Any) -> type[OfForces]:
    """The section for a potential; kind : its type in scene files."""
    keys: dict[str, Any] = {"type": (Literal[kind], ...)}
    keys |= {argument.name: key(argument, potential) for argument in fields(potential)}
    name = f"{potential.__name__}Section"
    return create_model(name, __base__=OfForces, __module__=__name__, **keys)


LAWS = dict(declared_laws())
ForceSection: Any = Union[tuple(map(section_of, LAWS, LAWS.values()))]
