"""What makes a slab of charges in a periodic cell: one layer in empty space, without the field of its images.

    U = 2π/V (M² − Q Σ qᵢ zᵢ² − Q² H²/12),   F_i = −4π/V qᵢ (M − Q zᵢ) n,   M = Σ qᵢ zᵢ,   Q = Σ qᵢ

z are heights across the layer, along its normal n; H is the height of the cell, V its volume. With a net charge, this
is without any background. What is left, of waves along the layer, falls as exp(−2π g/a): g is the width of the empty
space, a the longer edge along the layer.

Heights begin where the widest empty space ends, at each evaluation: U depends on where atoms are, not on how they are
wrapped, or have come there. They are in units of H, h = z/H. Under a strain of atoms and cell they stay the same: the
virial is W = U (1 − 2 n ⊗ n).

In a cell that is open across the layer, heights begin at the lowest charge, and waves have a periodic cell of their
own, whose H is the thickness of the layer, rounded up, and the empty space that the accuracy needs.

I.-C. Yeh, M. L. Berkowitz, J. Chem. Phys. 111, 3155 (1999); net charges: V. Ballenegger, A. Arnold, J. J. Cerdà,
J. Chem. Phys. 131, 094107 (2009).
"""

from collections import namedtuple
from collections.abc import Iterator
from copy import copy
from math import ceil, pi
from typing import Any

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, called_kernel
from minimd.core.compiled.program import GO_ON, Operation, in_python, operation
from minimd.core.forces.mesh_sum import MeshSum, charge_sum
from minimd.core.potentials.coulomb import empty_space
from minimd.core.potentials.prolates import Split
from minimd.core.potentials.term import FORCES, VOIGT, OwnTerm, Target
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import Cell
from minimd.core.structure.errors import RangeError
from minimd.core.structure.system import System
from minimd.core.structure.vectors import dot

BINS = 512  # of the height of the cell, in which atoms are or are not
FULL = 2  # the answer where they are in all of them
STEP = 0.25  # of the empty space: the steps in which the cell follows the thickness
FIRST = 4  # of these steps: a layer for which the quicker sum is chosen, whatever its thickness comes to be


class Heights(ByAddress, namedtuple("Heights", "positions across filled heights")):
    """Where atoms are.

    positions : (N, 3) [length].
    across : (3,) n/H [1/length].
    filled : (BINS,) output: whether there are atoms.
    heights : (N,) output: h.
    """


class Slab(ByAddress, namedtuple("Slab", "charges across heights sums forces")):
    """What the term works on.

    charges : (N,) [√(energy · length)].
    across : (3,) n/H [1/length].
    heights : (N,) h.
    sums : (4,) 4π H²/V [1/length]; output: Σq, Σqh, Σqh².
    forces : (N, 3) output.
    """


@called_kernel
def find_heights(where, _chunk):
    """Heights from the end of the widest empty space on."""
    heights = where.heights
    filled = where.filled
    filled[:] = 0.0
    for i in range(heights.size):
        h = dot(where.positions[i], where.across)
        heights[i] = h - np.floor(h)
        # a bin, even if h is not finite
        filled[min(int(heights[i] * BINS), BINS - 1) % BINS] = 1.0

    widest = 0
    width = 0
    first = 0
    for k in range(2 * BINS):
        width = 0 if filled[k % BINS] else width + 1
        if width > widest:
            widest = width
            first = (k + 1) % BINS
    if widest == 0:
        return FULL

    for i in range(heights.size):
        if heights[i] * BINS < first:
            heights[i] += 1.0

    return GO_ON


@called_kernel
def push_slab(slab, _chunk):
    """Sums; forces += those of the slab."""
    across = slab.across
    heights = slab.heights
    sums = slab.sums
    sums[1:] = 0.0
    for i in range(heights.size):
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
    heights : (N,) h, of the last evaluation.
    """

    name = "Coulomb with slab"

    def __init__(self, system: System, charges: Array, axis: str) -> None:
        self._charges = charges
        self._axis = "xyz".index(axis)
        self._calls = DirectCalls()
        self._across = np.zeros(3)
        self.heights = np.zeros(len(charges))
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
        where = Heights(system.positions, self._across, np.zeros(BINS), self.heights)
        yield operation(self._calls, find_heights, where, python=_refuse)
        yield self.push(target)

    def push(self, target: Target) -> Operation:
        """What is done once heights are known."""
        slab = Slab(self._charges, self._across, self.heights, self._sums, target.forces)
        return operation(self._calls, push_slab, slab)

    def collect(self, target: Target) -> None:
        """See Term: u = −π H²/V q (Σq (h² + 1/6) − 2 h Σqh + Σqh²) is an atom's share."""
        if target.detail == FORCES:
            return
        strength, net, dipole, second = self._sums
        h = self.heights
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


class OpenSlabTerm(OwnTerm):
    """A slab in a cell that is open across it: a sum over waves, and what is added to it, in a taller cell.

    That follows the slab up and down: energies depend on where atoms are, not on how they have come there.
    split, method, is_fixed : see charge_sum.
    version : of the memory.
    """

    name = SlabTerm.name

    def __init__(
        self,
        system: System,
        charges: Array,
        axis: str,
        split: Split,
        method: str,
        is_fixed: bool,
    ) -> None:
        self._taller = copy(system)  # with the same positions
        self._lattice = system.cell.lattice
        self._charges = charges
        self._axis = axis
        self._open = "xyz".index(axis)
        self._how: list[Any] = [split, method, is_fixed]
        self._empty = max(empty_space(self._lattice, self._open, split.bound), split.cutoff)
        self.version = 0
        self._take(FIRST)
        # a program always has as many operations
        self._how[1] = "mesh" if isinstance(self._sum, MeshSum) else "waves"

    def _take(self, n_steps: int) -> None:
        """A cell for a slab as thick as so many steps, or less."""
        height = self._empty * (1.0 + STEP * n_steps)
        vectors = self._lattice.copy()
        vectors[self._open] *= height
        taller = copy(self._taller)
        taller.cell = Cell.of(vectors)
        self._sum = charge_sum(taller, self._charges, *self._how)
        # only now, since there may be no such sum
        self._taller = taller
        self._n_steps = n_steps
        self._height = height
        self._slab = SlabTerm(self._taller, self._charges, self._axis)
        self.summary = f"{self._sum.summary}, open {self._slab.summary}"
        self.version += 1

    def _follow_charges(self) -> None:
        """Heights from the lowest charge on, and the cell for them."""
        is_charged = self._charges != 0.0
        heights = (self._taller.positions * self._lattice[self._open]).sum(axis=1)
        heights -= heights[is_charged].min()
        thickness = heights[is_charged].max()
        try:
            n_steps = ceil(thickness / (STEP * self._empty))
            if n_steps != self._n_steps:
                self._take(n_steps)
        except (ValueError, OverflowError) as error:
            raise RangeError(
                "a slab must be thin enough for the waves of a cell that contains it; its charges are "
                f"{thickness:.4g} apart across it: hold them together by walls"
            ) from error
        self._slab.heights[:] = heights / self._height

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        yield in_python(self._follow_charges)
        yield from self._sum.operations(system, target)
        yield self._slab.push(target)

    def collect(self, target: Target) -> None:
        """See Term."""
        self._sum.collect(target)
        self._slab.collect(target)
