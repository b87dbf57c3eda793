"""GROMACS: the files that describe a scene, and runs of its program.

The units of a scene take the places of nm, u and kJ/mol.
"""

import os
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import erfcinv

import minimd as md
from minimd.bench.scenes import COULOMB_KJ_NM, BenchScene
from minimd.core.structure.arrays import Array
from minimd.core.structure.constraints import lengths_of

# kJ/mol/ps, the drift per atom that GROMACS allows from its list: its default; and one that is as safe as minimd's list
BUFFER = 0.005
SAFE_BUFFER = 1e-7
# steps of a list: GROMACS' default, and shorter ones for cells without room for its buffer
LIST_STEPS = (10, 5, 2, 1)
# spacing of the mesh · β / accuracy^(1/order), with which pairs and mesh add about as much to the errors of water
SPACING = 2.8
PARAMETERS = """
integrator = md
dt = {timestep:.17g}
nsteps = -1
nstlist = {list_steps}
verlet-buffer-tolerance = {tolerance:.17g}
vdw-modifier = None
rvdw = {cutoff:.17g}
coulombtype = {coulomb}
coulomb-modifier = None
rcoulomb = {cutoff:.17g}
ewald-rtol = {accuracy:.17g}
pme-order = {order}
fourierspacing = {spacing:.17g}
comm-mode = None
continuation = yes
nstfout = 1000000000
nstlog = 1000000000
nstenergy = 1000000000
nstcalcenergy = 1000000000
"""
TOPOLOGY = """
[ defaults ]
1 2 no 1.0 1.0
[ atomtypes ]
{species}
[ moleculetype ]
M 1
[ atoms ]
{atoms}
{rigid}
[ system ]
{name}
[ molecules ]
M {n_molecules}
"""
# of a molecule of three atoms
RIGID = """
[ settles ]
1 1 {bond:.17g} {base:.17g}
[ exclusions ]
1 2 3
2 1 3
3 1 2
"""


class GromacsRun:
    """A run of a scene that can be continued; its files are in a folder that is removed with this object.

    buffer : drift that the list may cause [kJ/mol/ps per atom].
    order : of the mesh for charges.
    name : of the program, with what was chosen.
    forces : (N, 3) at the start, without those of constraints.

    Raises RuntimeError with the words of gmx, if it fails.
    """

    def __init__(self, scene: BenchScene, threads: int, buffer: float, order: int) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="minimd-gromacs-")
        self._place = Path(self._folder.name)
        self._masses = scene.system.masses
        self._threads = threads
        (self._place / "run.gro").write_text(_structure(scene), encoding="utf-8")
        (self._place / "run.top").write_text(_topology(scene), encoding="utf-8")

        for list_steps in LIST_STEPS:
            parameters = _parameters(scene, buffer, order, list_steps)
            (self._place / "run.mdp").write_text(parameters, encoding="utf-8")
            try:
                self._call("grompp", "-f run.mdp -p run.top -c run.gro -o run.tpr -maxwarn 9")
                self.run(0)
                break
            except RuntimeError:
                if list_steps == LIST_STEPS[-1]:
                    raise

        self.forces = np.array(_frame(self._file("trr")).f, dtype=float)
        facts = r"^(?:GROMACS version|SIMD instructions): +(\S+)"
        version, simd = re.findall(facts, self._call("--version"), re.MULTILINE)
        self.name = f"GROMACS {version} {simd}, buffer {buffer:g}, nstlist {list_steps}"
        if scene.error:
            self.name += f", order {order}"

    def _call(self, command: str, options: str = "", answers: str = "") -> str:
        """What gmx prints.
        answers : to its questions."""
        process = subprocess.run(
            ["gmx", "-quiet", command, *options.split()],
            cwd=self._place,
            input=answers,
            capture_output=True,
            text=True,
            env=os.environ | {"GMX_MAXBACKUP": "-1", "GMX_SUPPRESS_DUMP": "1"},
            check=False,
        )
        if process.returncode:
            reason = process.stderr.rpartition("rror:")[2].partition("For more information")[0]
            raise RuntimeError(f"gmx {command} failed: {' '.join(reason.split())}")
        return process.stdout

    def _file(self, ending: str) -> Path:
        """A file of the last part of the run."""
        (file,) = self._place.glob(f"run.part*.{ending}")
        return file

    def run(self, n_steps: int) -> float:
        """Make some steps. Returns the seconds of GROMACS' own clock, without the start of the program."""
        options = f"-deffnm run -s run.tpr -cpo run.cpt -c last.gro -nsteps {n_steps} -noappend"
        if (self._place / "run.cpt").exists():
            options += " -cpi run.cpt"
        for old in self._place.glob("run.part*"):
            old.unlink()
        self._call("mdrun", f"{options} -ntmpi 1 -ntomp {self._threads} -nb cpu")
        log = self._file("log").read_text(encoding="utf-8", errors="replace")
        return float(re.findall(r"^ +Time: +\S+ +(\S+)", log, re.MULTILINE)[-1])

    def potential_energy(self) -> float:
        """Of the present state."""
        self.run(0)
        self._call("energy", f"-f {self._file('edr').name} -o run.xvg -dp", "Potential\n\n")
        return float((self._place / "run.xvg").read_text(encoding="utf-8").split()[-1])

    def total_energy(self) -> float:
        """Of the present state, from the mean of velocities half a step before and after; it makes a step."""
        potential = self.potential_energy()
        before = self._velocities()
        self.run(1)
        velocities = 0.5 * (before + self._velocities())
        return potential + 0.5 * float(self._masses @ (velocities**2).sum(axis=1))

    def _velocities(self) -> Array:
        """(N, 3), half a step before the present state."""
        self._call("trjconv", "-f run.cpt -o last.trr")
        return np.array(_frame(self._place / "last.trr").v, dtype=float)


def _frame(file: Path) -> Any:
    """The first of a trajectory."""
    from MDAnalysis.lib.formats.libmdaxdr import TRRFile

    with TRRFile(str(file)) as trajectory:
        return trajectory.read()


def _structure(scene: BenchScene) -> str:
    """Positions and velocities, with nine and ten decimals instead of three and four; velocities half a step earlier,
    as leapfrog needs them."""
    start = scene.system
    back = start.copy()
    back.velocities[:] *= -1.0
    simulation = md.Simulation(back, scene.potentials, scene.method, scene.constraints)
    simulation.run(1, progress=False)
    velocities = (start.positions - simulation.positions) / scene.method.timestep
    line = "%5dM    %5s%5d" + 3 * "%14.9f" + 3 * "%14.10f"
    lines = [scene.name, str(len(start))]
    for k, numbers in enumerate(np.hstack([start.positions, velocities]).tolist(), start=1):
        lines.append(line % (k % 100000, "A", k % 100000, *numbers))
    lines += [" ".join(f"{edge:.12f}" for edge in scene.edges), ""]
    return "\n".join(lines)


def _topology(scene: BenchScene) -> str:
    """Wells, charges, masses and rigid lengths. All molecules are alike: of one atom, or of three if they are rigid."""
    system = scene.system
    names = system.species_names
    wells = scene.law.table(names).diagonal()[-2:].T  # ε, σ of each species
    wells = np.broadcast_to(wells, (len(names), 2))
    charges = system.charges * np.sqrt(system.units.coulomb / COULOMB_KJ_NM)
    species = [
        f"{name} 0 1.0 0.0 A {sigma:.17g} {epsilon:.17g}"
        for name, (epsilon, sigma) in zip(names, wells.tolist(), strict=True)
    ]
    size = 1
    rigid = ""

    for constraints in scene.constraints:
        lengths = lengths_of(system.positions, system.cell, constraints)
        size = 3
        rigid = RIGID.format(bond=lengths.min(), base=lengths.max())

    atoms = [
        f"{k + 1} {system.species[k]} 1 M A {k + 1} {charges[k]:.17g} {system.masses[k]:.17g}"
        for k in range(size)
    ]
    return TOPOLOGY.format(
        species="\n".join(species),
        atoms="\n".join(atoms),
        rigid=rigid,
        name=scene.name,
        n_molecules=len(system) // size,
    )


def _parameters(scene: BenchScene, buffer: float, order: int, list_steps: int) -> str:
    units = scene.system.units
    cutoff = scene.law.cutoff
    splitting = erfcinv(scene.accuracy) / cutoff  # β
    return PARAMETERS.format(
        timestep=scene.method.timestep,
        list_steps=list_steps,
        tolerance=buffer * units.to_picosecond / units.to_kj_per_mol,
        cutoff=cutoff,
        coulomb="PME" if scene.error else "Cut-off",
        accuracy=scene.accuracy,
        order=order,
        spacing=SPACING * scene.accuracy ** (1.0 / order) / splitting,
    )
