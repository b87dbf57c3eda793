"""Step 0 twice: energy, force and virial of each atom, by LAMMPS and by minimd."""

from __future__ import annotations

from dataclasses import dataclass

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

    Raises NonFiniteError if those of minimd are not finite.
    """
    system = engine.system
    ours, strained = evaluated(engine, system), evaluated(engine, dilated(system))
    tails = tails_of(engine) / len(energies)
    own_energies, own_virials = ours.energies - tails[0], ours.virials - np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * tails[1] / 3.0
    if not (np.isfinite(own_energies).all() and np.isfinite(ours.forces).all()):
        raise NonFiniteError(f"forces or energies are not finite; the closest pair is {closest_pair(system)}: move them apart")
    atom, _ = longest(forces - ours.forces)
    largest = max(_largest(own_energies), strain_makes(strained.energies), LEAST)
    force = max(_largest(ours.forces), strain_makes(strained.forces), largest / _length(ours))
    return Verification(
        energy=abs(float(energies.sum() - own_energies.sum())) / max(float(np.abs(own_energies).sum()), largest),
        energies=_largest(energies - own_energies) / largest,
        forces=_largest(forces - ours.forces) / force,
        virials=_largest(virials - own_virials) / max(_largest(own_virials), strain_makes(strained.virials), largest),
        atom=atom,
    )


def evaluated(engine: Engine, system: System) -> Forces:
    """The forces on a system, with those of single atoms, as minimd computes them in double precision."""
    forces = Forces(system, engine.interactions.potentials, Options(skin=0.0, threads=engine.interactions.options.threads))
    forces.compute(PER_ATOM)
    return forces


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


def _length(forces: Forces) -> float:
    """The length over which energies change [length]: the largest cutoff, or 1."""
    return forces.largest_cutoff if np.isfinite(forces.largest_cutoff) else 1.0


def _largest(numbers: Array) -> float:
    """The largest size; NaN if a number is none."""
    return float(np.abs(numbers).max())
