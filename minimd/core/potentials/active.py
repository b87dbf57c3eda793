"""Active particles: each is pushed by a force of its own, along a direction that turns at random."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import exp, log, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.core.compiled.normal_numbers import OF_DIRECTIONS, philox
from minimd.core.potentials import declared as kind
from minimd.core.potentials.declared import NOT_NEGATIVE, POSITIVE, declared
from minimd.core.potentials.fields import ATOMS, OnAtoms
from minimd.core.potentials.term import Term
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.system import System

TIME, TURNS, DIRECTIONS = 0, 1, 2  # places in the memory

LEAST_KEPT = 1e-300  # its logarithm is finite

Turn = Callable[[Array, float, np.random.Generator], Array]


def diffused(directions: Array, kept: float, noise: np.random.Generator) -> Array:
    """Unit vectors (n, d) after a rotation about random axes, through angles of which the mean cosine is `kept`, in
    space to third order in 1 − kept."""
    pushes = noise.standard_normal(directions.shape)
    pushes -= (pushes * directions).sum(axis=1, keepdims=True) * directions
    lengths = np.linalg.norm(pushes, axis=1, keepdims=True)
    lost = 1.0 - kept
    angles = sqrt(lost * (1.0 + lost / 3.0)) * lengths
    if directions.shape[1] == 2:
        angles = sqrt(-2.0 * log(max(kept, LEAST_KEPT))) * lengths
    turned = np.cos(angles) * directions + np.sin(angles) * pushes / np.maximum(lengths, 1e-300)
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def tumbled(directions: Array, kept: float, noise: np.random.Generator) -> Array:
    """Unit vectors of which each is drawn again with the probability 1 − kept."""
    new = noise.standard_normal(directions.shape)
    new /= np.linalg.norm(new, axis=1, keepdims=True)
    return np.where(noise.random((len(new), 1)) < kept, directions, new)


def relaxed(directions: Array, kept: float, noise: np.random.Generator) -> Array:
    """Vectors after a step of the Ornstein-Uhlenbeck process, with a mean square length of 1."""
    spread = sqrt((1.0 - kept * kept) / directions.shape[1])
    return kept * directions + spread * noise.standard_normal(directions.shape)


REORIENTATIONS: Mapping[str, Turn] = {
    "diffusion": diffused,
    "tumble": tumbled,
    "ornstein-uhlenbeck": relaxed,
}


class ActiveForce(OnAtoms):
    """Self-propulsion: a force f e on each atom, along a direction e that forgets itself, ⟨e(0)·e(t)⟩ = e^(−t/τ).

    reorientation says how e turns:

        "diffusion"             on the unit sphere, with the rotational diffusion constant D_r = 1/(2τ), or on the
                                unit circle of a plane, with D_r = 1/τ
        "tumble"                drawn anew at random times, 1/τ in a unit of time (run and tumble)
        "ornstein-uhlenbeck"    each component is a Gaussian process, ⟨e²⟩ = 1

    A free particle with the friction γ and the mass m runs at v = f/(mγ) and has

        D_eff = D + v² τ/d

    in d dimensions.
    Directions at the start are random. They are kept in restarts; they turn with the clock of the simulation, and stay
    where it goes back. Noise depends on seed and step alone. The force has no energy: the report says that its work
    is not counted.

    M. E. Cates, J. Tailleur, Annu. Rev. Condens. Matter Phys. 6, 219 (2015).
    """

    force: ArrayLike = declared(kind.each, "f", "force", NOT_NEGATIVE)
    persistence_time: float = declared(kind.number, "τ", "time", POSITIVE)
    seed: int = declared(kind.seed, "selects the directions")
    reorientation: str = declared(
        kind.choice, "how directions turn", of=REORIENTATIONS, default="diffusion"
    )
    atoms: ArrayLike | None = ATOMS

    def bind(self, system: System) -> Term:
        """The term of these forces in a system.
        Raises ValueError if atoms, or their forces, are missing."""
        acting = self.atoms_in(system)
        (sizes,) = self.columns("atoms", len(acting))
        return ActiveTerm(acting, sizes, self, system.dimensions)


class ActiveTerm(Term):
    """Active forces on some atoms.
    acting : (n,) int.
    sizes : (n,) f [energy/length].
    memory : (2 + dn,) the time to which directions belong, how often they have turned, and their components."""

    acts_from_outside = True
    depends_on_time = True
    is_checked = False

    def __init__(self, acting: Indices, sizes: Array, of: ActiveForce, dimensions: int) -> None:
        self.memory = np.zeros(DIRECTIONS + dimensions * len(acting))
        self._dimensions = dimensions
        self._acting = acting
        self._sizes = sizes[:, None]
        self._of = of
        self._turn = REORIENTATIONS[of.reorientation]

    def add(
        self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray
    ) -> None:
        """See Term."""
        forces[self._acting, : self._dimensions] += self._sizes * self.directions()

    def directions(self) -> Array:
        """e of each atom, (n, d), at the time of the term."""
        memory: Any = self.memory
        directions = memory[DIRECTIONS:].reshape(-1, self._dimensions)
        n_turns = int(memory[TURNS])
        duration = self.time - memory[TIME]
        if n_turns and not duration > 0.0:
            return directions
        noise = philox(self._of.seed, OF_DIRECTIONS, n_turns)
        turn, kept = self._turn, exp(-duration / self._of.persistence_time)
        if n_turns == 0:
            directions[:] = 1.0
            turn, kept = (relaxed if turn is relaxed else tumbled), 0.0
        directions[:] = turn(directions, kept, noise)
        memory[:DIRECTIONS] = self.time, n_turns + 1
        return directions
