"""Laws u(r), their truncation and mixing, bonded terms, and the plain loops that apply them."""

from minimd.potentials.bonded import (
    BondPotential,
    DihedralPotential,
    FENEBond,
    HarmonicAngle,
    HarmonicBond,
    HarmonicImproper,
    MorseBond,
    OPLSDihedral,
    PeriodicDihedral,
    RyckaertBellemans,
)
from minimd.potentials.coulomb import Coulomb
from minimd.potentials.fields import (
    ConstantForce,
    CylinderWall,
    Field,
    Gravity,
    Restraint,
    SphereWall,
    SteeredSpring,
    Wall,
)
from minimd.potentials.openmm_system import from_openmm
from minimd.potentials.pair import LennardJones, PairPotential, Tabulated
from minimd.potentials.term import FORCES, PER_ATOM, TOTALS, Term
from minimd.potentials.water import water

__all__ = ["FORCES", "PER_ATOM", "TOTALS", "BondPotential", "ConstantForce", "Coulomb", "CylinderWall"]
__all__ += ["DihedralPotential", "FENEBond", "Field", "Gravity", "HarmonicAngle", "HarmonicBond", "HarmonicImproper"]
__all__ += ["LennardJones", "MorseBond", "OPLSDihedral", "PairPotential", "PeriodicDihedral", "Restraint"]
__all__ += ["RyckaertBellemans", "SphereWall", "SteeredSpring", "Tabulated", "Term", "Wall", "from_openmm", "water"]
