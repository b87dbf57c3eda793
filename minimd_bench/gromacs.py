"""GROMACS, if its program gmx is on the path: an engine with which `minimd bench` compares minimd.

Each run is a process.

nm, u, ps and kJ/mol stand for σ, m, τ and ε here, so that the numbers of a scene in reduced units do not change.
"""

import os
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from MDAnalysis import Universe

import minimd as md
from minimd_bench.scenes import CUTOFF, BenchScene

PROGRAM = "gmx"
# kJ/mol/ps, the drift that GROMACS allows from its list; with the default, 0.005, it drifts a thousand times more than
# minimd
BUFFER = 1e-7
NEVER = 10**9  # steps
PARAMETERS = f"""
integrator = md
dt = {{timestep:.17g}}
nsteps = -1
cutoff-scheme = Verlet
verlet-buffer-tolerance = {BUFFER:g}
vdwtype = Cut-off
vdw-modifier = None
rvdw = {CUTOFF}
coulombtype = Cut-off
rcoulomb = {CUTOFF}
comm-mode = None
continuation = yes
nstlog = {NEVER}
nstenergy = {NEVER}
nstcalcenergy = {NEVER}
"""
TOPOLOGY = """
[ defaults ]
1 1 no 1.0 1.0

[ atomtypes ]
A 18 1.0 0.0 A 4.0 4.0  ; 4 ε σ⁶ and 4 ε σ¹²

[ moleculetype ]
A 1

[ atoms ]
1 A 1 A A 1 0.0 1.0

[ system ]
melt

[ molecules ]
A {n_atoms}
"""


class Gromacs:
    """GROMACS' leapfrog in mixed precision, with a list that is as safe as minimd's;
    see minimd_bench.engines.TimedEngine."""

    precision = "mixed"

    def __init__(self, scene: BenchScene, threads: int, timestep: float) -> None:
        self.name, self.threads = f"GROMACS, buffer {BUFFER:g}", threads
        self._scene, self._timestep = scene, timestep
        self._folder = tempfile.TemporaryDirectory(prefix="minimd-gromacs-")  # removed with this object
        self._write("run.mdp", PARAMETERS.format(timestep=timestep))
        self._write("run.top", TOPOLOGY.format(n_atoms=len(scene.system)))
        self._write("run.gro", _structure(scene, timestep))
        self._call("grompp", "-f", "run.mdp", "-p", "run.top", "-c", "run.gro", "-o", "run.tpr", "-maxwarn", "9")

    def potential_energy(self) -> float:
        """See TimedEngine."""
        return self._energies()[0]

    def total_energy(self) -> float:
        """See TimedEngine."""
        potential, kinetic = self._energies()
        last = max(Path(self._folder.name).glob("last.part*.gro"))
        # in nm; the three decimals of the file are enough for the small term below
        positions = Universe(str(last)).atoms.positions / 10.0
        forces = md.evaluate(
            md.System(positions, cell=self._scene.edges, species=self._scene.system.species), self._scene.potentials
        ).forces
        # GROMACS' K is the mean of those half a step before and after
        return potential + kinetic - 0.125 * self._timestep**2 * float(np.sum(forces**2))

    def run(self, n_steps: int) -> float:
        """Make n_steps steps; returns the seconds that they took by GROMACS' own clock,
        without the start of the program."""
        before = ("-cpi", "run.cpt") if Path(self._folder.name, "run.cpt").exists() else ()
        options = ("-nsteps", str(n_steps), "-ntmpi", "1", "-ntomp", str(self.threads), "-nb", "cpu", "-noappend")
        for old in Path(self._folder.name).glob("run.part*"):
            old.unlink()
        self._call("mdrun", "-s", "run.tpr", "-deffnm", "run", "-cpo", "run.cpt", "-c", "last.gro", *before, *options)
        (log,) = Path(self._folder.name).glob("run.part*.log")
        return float(re.findall(r"^ +Time: +\S+ +(\S+)", log.read_text(encoding="utf-8", errors="replace"), re.M)[-1])

    def _energies(self) -> list[float]:
        """Potential and kinetic energy [ε]."""
        self.run(0)
        (file,) = Path(self._folder.name).glob("run.part*.edr")
        self._call("energy", "-f", file.name, "-o", "run.xvg", "-dp", given="Potential\nKinetic-En.\n\n")
        last = Path(self._folder.name, "run.xvg").read_text(encoding="utf-8").splitlines()[-1]
        return [float(number) for number in last.split()[1:]]

    def _write(self, name: str, text: str) -> None:
        Path(self._folder.name, name).write_text(text, encoding="utf-8")

    def _call(self, command: str, *arguments: str, given: str = "") -> None:
        """Call gmx.  Raises RuntimeError with the last words that it printed, if it fails."""
        environment = os.environ | {"GMX_MAXBACKUP": "-1", "GMX_SUPPRESS_DUMP": "1"}
        words = [PROGRAM, "-quiet", command, *arguments]
        answer = subprocess.run(
            words, cwd=self._folder.name, input=given, capture_output=True, text=True, env=environment, check=False
        )
        if answer.returncode:
            raise RuntimeError(f"gmx {command} failed: {' '.join(answer.stderr.split()[-40:])}")


def _structure(scene: BenchScene, timestep: float) -> str:
    """The scene as a file of GROMACS: with nine decimals instead of three, and velocities half a step earlier,
    as needed by leapfrog."""
    system = scene.system
    velocities = system.velocities - 0.5 * timestep * md.evaluate(system, scene.potentials).forces
    wrapped = system.positions - np.floor(system.positions / scene.edges) * scene.edges
    name = f"A    {'A':>5s}"
    lines = []
    for k, (place, velocity) in enumerate(zip(wrapped, velocities, strict=True), start=1):
        numbers = "".join(f"{x:14.9f}" for x in place) + "".join(f"{v:14.10f}" for v in velocity)
        lines.append(f"{k % 100000:5d}{name}{k % 100000:5d}{numbers}")
    return "\n".join(["melt", str(len(system)), *lines, " ".join(f"{edge:.12f}" for edge in scene.edges)]) + "\n"
