"""The files that LAMMPS reads: atoms, forces, the verification at step 0, the run."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.whole_file import write_whole
from minimd.core.engine.engine import Engine
from minimd.core.integrators.ramp import Ramp
from minimd.core.integrators.rows import Leapfrog, VelocityVerlet
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.thermostats import LangevinBAOAB, StochasticVelocityRescaling
from minimd.core.structure.arrays import Array
from minimd.core.structure.lammps_box import Box
from minimd.lammps.model import METALS, Model, words
from minimd.lammps.verification import Evaluated

ATOMS = "atoms.data"
FORCES = "forces.lmp"
VERIFY = "verify.lmp"
RUN = "run.lmp"
LOG = "run.log"
# results at step 0
COPY = "copy.data"
STEP_0 = ("atoms.data.bin", "copy.data.bin")
FRAMES = "frames.bin"
LAST = "last.bin"
RAW = (FRAMES, LAST, COPY, *STEP_0)  # removed at the end
FILES = (
    ATOMS,
    FORCES,
    METALS,
    VERIFY,
    RUN,
    LOG,
    *RAW,
)  # all files of a hand-over except the trajectory
# tolerance relative to the lengths
SHAKE_TOLERANCE = 1e-13
SHAKE_ITERATIONS = 200
LARGEST_SEED = 900_000_000  # of LAMMPS' random numbers
LOOKS = 50  # least number of lines with energies in the log of a run
# xx yy zz yz xz xy
PER_ATOM = "c_energies fx fy fz c_stresses[1] c_stresses[2] c_stresses[3] c_stresses[6] c_stresses[5] c_stresses[4]"

# the runs of 0 steps: energy, force and virial of each atom, in the scene and in its copy
VERIFICATION = f"""variable atoms index {ATOMS} {COPY}
include {FORCES}
compute energies all pe/atom
compute stresses all stress/atom NULL virial
dump step0 all custom 1 ${{atoms}}.bin id {PER_ATOM}
thermo_style custom step pe
thermo_modify norm no format float %.17g
run 0
clear
next atoms
jump SELF
"""
BATHS: dict[type, str] = {
    LangevinBAOAB: "fix langevin",
    StochasticVelocityRescaling: "fix temp/csvr",
}
# Leapfrog: same observed states
METHODS: tuple[type[Splitting], ...] = (VelocityVerlet, Leapfrog, *BATHS)


def check_method(engine: Engine) -> None:
    """Raise ValueError for a method that LAMMPS does not have."""
    method = engine.method
    if type(method) not in METHODS:
        known = ", ".join(each.name for each in METHODS)
        raise ValueError(
            f"LAMMPS can make the steps of {known}; the method is {method.name}: choose another one, or "
            "run this scene with minimd"
        )
    if method.timestep < 0.0:
        raise ValueError(
            f"the time step must be positive for LAMMPS; timestep = {method.timestep!r}"
        )


def write(folder: Path, engine: Engine, model: Model, n_steps: int, every: int) -> None:
    """The input of a run: atoms, forces, tables of embedded atoms, script."""
    write_atoms(folder / ATOMS, model, model.box, engine.velocities)
    write_whole(folder / FORCES, forces_script(model))
    if model.tables is not None:
        write_whole(folder / METALS, model.tables.as_text())
    write_whole(folder / RUN, run_script(engine, model, n_steps, every))


def write_atoms(path: Path, model: Model, box: Box, velocities: Array) -> None:
    """The data file, with velocities (N, 3); all numbers have all their digits."""
    types = model.types.of_atom + 1
    sections: dict[str, list[NDArray[Any]]] = {
        "Masses": [model.types.masses],
        "Atoms # full": [np.ones_like(types), types, model.charges, box.positions],
        "Velocities": [box.turned(velocities)],
    }
    for word, groups in model.joined.items():
        sections[f"{word.capitalize()}s"] = [groups.types + 1, groups.atoms + 1]
    with path.open("x", encoding="ascii") as file:
        file.writelines(box.data_file("atoms of a scene of minimd", sections))


def forces_script(model: Model) -> str:
    """The commands with which both runs begin: units, box, atoms, styles, lists."""
    lines = [
        "units lj",
        f"dimension {2 if model.box.is_plane else 3}",
        "suffix opt",
        "atom_style full",
        f"boundary {model.box.boundary}",
        "box tilt large",
        f"special_bonds lj/coul {words(*model.special_bonds())}",
        f"comm_modify cutoff {model.reach:.17g}",
        "read_data ${atoms}",
        *model.commands(),
        f"neighbor {model.skin:.17g} {model.search}",
        "neigh_modify every 1 delay 0 check yes",
        "",
    ]
    return "\n".join(lines)


def run_script(engine: Engine, model: Model, n_steps: int, every: int) -> str:
    """The commands of the run: integrator, bath, rigid bonds, output."""
    fixed = " ".join(str(k + 1) for k in np.flatnonzero(model.types.is_fixed))
    moving = "mobile" if fixed else "all"
    bath = _bath(engine, moving, n_steps)
    # steps between two lines of the log: the largest divisor of every that gives LOOKS lines or more
    most = max(1, min(every, n_steps // LOOKS))
    look_every = max(k for k in range(1, most + 1) if every % k == 0)
    lines = [f"group fixed type {fixed}", "group mobile subtract all fixed"] if fixed else []
    lines += [
        f"reset_timestep {engine.step}",
        f"timestep {engine.method.timestep:.17g}",
        f"fix motion {moving} nve",
    ]
    plane = ["fix plane all enforce2d"] if model.box.is_plane else []
    fixes = "\n".join([*lines, *bath, *held(model), *plane])
    return f"""variable atoms index {ATOMS}
include {FORCES}
{fixes}
thermo_style custom step pe{" f_bath" if bath else ""}
thermo {look_every}
thermo_modify norm no flush yes format float %.17g
dump frames all custom {every} {FRAMES} id xu yu zu vx vy vz
run {n_steps}
write_dump all custom {LAST} id xu yu zu vx vy vz
"""


def held(
    model: Model,
    fix: str = "shake",
    tolerance: float = SHAKE_TOLERANCE,
    most: int = SHAKE_ITERATIONS,
) -> list[str]:
    """Rigid bonds, after all other fixes. Fix rattle is not the default: that of LAMMPS 22 Jul 2025 moves molecules of
    three atoms on the border of two processes wrongly, and dumps velocities with a component along the bonds. The
    positions of SHAKE are those of RATTLE, and so are its velocities after a projection, see handing_over."""
    types = []
    for letter, kinds in (("b", model.rigid_bonds), ("a", model.rigid_angles)):
        if kinds:
            types += [letter, *(str(k + 1) for k in kinds)]
    return [f"fix rigid all {fix} {tolerance} {most} 0 {' '.join(types)}"] if types else []


def _bath(engine: Engine, moving: str, n_steps: int) -> list[str]:
    """The commands of the bath; LAMMPS' temperature is k_B T [energy], at the first and at the last step. Each part of
    a run has its own seed."""
    method: Any = engine.method
    if type(method) not in BATHS or (isinstance(method, LangevinBAOAB) and method.friction == 0.0):
        return []
    source = np.random.SeedSequence(method.seed, spawn_key=(engine.step,))
    seed = 1 + int(source.generate_state(1)[0]) % LARGEST_SEED
    ends = (engine.step, engine.step + n_steps)
    level = method.temperature
    if isinstance(level, Ramp) and any(ends[0] < step < ends[1] for step, _ in level):
        raise ValueError(
            "LAMMPS can change a temperature linearly from the first step of a run, "
            f"{ends[0]}, to its last, {ends[1]}; the temperature is {level!r}: "
            "hand over the parts between its points one by one"
        )
    k_B = engine.system.units.k_B
    heat = words(*(k_B * method.temperature_at(step) for step in ends))
    if isinstance(method, LangevinBAOAB):
        return [f"fix bath {moving} langevin {heat} {1.0 / method.friction:.17g} {seed} tally yes"]
    style, extra = ("temp", 0)
    if engine.conserves_momentum:
        style, extra = ("temp/com", engine.system.dimensions)
    return [
        f"compute heat {moving} {style}",
        f"compute_modify heat extra/dof {extra}",
        f"fix bath {moving} temp/csvr {heat} {method.relaxation_time:.17g} {seed}",
        "fix_modify bath temp heat",
    ]


def per_atom(columns: Array, box: Box) -> Evaluated:
    """Energies, forces and virials of the columns of step 0, turned back; LAMMPS' stress is minus the virial."""
    return Evaluated(columns[:, 0], box.back(columns[:, 1:4]), box.tensors_back(-columns[:, 4:]))
