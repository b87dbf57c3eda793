"""Laws u(r), their truncation and mixing, bonded terms, and the plain loops that apply them."""

from minimd.potentials.angles import HarmonicAngle
from minimd.potentials.bonded import BondPotential, HarmonicBond
from minimd.potentials.lennard_jones import LennardJones
from minimd.potentials.pair import PairPotential
from minimd.potentials.tabulated import Tabulated
from minimd.potentials.term import FORCES, PER_ATOM, TOTALS, Term

__all__ = ["FORCES", "PER_ATOM", "TOTALS", "BondPotential", "HarmonicAngle", "HarmonicBond", "LennardJones", "PairPotential", "Tabulated", "Term"]
