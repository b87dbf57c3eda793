"""What makes a slab of charges in a periodic cell: one layer in empty space, without the field of its images.

    U = 2π/V (M² − Q Σ qᵢ zᵢ² − Q² H²/12),   F_i = −4π/V qᵢ (M − Q zᵢ) n,   M = Σ qᵢ zᵢ,   Q = Σ qᵢ

z are heights across the layer, along its normal n; H is the height of the cell, V its volume. With a net charge, this
is without any background. What is left, of waves along the layer, falls as exp(−2π g/a): g is the width of the empty
space, a the longer edge along the layer.

Heights begin where the widest empty space ends, at each evaluation: U depends on where atoms are, not on how they are
wrapped, or have come there. They are in units of H, h = z/H. Under a strain of atoms and cell they stay the same: the
virial is W = U (1 − 2 n ⊗ n).

I.-C. Yeh, M. L. Berkowitz, J. Chem. Phys. 111, 3155 (1999); net charges: V. Ballenegger, A. Arnold, J. J. Cerdà,
J. Chem. Phys. 131, 094107 (2009).
"""

from collections import namedtuple
from collections.abc import Iterator
from math import pi

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, called_kernel
from minimd.core.compiled.program import GO_ON, Operation, operation
from minimd.core.potentials.term import FORCES, VOIGT, OwnTerm, Target
from minimd.core.structure.arrays import Array
from minimd.core.structure.errors import RangeError
from minimd.core.structure.system import System
from minimd.core.structure.vectors import dot

BINS = 512  # of the height of the cell, in which atoms are or are not
FULL = 2  # the answer where they are in all of them


class Slab(ByAddress, namedtuple("Slab", "positions charges across filled heights sums forces")):
    """What the term works on.

    positions : (N, 3) [length].
    charges : (N,) [√(energy · length)].
    across : (3,) n/H [1/length].
    filled : (BINS,) whether there are atoms.
    heights : (N,) h.
    sums : (4,) 4π H²/V [1/length]; Σq, Σqh, Σqh².
    forces : (N, 3) output.
    """


@called_kernel
def push_slab(slab, _chunk):
    """Heights and their sums; forces += those of the slab."""
    across = slab.across
    heights = slab.heights
    sums = slab.sums
    slab.filled[:] = 0.0
    for i in range(heights.size):
        r = slab.positions[i]
        h = dot(r, across)
        heights[i] = h - np.floor(h)
        # a bin, even if h is not finite
        slab.filled[min(int(heights[i] * BINS), BINS - 1) % BINS] = 1.0

    widest = 0
    width = 0
    first = 0
    for k in range(2 * BINS):
        width = 0 if slab.filled[k % BINS] else width + 1
        if width > widest:
            widest = width
            first = (k + 1) % BINS
    if widest == 0:
        return FULL

    sums[1:] = 0.0
    for i in range(heights.size):
        if heights[i] * BINS < first:
            heights[i] += 1.0
        moment = slab.charges[i]
        for k in range(1, 4):
            sums[k] += moment
            moment *= heights[i]

    for i in range(heights.size):
        f = sums[0] * slab.charges[i] * (sums[1] * heights[i] - sums[2])
        for d in range(3):
            slab.forces[i, d] += f * across[d]

    return GO_ON


class SlabTerm(OwnTerm):
    """What is added to a sum over waves for a slab.

    charges : (N,) [√(energy · length)].
    axis : "x", "y" or "z", the lattice vector out of the slab.
    """

    name = "Coulomb with slab"

    def __init__(self, system: System, charges: Array, axis: str) -> None:
        self._charges = charges
        self._axis = "xyz".index(axis)
        self._calls = DirectCalls()
        self._across = np.zeros(3)
        self._heights = np.zeros(len(charges))
        self._sums = np.zeros(4)
        self.summary = f"slab across {axis}"
        self.follow(system)

    def follow(self, system: System) -> bool:
        """See Term."""
        vectors = system.cell.vectors
        self._across[:] = np.linalg.inv(vectors)[:, self._axis]
        self._sums[0] = 4.0 * pi / abs(np.linalg.det(vectors)) / (self._across @ self._across)
        return True

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        arrays = self._charges, self._across, np.zeros(BINS), self._heights, self._sums
        slab = Slab(system.positions, *arrays, target.forces)
        yield operation(self._calls, push_slab, slab, python=_refuse)

    def collect(self, target: Target) -> None:
        """See Term: u = −π H²/V q (Σq (h² + 1/6) − 2 h Σqh + Σqh²) is an atom's share."""
        if target.detail == FORCES:
            return
        strength, net, dipole, second = self._sums
        h = self._heights
        potential = net * (h * h + 1.0 / 6.0) - 2.0 * dipole * h + second
        energies = -0.25 * strength * self._charges * potential
        if len(target.energies) == 1:
            energies = energies.sum(keepdims=True)
        n = self._across
        virials = -2.0 * np.outer(n, n)[VOIGT] / (n @ n)
        virials[:3] += 1.0
        target.energies[:] += energies
        target.virials[:] += energies[:, None] * virials


def _refuse(_answer: int) -> None:
    raise RangeError(
        "a slab must lie in empty space, but there are atoms at all heights of the cell: make it higher, or hold them "
        "by walls"
    )
