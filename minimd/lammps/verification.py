"""Step 0 twice: energy, force and virial of each atom, by LAMMPS and by minimd."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.engine.engine import Engine
from minimd.forces.forces import Forces
from minimd.forces.options import Options
from minimd.neighbors.queries import closest_pair
from minimd.potentials.term import PER_ATOM, bound
from minimd.structure.cell import Cell
from minimd.structure.errors import HandOverError, NonFiniteError
from minimd.structure.observables import longest
from minimd.structure.system import System

TOLERANCE = 1e-10  # of the largest, above which a scene is not handed over
ROUNDING = 1e-13  # of the largest: a difference up to which nobody asks whether forces cancel
LEAST = 1e-30  # [energy], of a scene without energies
STRAIN, PART = 0.01, 0.01  # springs at rest have no forces but rounding: this part of what such a strain makes counts as large too

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Verification:
    """The largest differences at step 0, each relative to the largest of its kind.

    energy : of the whole scene, relative to Σ|e_i| of the atoms.  energies, forces, virials : of single atoms, relative to the largest one;
    where they cancel, as in a crystal or in springs at rest, to what its energies, or a small strain, make.  atom : with the worst force.
    """

    energy: float
    energies: float
    forces: float
    virials: float
    atom: int

    @property
    def worst(self) -> float:
        """The largest of them; NaN if one is."""
        return float(np.max([self.energy, self.energies, self.forces, self.virials]))

    def __str__(self) -> str:
        figures = (f"{self.energy:.1e} in the energy", f"{self.energies:.1e} in those of atoms", f"{self.forces:.1e} in forces")
        return f"step 0 agrees within {', '.join(figures)}, {self.virials:.1e} in virials"

    def check(self) -> None:
        """Raise HandOverError if LAMMPS and minimd differ by more than TOLERANCE."""
        if not self.worst <= TOLERANCE:
            where = f"energies of atoms by {self.energies:.1e}, forces by {self.forces:.1e} (atom {self.atom}), virials by {self.virials:.1e}"
            raise HandOverError(f"LAMMPS and minimd differ at step 0: {where} of the largest, allowed is {TOLERANCE:g}; nothing was run")


def compare(engine: Engine, energies: Array, forces: Array, virials: Array) -> Verification:
    """Those of LAMMPS, (N,), (N, 3), (N, 6) as xx yy zz yz xz xy, beside minimd's in double precision, without tail corrections.

    What a strain makes is evaluated only where the differences are more than rounding of the forces as they are.
    Raises NonFiniteError if those of minimd are not finite.
    """
    ours = evaluated(engine, engine.system)
    tails = tails_of(engine) / len(energies)
    ours.energies[:] -= tails[0]
    ours.virials[:] -= np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * tails[1] / 3.0
    if not (np.isfinite(ours.energies).all() and np.isfinite(ours.forces).all()):
        raise NonFiniteError(f"forces or energies are not finite; the closest pair is {closest_pair(engine.system)}: move them apart")
    theirs = Evaluated(energies, forces, virials, ours.length)
    found = _compared(theirs, ours, (0.0, 0.0, 0.0))
    if found.worst <= ROUNDING:
        return found
    strained = evaluated(engine, dilated(engine.system))
    return _compared(theirs, ours, tuple(map(strain_makes, (strained.energies, strained.forces, strained.virials))))


def _compared(theirs: Evaluated, ours: Evaluated, least: tuple[float, ...]) -> Verification:
    """least : an energy, a force and a virial of an atom that count as large, even if all are smaller."""
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
    """Of each atom: energies (N,) [energy], forces (N, 3) [energy/length], virials (N, 6) [energy].  length : over which energies change [length]."""

    energies: Array
    forces: Array
    virials: Array
    length: float


def evaluated(engine: Engine, system: System) -> Evaluated:
    """The forces on a system, with those of single atoms, as minimd computes them in double precision."""
    forces = Forces(system, engine.interactions.potentials, Options(skin=0.0, threads=engine.interactions.options.threads))
    forces.compute(PER_ATOM)
    return Evaluated(forces.energies, forces.forces, forces.virials, forces.largest_cutoff if np.isfinite(forces.largest_cutoff) else 1.0)


def strain_makes(numbers: Array) -> float:
    """PART of the largest size; 0 if a number is none."""
    return PART * _largest(numbers) if np.isfinite(numbers).all() else 0.0


def dilated(system: System) -> System:
    """The same atoms and cell, larger by STRAIN."""
    larger = system.copy()
    larger.positions[:] *= 1.0 + STRAIN
    larger.cell = Cell.of((1.0 + STRAIN) * system.cell.vectors, system.cell.pbc)
    return larger


def tails_of(engine: Engine) -> Array:
    """Energy and trace of the virial of all tail corrections [energy], (2,), which LAMMPS is not asked for."""
    terms = (bound(one, engine.system) for one in engine.interactions.potentials)
    return np.sum([term.tail(engine.system) for term in terms], axis=0)


def _largest(numbers: Array) -> float:
    """The largest size; NaN if a number is none."""
    return float(np.abs(numbers).max())
