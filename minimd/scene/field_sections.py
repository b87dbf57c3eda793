"""The sections of a scene file for fields, springs and walls."""

from math import inf
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from minimd.potentials import ConstantForce, CylinderWall, Gravity, Restraint, SphereWall, SteeredSpring, Wall
from minimd.potentials.walls import WallLaw
from minimd.scene.section import Dimension, Section
from minimd.scene.values import Atoms, NotNegative, Positive, Vector

Points = Annotated[list[Vector], Field(min_length=1)]


class ConstantForceSection(Section):
    """[[potential]] of type "constant-force"."""

    type: Literal["constant-force"]
    force: Annotated[Vector, Dimension("force")]
    atoms: Atoms | None = None

    def potential(self) -> ConstantForce:
        """The potential that the section describes."""
        return ConstantForce(self.force, self.atoms)


class GravitySection(Section):
    """[[potential]] of type "gravity"."""

    type: Literal["gravity"]
    acceleration: Annotated[Vector, Dimension("acceleration")]
    atoms: Atoms | None = None

    def potential(self) -> Gravity:
        """The potential that the section describes."""
        return Gravity(self.acceleration, self.atoms)


class RestraintSection(Section):
    """[[potential]] of type "restraint": springs to points, one for all atoms, or one for each."""

    type: Literal["restraint"]
    k: Annotated[NotNegative, Dimension("stiffness")]
    points: Annotated[Points, Dimension("length")]
    atoms: Atoms | None = None

    def potential(self) -> Restraint:
        """The potential that the section describes."""
        return Restraint(self.k, self.points[0] if len(self.points) == 1 else self.points, self.atoms)


class SteeredSpringSection(Section):
    """[[potential]] of type "steered-spring": springs to points that move."""

    type: Literal["steered-spring"]
    k: Annotated[NotNegative, Dimension("stiffness")]
    points: Annotated[Points, Dimension("length")]
    velocity: Annotated[Vector, Dimension("velocity")]
    atoms: Atoms | None = None
    start: Annotated[FiniteFloat, Dimension("time")] = 0.0
    end: Annotated[FiniteFloat | None, Dimension("time")] = None

    def potential(self) -> SteeredSpring:
        """The potential that the section describes."""
        points = self.points[0] if len(self.points) == 1 else self.points
        return SteeredSpring(self.k, points, self.velocity, self.atoms, start=self.start, end=inf if self.end is None else self.end)


class WallSection(Section):
    """[[potential]] of type "wall": a plane."""

    type: Literal["wall"]
    point: Annotated[Vector, Dimension("length")]
    normal: Vector
    epsilon: Annotated[NotNegative, Dimension("energy")]
    sigma: Annotated[Positive, Dimension("length")]
    cutoff: Annotated[Positive | None, Dimension("length")] = None
    law: WallLaw = "9-3"
    atoms: Atoms | None = None

    def potential(self) -> Wall:
        """The potential that the section describes."""
        return Wall(self.point, self.normal, self.epsilon, self.sigma, self.cutoff, self.law, self.atoms)


class CylinderWallSection(Section):
    """[[potential]] of type "cylinder-wall", with atoms inside."""

    type: Literal["cylinder-wall"]
    point: Annotated[Vector, Dimension("length")]
    axis: Vector
    radius: Annotated[Positive, Dimension("length")]
    epsilon: Annotated[NotNegative, Dimension("energy")]
    sigma: Annotated[Positive, Dimension("length")]
    cutoff: Annotated[Positive | None, Dimension("length")] = None
    law: WallLaw = "9-3"
    atoms: Atoms | None = None

    def potential(self) -> CylinderWall:
        """The potential that the section describes."""
        return CylinderWall(self.point, self.axis, self.radius, self.epsilon, self.sigma, self.cutoff, self.law, self.atoms)


class SphereWallSection(Section):
    """[[potential]] of type "sphere-wall", with atoms inside."""

    type: Literal["sphere-wall"]
    point: Annotated[Vector, Dimension("length")]
    radius: Annotated[Positive, Dimension("length")]
    epsilon: Annotated[NotNegative, Dimension("energy")]
    sigma: Annotated[Positive, Dimension("length")]
    cutoff: Annotated[Positive | None, Dimension("length")] = None
    law: WallLaw = "9-3"
    atoms: Atoms | None = None

    def potential(self) -> SphereWall:
        """The potential that the section describes."""
        return SphereWall(self.point, self.radius, self.epsilon, self.sigma, self.cutoff, self.law, self.atoms)


FieldSection = ConstantForceSection | GravitySection | RestraintSection | SteeredSpringSection | WallSection | CylinderWallSection | SphereWallSection
