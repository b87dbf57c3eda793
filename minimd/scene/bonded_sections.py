"""The sections of a scene file for bonds, angles, dihedrals and impropers."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, NonNegativeInt

from minimd.potentials import FENEBond, HarmonicAngle, HarmonicBond, HarmonicImproper, MorseBond, OPLSDihedral, PeriodicDihedral, RyckaertBellemans
from minimd.scene.section import Dimension, Section
from minimd.scene.values import NotNegative, PairOfAtoms, Positive, QuadrupleOfAtoms, TripleOfAtoms


class HarmonicBondSection(Section):
    """[[potential]] of type "harmonic-bond": on structure.bonds, or on pairs."""

    type: Literal["harmonic-bond"]
    k: Annotated[NotNegative, Dimension("stiffness")]
    length: Annotated[NotNegative, Dimension("length")]
    pairs: list[PairOfAtoms] | None = None

    def potential(self) -> HarmonicBond:
        """The potential that the section describes."""
        return HarmonicBond(self.k, self.length, self.pairs)


class MorseBondSection(Section):
    """[[potential]] of type "morse-bond": on structure.bonds, or on pairs."""

    type: Literal["morse-bond"]
    depth: Annotated[NotNegative, Dimension("energy")]
    a: Annotated[Positive, Dimension("inverse length")]
    length: Annotated[NotNegative, Dimension("length")]
    pairs: list[PairOfAtoms] | None = None

    def potential(self) -> MorseBond:
        """The potential that the section describes."""
        return MorseBond(self.depth, self.a, self.length, self.pairs)


class FENEBondSection(Section):
    """[[potential]] of type "fene-bond": on structure.bonds, or on pairs."""

    type: Literal["fene-bond"]
    k: Annotated[NotNegative, Dimension("stiffness")]
    longest: Annotated[Positive, Dimension("length")]
    epsilon: Annotated[NotNegative, Dimension("energy")]
    sigma: Annotated[Positive, Dimension("length")]
    pairs: list[PairOfAtoms] | None = None

    def potential(self) -> FENEBond:
        """The potential that the section describes."""
        return FENEBond(self.k, self.longest, self.epsilon, self.sigma, self.pairs)


class HarmonicAngleSection(Section):
    """[[potential]] of type "harmonic-angle": on triples of atoms, or on the angles of the structure file."""

    type: Literal["harmonic-angle"]
    k: Annotated[NotNegative, Dimension("angular stiffness")]
    angle: Annotated[NotNegative, Dimension("angle")]
    triples: list[TripleOfAtoms] | None = None

    def potential(self) -> HarmonicAngle:
        """The potential that the section describes."""
        return HarmonicAngle(self.k, self.angle, self.triples)


class PeriodicDihedralSection(Section):
    """[[potential]] of type "periodic-dihedral": on quadruples of atoms, or on the dihedrals of the structure file."""

    type: Literal["periodic-dihedral"]
    k: Annotated[FiniteFloat, Dimension("energy")]
    n: NonNegativeInt
    phase: Annotated[FiniteFloat, Dimension("angle")] = 0.0
    quadruples: list[QuadrupleOfAtoms] | None = None

    def potential(self) -> PeriodicDihedral:
        """The potential that the section describes."""
        return PeriodicDihedral(self.k, self.n, self.phase, self.quadruples)


class OPLSDihedralSection(Section):
    """[[potential]] of type "opls-dihedral": on quadruples of atoms, or on the dihedrals of the structure file."""

    type: Literal["opls-dihedral"]
    k1: Annotated[FiniteFloat, Dimension("energy")]
    k2: Annotated[FiniteFloat, Dimension("energy")]
    k3: Annotated[FiniteFloat, Dimension("energy")]
    k4: Annotated[FiniteFloat, Dimension("energy")] = 0.0
    quadruples: list[QuadrupleOfAtoms] | None = None

    def potential(self) -> OPLSDihedral:
        """The potential that the section describes."""
        return OPLSDihedral(self.k1, self.k2, self.k3, self.k4, self.quadruples)


class RyckaertBellemansSection(Section):
    """[[potential]] of type "ryckaert-bellemans": on quadruples of atoms, or on the dihedrals of the structure file."""

    type: Literal["ryckaert-bellemans"]
    coefficients: Annotated[Annotated[list[FiniteFloat], Field(min_length=1, max_length=6)], Dimension("energy")]
    quadruples: list[QuadrupleOfAtoms] | None = None

    def potential(self) -> RyckaertBellemans:
        """The potential that the section describes."""
        return RyckaertBellemans(self.coefficients, self.quadruples)


class HarmonicImproperSection(Section):
    """[[potential]] of type "harmonic-improper": on quadruples of atoms, or on the impropers of the structure file."""

    type: Literal["harmonic-improper"]
    k: Annotated[NotNegative, Dimension("angular stiffness")]
    angle: Annotated[FiniteFloat, Dimension("angle")] = 0.0
    quadruples: list[QuadrupleOfAtoms] | None = None

    def potential(self) -> HarmonicImproper:
        """The potential that the section describes."""
        return HarmonicImproper(self.k, self.angle, self.quadruples)


BondedSection = (
    HarmonicBondSection
    | MorseBondSection
    | FENEBondSection
    | HarmonicAngleSection
    | PeriodicDihedralSection
    | OPLSDihedralSection
    | RyckaertBellemansSection
    | HarmonicImproperSection
)
