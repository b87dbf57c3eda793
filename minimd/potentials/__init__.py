"""Laws u(r), their truncation and mixing, bonded terms, and the loops that apply them."""

from minimd.potentials.bonded import BondPotential, HarmonicAngle, HarmonicBond
from minimd.potentials.lennard_jones import LennardJones
from minimd.potentials.pair import PairPotential

__all__ = ["BondPotential", "HarmonicAngle", "HarmonicBond", "LennardJones", "PairPotential"]
