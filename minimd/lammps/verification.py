"""The verification at step 0: energies, forces, virials of atoms in LAMMPS and minimd, of the scene and a copy."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from minimd.core.console.quiet import quiet
from minimd.core.diagnosis.contacts import bonded_scales, why_not_finite
from minimd.core.engine.engine import Engine
from minimd.core.forces.forces import Forces
from minimd.core.forces.options import Options
from minimd.core.neighbors.queries import closest_pair, neighbor_list
from minimd.core.potentials.pair import Nonbonded
from minimd.core.potentials.term import PER_ATOM
from minimd.core.structure.arrays import Array
from minimd.core.structure.errors import HandOverError, NonFiniteError
from minimd.core.structure.observables import longest
from minimd.core.structure.system import System

TOLERANCE = 1e-10  # of the largest; a scene that differs by more is not handed over
LEAST = 1e-30  # [energy], of a scene without energies
SMALLER = 0.95  # the size of a copy, relative to the one before
SHAKEN = 0.05  # of the skin: displacements of atoms in the copies, in each direction at most
# of the smallest cutoff: after the first copy, none is made whose closest pair is nearer
NEAREST = 0.3
# of the energies, forces and virials of the copy: the scale of those that vanish or cancel in the scene
PART = 0.01


class Verification(NamedTuple):
    """The largest differences at step 0, each relative to the largest of its kind; the worse of scene and copy.
    energy : of the whole scene, relative to Σ|e_i| of the atoms.
    energies, forces, virials : of single atoms, relative to the largest one; forces and virials to the larger of
        both, one being the other at the largest cutoff; where they vanish or cancel, as in a crystal or a dilute gas,
        to what follows from energies or the copy.
    atom : the atom whose force differs most.
    scale : of energies [energy]: Σ|e_i|, or PART of that of the copy if it is larger."""

    energy: float
    energies: float
    forces: float
    virials: float
    atom: int
    scale: float

    @property
    def worst(self) -> float:
        """The largest difference; NaN if one of them is NaN."""
        return float(np.max([self.energy, self.energies, self.forces, self.virials]))

    def __str__(self) -> str:
        if self.scale == 0.0:
            return "nothing was compared: no term has an energy at step 0, nor when all distances are made smaller"
        return (
            f"step 0 agrees within {self.energy:.1e} in the energy, {self.energies:.1e} in those of atoms, "
            f"{self.forces:.1e} in forces, {self.virials:.1e} in virials"
        )

    def check(self, engine: Engine, tolerance: float) -> None:
        """Raise HandOverError if LAMMPS and minimd differ by more than a tolerance."""
        if not self.worst <= tolerance:
            raise HandOverError(
                f"LAMMPS and minimd differ at step 0: energies of atoms by {self.energies:.1e}, forces by "
                f"{self.forces:.1e} (atom {self.atom}), virials by {self.virials:.1e} of the largest; at most "
                f"{tolerance:g} is allowed; the run was not started{on_a_cutoff(engine)}"
            )


def on_a_cutoff(engine: Engine) -> str:
    """A clause about a pair that interacts, on a cutoff at which energy or force jumps; empty if there is none."""
    system = engine.system

    for potential in engine.interactions.potentials:
        if not isinstance(potential, Nonbonded) or potential.cutoff == np.inf:
            continue
        if potential.truncation not in ("truncated", "shifted"):
            continue
        cutoffs = np.sqrt(potential.table(system.species_names)[:, :, 0])
        species = system.species_index * potential.depends_on_species
        reach = cutoffs.max() * (1.0 + TOLERANCE)
        first, second, distances = neighbor_list("ijd", system, reach)
        at = cutoffs[species[first], species[second]]
        scales = bonded_scales(potential, system)

        for k in np.flatnonzero(np.abs(distances - at) <= TOLERANCE * at):
            pair = (int(first[k]), int(second[k]))
            if scales.get(frozenset(pair), 1.0) != 0.0:
                return (
                    f"; atoms {pair[0]} and {pair[1]} are {distances[k]:.10g} apart, on the cutoff of "
                    f"{type(potential).__name__}, where rounding decides whether they interact: change the cutoff, "
                    "or take truncation='force-shifted'"
                )

    return ""


class Evaluated(NamedTuple):
    """For each atom: energies (N,) [energy], forces (N, 3) [energy/length], virials (N, 6) [energy],
    as xx yy zz yz xz xy.
    length : the largest cutoff [length], or 1.
    n_idle : number of potentials without any energy."""

    energies: Array
    forces: Array
    virials: Array
    length: float = 1.0
    n_idle: int = 0


def evaluated(engine: Engine, system: System) -> Evaluated:
    """What minimd computes for single atoms of a system, in double precision, without tail corrections."""
    n = len(system)
    options = Options(skin=0.0, threads=engine.interactions.options.threads)
    energies = np.zeros(n)
    forces = np.zeros((n, 3))
    virials = np.zeros((n, 6))
    lengths = []
    n_idle = 0

    for potential in engine.interactions.potentials:
        with quiet():
            alone = Forces(system, potential, options)
        sums = alone.compute(PER_ATOM)
        tail, virial = alone.tail_corrections()
        own = sums.energies - tail / n
        energies += own
        forces += sums.forces
        virials += sums.virials - np.repeat([virial / (3.0 * n), 0.0], 3)
        if np.isfinite(alone.largest_cutoff):
            lengths.append(alone.largest_cutoff)
        n_idle += not own.any()

    return Evaluated(energies, forces, virials, max(lengths, default=1.0), n_idle)


def in_both(
    engine: Engine, shortest: float, skin: float
) -> tuple[System, tuple[Evaluated, Evaluated]]:
    """A copy of the scene, and what minimd computes in the scene and in the copy.

    In the copy atoms are slightly displaced, which also bends angles. It is made smaller, size by size, until each term
    has an energy in two sizes in succession, so that the energy is not only that of a pair at the cutoff. If no size
    achieves this, the copy is the first one with the smallest number of terms without energy.
    If energies are not finite in any size, it is the scene itself.
    shortest : the smallest cutoff [length].
    skin : [length].
        Raises NonFiniteError if energies or forces of the scene are not finite."""
    system = engine.system
    scene = before = evaluated(engine, system)
    if not (np.isfinite(scene.energies).all() and np.isfinite(scene.forces).all()):
        reason = why_not_finite(system, engine.interactions.potentials)
        raise NonFiniteError(f"forces or energies are not finite: {reason}")
    shaken = np.random.default_rng(0).uniform(-SHAKEN * skin, SHAKEN * skin, system.positions.shape)
    positions = system.cell.wrapped(system.positions) + system.cell.projected(shaken)
    size = 1.0
    least = 0.0
    fewest = np.inf
    chosen = (system, scene)

    while size * SMALLER >= least and fewest > 0:
        size *= SMALLER
        copy = system.copy()
        copy.positions[:] = size * positions
        copy.cell = system.cell.with_vectors(size * system.cell.vectors)
        smaller = evaluated(engine, copy)
        n_idle = max(before.n_idle, smaller.n_idle)
        if n_idle < fewest and np.isfinite(smaller.energies).all():
            fewest = n_idle
            chosen = (copy, smaller)
        before = smaller
        if fewest > 0 and least == 0.0:
            closest = closest_pair(system)
            least = NEAREST * shortest / closest.distance if closest is not None else np.inf

    return chosen[0], (scene, chosen[1])


def compare(ours: tuple[Evaluated, Evaluated], theirs: Iterator[Evaluated]) -> Verification:
    """Compare the numbers of scene and copy.
    Raises HandOverError if those of LAMMPS are missing."""
    rows = []
    atoms = []
    sizes = [float(np.abs(each.energies).sum()) for each in ours]

    for own, size, part in zip(ours, sizes, (PART, 0.0), strict=True):
        other = next(theirs, None)
        if other is None:
            raise HandOverError("LAMMPS has not written step 0; is the disk full?")
        least = [part * _largest(numbers) for numbers in ours[1][:3]]
        energy = max(_largest(own.energies), least[0], LEAST)
        force = max(_largest(own.forces), least[1])
        virial = max(_largest(own.virials), least[2], energy, force * own.length)
        whole = abs(other.energies.sum() - own.energies.sum()) / max(size, energy)
        kinds = zip(own[:3], other[:3], (energy, virial / own.length, virial), strict=True)
        rows.append([whole, *(_largest(b - a) / most for a, b, most in kinds)])
        atoms.append(longest(other.forces - own.forces)[0])

    energy, energies, forces, virials = np.max(rows, axis=0).tolist()
    atom = int(atoms[np.argmax(rows, axis=0)[2]])
    scale = max(sizes[0], PART * sizes[1])
    return Verification(energy, energies, forces, virials, atom, scale)


def _largest(numbers: Array) -> float:
    """The largest magnitude; NaN if a number is NaN."""
    return float(np.abs(numbers).max())
