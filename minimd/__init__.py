"""minimd: a molecular-dynamics mini-engine. Fast, exact, and small enough to read in an afternoon."""

from minimd import integrators, units
from minimd.advice import StepAdvice, advise_timestep
from minimd.cell import Cell
from minimd.errors import ConstraintError, ConvergenceError, NonFiniteError
from minimd.forces import Evaluation, Forces, evaluate
from minimd.integrators import DistanceConstraints, LangevinBAOAB, Leapfrog, PositionVerlet, StochasticVelocityRescaling, VelocityVerlet
from minimd.minimization import Minimization, minimize
from minimd.neighbors import neighbor_list
from minimd.potentials import BondPotential, HarmonicAngle, HarmonicBond, LennardJones, PairPotential
from minimd.record import Record
from minimd.replaying import replay
from minimd.report import Report
from minimd.reversibility import Reversibility
from minimd.rigidity import FixedAtoms
from minimd.shadow import shadow_energy
from minimd.simulation import Simulation
from minimd.system import System

__version__ = "0.1.0"
__all__ = [
    "BondPotential",
    "Cell",
    "ConstraintError",
    "ConvergenceError",
    "DistanceConstraints",
    "Evaluation",
    "FixedAtoms",
    "Forces",
    "HarmonicAngle",
    "HarmonicBond",
    "LangevinBAOAB",
    "Leapfrog",
    "LennardJones",
    "Minimization",
    "NonFiniteError",
    "PairPotential",
    "PositionVerlet",
    "Record",
    "Report",
    "Reversibility",
    "Simulation",
    "StepAdvice",
    "StochasticVelocityRescaling",
    "System",
    "VelocityVerlet",
    "advise_timestep",
    "evaluate",
    "integrators",
    "minimize",
    "neighbor_list",
    "replay",
    "shadow_energy",
    "units",
]
