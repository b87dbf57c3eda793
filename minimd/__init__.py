"""minimd: a molecular-dynamics mini-engine, fast and exact. Its modules are described in docs/architecture.md."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from minimd import integrators, observers
from minimd.console import __version__ as __version__
from minimd.console.words import near
from minimd.diagnosis.report import Report
from minimd.diagnosis.reversibility import Reversibility
from minimd.diagnosis.shadow_energy import shadow_energy
from minimd.diagnosis.timestep import StepAdvice, advise_timestep
from minimd.engine.record import Record
from minimd.ensemble import EnsembleTable, Member, ensemble
from minimd.forces.evaluation import Evaluation, evaluate
from minimd.forces.forces import Forces
from minimd.grade import Grade, grade
from minimd.integrators import (
    LangevinBAOAB,
    Leapfrog,
    PositionVerlet,
    StochasticCellRescaling,
    StochasticVelocityRescaling,
    VelocityVerlet,
)
from minimd.minimization.minimization import Minimization, minimize
from minimd.neighbors import neighbor_list
from minimd.potentials import (
    BondPotential,
    ConstantForce,
    Coulomb,
    CylinderWall,
    DihedralPotential,
    FENEBond,
    Field,
    Gravity,
    HarmonicAngle,
    HarmonicBond,
    HarmonicImproper,
    LennardJones,
    MorseBond,
    OPLSDihedral,
    PairPotential,
    PeriodicDihedral,
    Restraint,
    RyckaertBellemans,
    SphereWall,
    SteeredSpring,
    Tabulated,
    Wall,
    from_openmm,
    water,
)
from minimd.potentials.term import Potential, Term
from minimd.replay import replay
from minimd.simulation.archiving import archive
from minimd.simulation.past import Past
from minimd.simulation.simulation import Simulation
from minimd.structure import lattice, units
from minimd.structure.cell import Cell
from minimd.structure.constraints import DistanceConstraints, FixedAtoms
from minimd.structure.errors import ConstraintError, ConvergenceError, NonFiniteError, RangeError
from minimd.structure.grid import Grid
from minimd.structure.system import System
from minimd.view import view

__all__ = [
    "BondPotential", "Cell", "ConstantForce", "ConstraintError", "ConvergenceError", "Coulomb", "CylinderWall",
    "DihedralPotential", "DistanceConstraints", "EnsembleTable", "Evaluation", "FENEBond", "Field", "FixedAtoms",
    "Forces", "Grade", "Gravity", "Grid", "HarmonicAngle", "HarmonicBond", "HarmonicImproper", "LangevinBAOAB",
    "Leapfrog", "LennardJones", "Member", "Minimization", "MorseBond", "NonFiniteError", "OPLSDihedral",
    "PairPotential", "Past", "PeriodicDihedral", "PositionVerlet", "Potential", "RangeError", "Record", "Report",
    "Restraint", "Reversibility", "RyckaertBellemans", "Simulation", "SphereWall", "SteeredSpring", "StepAdvice",
    "StochasticCellRescaling", "StochasticVelocityRescaling", "System", "Tabulated", "Term", "VelocityVerlet", "Wall",
    "advise_timestep", "archive", "ensemble", "evaluate", "from_openmm", "grade", "integrators", "lammps", "lattice",
    "minimize", "neighbor_list", "observers", "read_observers", "read_record", "replay", "shadow_energy", "units",
    "view", "water",
]  # fmt: skip

OF_MDANALYSIS = "universe", "radial_distribution", "diffusion_coefficient", "mean_square_displacement", "Turn"


def __getattr__(name: str) -> ModuleType:
    """A package of minimd, such as the bridge to LAMMPS, imported when it is first used."""
    if name.isidentifier() and not name.startswith("_") and find_spec(f"minimd.{name}"):
        return import_module(f"minimd.{name}")
    rooms = {"integrators": integrators, "observers": observers, "lattice": lattice, "units": units}
    has = (place for place, room in rooms.items() if hasattr(room, name))
    places = [place for place in has if not isinstance(getattr(rooms[place], name), ModuleType)]
    places += ["mdanalysis"] * (name in OF_MDANALYSIS)
    hint = f"; it is minimd.{places[0]}.{name}" if places else near(name, __all__)
    raise AttributeError(f"module 'minimd' has no attribute {name!r}{hint}")


def read_observers(path: str | Path) -> dict[str, observers.Accumulator]:
    """The observers in an H5MD file by name, in their state at its restart:
    read_observers("run.h5md")["viscosity"].result().

    Raises OSError, ValueError for a file that does not exist, is damaged, or was not written by minimd.
    """
    from minimd.files.h5md_reader import read_file  # h5py is slow to load

    return read_file(path).observers


def read_record(path: str | Path) -> Record:
    """The Record of all frames in an H5MD file, also of a run that was continued.  Raises as read_observers."""
    from minimd.files.h5md_reader import read_file

    return read_file(path).record


def __dir__() -> list[str]:
    """The public names only; other modules of minimd can be imported, too."""
    return [*__all__, "__all__", "__doc__", "__version__"]
