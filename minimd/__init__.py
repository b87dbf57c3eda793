"""minimd: a molecular-dynamics mini-engine."""

from minimd import units
from minimd.cell import Cell
from minimd.errors import ConstraintError, NonFiniteError
from minimd.forces import Evaluation, evaluate
from minimd.neighbors import neighbor_list
from minimd.potentials import BondPotential, HarmonicAngle, HarmonicBond, LennardJones, PairPotential
from minimd.system import System
