"""Step 0 twice: energy, force and virial of each atom, by LAMMPS and by minimd."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minimd.engine.engine import Engine
from minimd.forces.forces import Forces
from minimd.forces.options import Options
from minimd.potentials.term import PER_ATOM, bound
from minimd.structure.errors import HandOverError
from minimd.structure.observables import longest

TOLERANCE = 1e-10  # of the largest, above which a scene is not handed over
LEAST = 1e-30  # [energy], of a scene without energies

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Verification:
    """The largest differences at step 0, each relative to the largest of its kind.

    energy : of the whole scene, relative to Σ|e_i| of the atoms.  energies, forces, virials : of single atoms, relative to the largest one;
    where forces or virials cancel, as in a crystal, to those that the largest energy of an atom makes over its cutoff.  atom : with the worst force.
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
    """Those of LAMMPS, (N,), (N, 3), (N, 6) as xx yy zz yz xz xy, beside minimd's in double precision, without tail corrections."""
    ours = Forces(engine.system, engine.interactions.potentials, Options(skin=0.0, threads=engine.interactions.options.threads))
    ours.compute(PER_ATOM)
    tails = tails_of(engine) / len(energies)
    own_energies, own_virials = ours.energies - tails[0], ours.virials - np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * tails[1] / 3.0
    largest = max(float(np.abs(own_energies).max()), LEAST)
    atom, _ = longest(forces - ours.forces)
    force = max(float(np.abs(ours.forces).max()), largest / _length(ours))
    return Verification(
        energy=abs(float(energies.sum() - own_energies.sum())) / max(float(np.abs(own_energies).sum()), LEAST),
        energies=_apart(energies, own_energies) / largest,
        forces=_apart(forces, ours.forces) / force,
        virials=_apart(virials, own_virials) / max(float(np.abs(own_virials).max()), largest),
        atom=atom,
    )


def tails_of(engine: Engine) -> Array:
    """Energy and trace of the virial of all tail corrections [energy], (2,), which LAMMPS is not asked for."""
    terms = (bound(one, engine.system) for one in engine.interactions.potentials)
    return np.sum([term.tail(engine.system) for term in terms], axis=0)


def _length(forces: Forces) -> float:
    """The length over which energies change [length]: the largest cutoff, or 1."""
    return forces.largest_cutoff if np.isfinite(forces.largest_cutoff) else 1.0


def _apart(one: Array, other: Array) -> float:
    """The largest difference; NaN if a number is none."""
    return float(np.abs(one - other).max())
