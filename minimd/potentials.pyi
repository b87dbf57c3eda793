"""Public names: potentials, and what a term of your own needs."""

from minimd.core.potentials.active import ActiveForce as ActiveForce
from minimd.core.potentials.bonded import (
    BondPotential as BondPotential,
    DihedralMap as DihedralMap,
    DihedralPotential as DihedralPotential,
    FENEBond as FENEBond,
    HarmonicAngle as HarmonicAngle,
    HarmonicBond as HarmonicBond,
    HarmonicImproper as HarmonicImproper,
    MorseBond as MorseBond,
    OPLSDihedral as OPLSDihedral,
    PeriodicDihedral as PeriodicDihedral,
    QuarticBond as QuarticBond,
    RyckaertBellemans as RyckaertBellemans,
)
from minimd.core.potentials.coulomb import Coulomb as Coulomb
from minimd.core.potentials.embedded import EmbeddedAtom as EmbeddedAtom
from minimd.core.potentials.fields import (
    ConstantForce as ConstantForce,
    CylinderWall as CylinderWall,
    Field as Field,
    Gravity as Gravity,
    Restraint as Restraint,
    SphereWall as SphereWall,
    SteeredSpring as SteeredSpring,
    Wall as Wall,
)
from minimd.core.potentials.pair import (
    LennardJones as LennardJones,
    Mie as Mie,
    PairPotential as PairPotential,
    SoftRepulsion as SoftRepulsion,
)
from minimd.core.potentials.tabulated import Tabulated as Tabulated
from minimd.core.potentials.term import (
    FORCES as FORCES,
    PER_ATOM as PER_ATOM,
    TOTALS as TOTALS,
    Term as Term,
)
from minimd.openmm.openmm_system import from_openmm as from_openmm
from minimd.scene.water import water as water
