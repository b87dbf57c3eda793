"""The sections of a scene file for bonds, angles, dihedrals, impropers, fields, springs and walls:
one row for each type of [[potential]]."""

import functools
import operator
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat, NonNegativeInt, create_model

from minimd import potentials
from minimd.potentials.walls import WallLaw
from minimd.scene.section import (
    Atoms,
    Dimension,
    NotNegative,
    PairOfAtoms,
    Positive,
    QuadrupleOfAtoms,
    Section,
    TripleOfAtoms,
    Vector,
)

FieldOfSection = tuple[Any, Any]  # its type, and its default; ... if it must be given


def quantity(kind: Any, dimension: str, default: Any = ...) -> FieldOfSection:
    """A field for a quantity with this dimension."""
    return Annotated[kind, Dimension(dimension)], default


def stiffness(dimension: str) -> FieldOfSection:
    """A field for a quantity that is not negative."""
    return quantity(NotNegative, dimension)


ENERGY, LENGTH, SIZE = stiffness("energy"), stiffness("length"), quantity(Positive, "length")
PHASE, POINT = quantity(FiniteFloat, "angle", 0.0), quantity(Vector, "length")
POINTS = quantity(Annotated[list[Vector], Field(min_length=1)], "length")
PAIRS, TRIPLES = {"pairs": (list[PairOfAtoms] | None, None)}, {"triples": (list[TripleOfAtoms] | None, None)}
QUADRUPLES, ATOMS = {"quadruples": (list[QuadrupleOfAtoms] | None, None)}, {"atoms": (Atoms | None, None)}
WALL = {
    "epsilon": ENERGY,
    "sigma": SIZE,
    "cutoff": quantity(Positive | None, "length", None),
    "law": (WallLaw, "9-3"),
    **ATOMS,
}
SPRING = {"k": stiffness("stiffness"), "points": POINTS}
COEFFICIENT, COEFFICIENTS = (
    quantity(FiniteFloat, "energy"),
    Annotated[list[FiniteFloat], Field(min_length=1, max_length=6)],
)
TIMES = {"start": quantity(FiniteFloat, "time", 0.0), "end": quantity(FiniteFloat | None, "time", None)}

ROWS: dict[
    str, tuple[type, dict[str, FieldOfSection]]
] = {  # type in the scene: class of the potential, and fields, named as its arguments
    "harmonic-bond": (potentials.HarmonicBond, {"k": stiffness("stiffness"), "length": LENGTH, **PAIRS}),
    "morse-bond": (
        potentials.MorseBond,
        {"depth": ENERGY, "a": quantity(Positive, "inverse length"), "length": LENGTH, **PAIRS},
    ),
    "fene-bond": (
        potentials.FENEBond,
        {"k": stiffness("stiffness"), "longest": SIZE, "epsilon": ENERGY, "sigma": SIZE, **PAIRS},
    ),
    "harmonic-angle": (
        potentials.HarmonicAngle,
        {"k": stiffness("angular stiffness"), "angle": stiffness("angle"), **TRIPLES},
    ),
    "periodic-dihedral": (
        potentials.PeriodicDihedral,
        {"k": COEFFICIENT, "n": (NonNegativeInt, ...), "phase": PHASE, **QUADRUPLES},
    ),
    "opls-dihedral": (
        potentials.OPLSDihedral,
        {
            "k1": COEFFICIENT,
            "k2": COEFFICIENT,
            "k3": COEFFICIENT,
            "k4": quantity(FiniteFloat, "energy", 0.0),
            **QUADRUPLES,
        },
    ),
    "ryckaert-bellemans": (
        potentials.RyckaertBellemans,
        {"coefficients": quantity(COEFFICIENTS, "energy"), **QUADRUPLES},
    ),
    "harmonic-improper": (
        potentials.HarmonicImproper,
        {"k": stiffness("angular stiffness"), "angle": PHASE, **QUADRUPLES},
    ),
    "constant-force": (potentials.ConstantForce, {"force": quantity(Vector, "force"), **ATOMS}),
    "gravity": (potentials.Gravity, {"acceleration": quantity(Vector, "acceleration"), **ATOMS}),
    "restraint": (potentials.Restraint, {**SPRING, **ATOMS}),
    "steered-spring": (
        potentials.SteeredSpring,
        {**SPRING, "velocity": quantity(Vector, "velocity"), **ATOMS, **TIMES},
    ),
    "wall": (potentials.Wall, {"point": POINT, "normal": (Vector, ...), **WALL}),
    "cylinder-wall": (potentials.CylinderWall, {"point": POINT, "axis": (Vector, ...), "radius": SIZE, **WALL}),
    "sphere-wall": (potentials.SphereWall, {"point": POINT, "radius": SIZE, **WALL}),
}


class OfForces(Section):
    """[[potential]] of one of the types in ROWS."""

    def potential(self) -> Any:
        """The potential that the section describes."""
        given = {
            name: value
            for name in type(self).model_fields
            if name != "type" and (value := getattr(self, name)) is not None
        }
        if len(given.get("points", ())) == 1:  # for all atoms
            given["points"] = given["points"][0]
        return ROWS[self.type][0](**given)  # type: ignore[attr-defined]


ForceSection = functools.reduce(
    operator.or_,
    (
        create_model(
            f"{made.__name__}Section", __base__=OfForces, __module__=__name__, type=(Literal[kind], ...), **fields
        )  # type: ignore[call-overload]
        for kind, (made, fields) in ROWS.items()
    ),
)
