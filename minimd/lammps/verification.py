"""The verification at step 0: energy, force and virial of each atom, computed by LAMMPS and by minimd."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.engine.engine import Engine
from minimd.forces.contacts import why_not_finite
from minimd.forces.forces import Forces
from minimd.forces.options import Options
from minimd.potentials.term import PER_ATOM, bound
from minimd.structure.cell import Cell
from minimd.structure.errors import HandOverError, NonFiniteError
from minimd.structure.observables import longest
from minimd.structure.system import System

TOLERANCE = 1e-10  # of the largest; a scene that differs by more is not handed over
ROUNDING = 1e-13  # of the largest: for smaller differences, the effect of a strain is not needed
LEAST = 1e-30  # [energy], of a scene without energies
STRAIN, PART = 0.01, 0.01  # forces of springs at rest are only rounding; then this part of the forces after such a strain is the scale

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Verification:
    """The largest differences at step 0, each relative to the largest of its kind.

    energy : of the whole scene, relative to Σ|e_i| of the atoms.  energies, forces, virials : of single atoms, relative to the largest one;
    if forces cancel, as in a crystal or in springs at rest, relative to what follows from energies or from a small strain.
    atom : the atom whose force differs most.
    """

    energy: float
    energies: float
    forces: float
    virials: float
    atom: int

    @property
    def worst(self) -> float:
        """The largest difference; NaN if one of them is NaN."""
        return float(np.max([self.energy, self.energies, self.forces, self.virials]))

    def __str__(self) -> str:
        figures = (f"{self.energy:.1e} in the energy", f"{self.energies:.1e} in those of atoms", f"{self.forces:.1e} in forces")
        return f"step 0 agrees within {', '.join(figures)}, {self.virials:.1e} in virials"

    def check(self) -> None:
        """Raise HandOverError if LAMMPS and minimd differ by more than TOLERANCE."""
        if not self.worst <= TOLERANCE:
            where = f"energies of atoms by {self.energies:.1e}, forces by {self.forces:.1e} (atom {self.atom}), virials by {self.virials:.1e}"
            raise HandOverError(f"LAMMPS and minimd differ at step 0: {where} of the largest, allowed is {TOLERANCE:g}; the run was not started")


def compare(engine: Engine, energies: Array, forces: Array, virials: Array) -> Verification:
    """Compare energies (N,), forces (N, 3) and virials (N, 6), as xx yy zz yz xz xy, of LAMMPS with those of minimd in double precision.

    Tail corrections are left out. The scene after a strain is evaluated only if the differences exceed rounding of the present forces.
    Raises NonFiniteError if energies or forces of minimd are not finite.
    """
    ours = evaluated(engine, engine.system)
    tails = tails_of(engine) / len(energies)
    ours.energies[:] -= tails[0]
    ours.virials[:] -= np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * tails[1] / 3.0
    if not (np.isfinite(ours.energies).all() and np.isfinite(ours.forces).all()):
        raise NonFiniteError(f"forces or energies are not finite: {why_not_finite(engine.system, engine.interactions.potentials)}")
    theirs = Evaluated(energies, forces, virials, ours.length)
    found = _compared(theirs, ours, (0.0, 0.0, 0.0))
    if found.worst <= ROUNDING:
        return found
    strained = evaluated(engine, dilated(engine.system))
    return _compared(theirs, ours, tuple(map(strain_makes, (strained.energies, strained.forces, strained.virials))))


def _compared(theirs: Evaluated, ours: Evaluated, least: tuple[float, ...]) -> Verification:
    """The differences.  least : energy, force and virial of an atom that are used as scale if all of the scene are smaller."""
    atom, _ = longest(theirs.forces - ours.forces)
    largest = max(_largest(ours.energies), least[0], LEAST)
    force = max(_largest(ours.forces), least[1], largest / ours.length)
    return Verification(
        energy=abs(float(theirs.energies.sum() - ours.energies.sum())) / max(float(np.abs(ours.energies).sum()), largest),
        energies=_largest(theirs.energies - ours.energies) / largest,
        forces=_largest(theirs.forces - ours.forces) / force,
        virials=_largest(theirs.virials - ours.virials) / max(_largest(ours.virials), least[2], largest),
        atom=atom,
    )


class Evaluated(NamedTuple):
    """For each atom: energies (N,) [energy], forces (N, 3) [energy/length], virials (N, 6) [energy].  length : the largest cutoff [length], or 1."""

    energies: Array
    forces: Array
    virials: Array
    length: float


def evaluated(engine: Engine, system: System) -> Evaluated:
    """Energies, forces and virials of single atoms of a system, as minimd computes them in double precision."""
    forces = Forces(system, engine.interactions.potentials, Options(skin=0.0, threads=engine.interactions.options.threads))
    forces.compute(PER_ATOM)
    return Evaluated(forces.energies, forces.forces, forces.virials, forces.largest_cutoff if np.isfinite(forces.largest_cutoff) else 1.0)


def strain_makes(numbers: Array) -> float:
    """PART of the largest magnitude; 0 if a number is not finite."""
    return PART * _largest(numbers) if np.isfinite(numbers).all() else 0.0


def dilated(system: System) -> System:
    """The same atoms and cell, stretched by STRAIN."""
    larger = system.copy()
    larger.positions[:] *= 1.0 + STRAIN
    larger.cell = Cell.of((1.0 + STRAIN) * system.cell.vectors, system.cell.pbc)
    return larger


def tails_of(engine: Engine) -> Array:
    """Energy and trace of the virial of all tail corrections [energy], (2,); LAMMPS does not compute them."""
    terms = (bound(one, engine.system) for one in engine.interactions.potentials)
    return np.sum([term.tail(engine.system) for term in terms], axis=0)


def _largest(numbers: Array) -> float:
    """The largest magnitude; NaN if a number is NaN."""
    return float(np.abs(numbers).max())
