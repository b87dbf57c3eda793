"""The public names of minimd, and where each is: read by type checkers, and at run time."""

from minimd import (
    free_energy as free_energy,
    integrators as integrators,
    lammps as lammps,
    observers as observers,
    potentials as potentials,
)
from minimd.core.console import __version__ as __version__
from minimd.core.diagnosis.evaluation import Evaluation as Evaluation, evaluate as evaluate
from minimd.core.diagnosis.report import Report as Report
from minimd.core.diagnosis.reversibility import Reversibility as Reversibility
from minimd.core.diagnosis.shadow_energy import shadow_energy as shadow_energy
from minimd.core.diagnosis.timestep import (
    StepAdvice as StepAdvice,
    advise_timestep as advise_timestep,
)
from minimd.core.engine.record import Record as Record
from minimd.core.files.gromacs_h5md import to_gromacs as to_gromacs
from minimd.core.files.h5md_reader import (
    read_observers as read_observers,
    read_record as read_record,
)
from minimd.core.forces.forces import ForceResult as ForceResult, Forces as Forces
from minimd.core.integrators.barostats import StochasticCellRescaling as StochasticCellRescaling
from minimd.core.integrators.hybrid_monte_carlo import HybridMonteCarlo as HybridMonteCarlo
from minimd.core.integrators.ramp import Ramp as Ramp
from minimd.core.integrators.respa import RESPA as RESPA, LangevinRESPA as LangevinRESPA
from minimd.core.integrators.rows import (
    Leapfrog as Leapfrog,
    PositionVerlet as PositionVerlet,
    VelocityVerlet as VelocityVerlet,
)
from minimd.core.integrators.thermostats import (
    BrownianDynamics as BrownianDynamics,
    LangevinBAOAB as LangevinBAOAB,
    LangevinGJF as LangevinGJF,
    StochasticVelocityRescaling as StochasticVelocityRescaling,
)
from minimd.core.minimization.minimization import Minimization as Minimization, minimize as minimize
from minimd.core.neighbors.queries import neighbor_list as neighbor_list
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
from minimd.core.potentials.term import Potential as Potential, Term as Term
from minimd.core.simulation.simulation import Simulation as Simulation
from minimd.core.structure import lattice as lattice, units as units
from minimd.core.structure.cell import Cell as Cell
from minimd.core.structure.constraints import (
    DistanceConstraints as DistanceConstraints,
    FixedAtoms as FixedAtoms,
)
from minimd.core.structure.errors import (
    ConstraintError as ConstraintError,
    ConvergenceError as ConvergenceError,
    NonFiniteError as NonFiniteError,
    RangeError as RangeError,
)
from minimd.core.structure.grid import Grid as Grid
from minimd.core.structure.sites import Sites as Sites
from minimd.core.structure.statistics import mean_and_error as mean_and_error
from minimd.core.structure.system import System as System
from minimd.ensemble.exchange import exchange as exchange
from minimd.ensemble.ladder import Ladder as Ladder
from minimd.ensemble.member import Member as Member
from minimd.ensemble.running import ensemble as ensemble
from minimd.ensemble.table import EnsembleTable as EnsembleTable
from minimd.judge.findings import Grade as Grade
from minimd.judge.grading import grade as grade
from minimd.openmm.openmm_system import from_openmm as from_openmm
from minimd.past.archiving import archive as archive
from minimd.past.past import Past as Past
from minimd.past.replay import replay as replay
from minimd.scene.water import water as water
from minimd.view.viewing import view as view
