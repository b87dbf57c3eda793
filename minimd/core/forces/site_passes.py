"""Massless sites in an evaluation of forces: before it they come to their places, after it they hand over forces."""

from collections import namedtuple
from collections.abc import Iterator

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, called_kernel, scalar
from minimd.core.compiled.program import GO_ON, Operation, operation
from minimd.core.potentials.term import FORCES, VOIGT, Target
from minimd.core.structure.cell import Images
from minimd.core.structure.sites import arm, place
from minimd.core.structure.system import System
from minimd.core.structure.vectors import cross, minus, times


class Handing(ByAddress, namedtuple("Handing", "rows forces virials detail")):
    """Forces on sites to be handed over.
    rows : SiteRows.
    forces, virials, detail : see Target."""


@called_kernel
def place_sites(rows, _chunk):
    """Positions of all sites."""
    place(rows)
    return GO_ON


@scalar
def _push(forces, i, force):
    """forces (N, 3) of atom i += a force."""
    for c in range(3):
        forces[i, c] += force[c]


@scalar
def _count(virial, r, force):
    """virial (6,) += r ⊗ F."""
    for k in range(6):
        virial[k] += r[VOIGT[0][k]] * force[VOIGT[1][k]]


@called_kernel
def hand_over(handing, _chunk):
    """Forces on sites become forces on their parents, see Sites.

    A virial holds forces on sites as if a strain moved sites as it moves atoms. It does not out of the plane:
    W += d_1 ⊗ (c d_2 × F) + d_2 ⊗ (c F × d_1) − c (d_1 × d_2) ⊗ F."""
    rows, forces, virials, detail = handing
    for s in range(rows.atoms.size):
        i = rows.atoms[s]
        force = (forces[i, 0], forces[i, 1], forces[i, 2])
        rest = force
        for p in range(1, rows.parents.shape[1]):
            share = times(rows.weights[s, p], force)
            _push(forces, rows.parents[s, p], share)
            rest = minus(rest, share)
        if rows.out_of_plane[s] != 0.0:
            first = arm(rows, s, 1)
            second = arm(rows, s, 2)
            turned = times(rows.out_of_plane[s], force)
            on_first = cross(second, turned)
            on_second = cross(turned, first)
            _push(forces, rows.parents[s, 1], on_first)
            _push(forces, rows.parents[s, 2], on_second)
            rest = minus(minus(rest, on_first), on_second)
            if detail != FORCES:
                virial = virials[min(i, virials.shape[0] - 1)]
                _count(virial, first, on_first)
                _count(virial, second, on_second)
                _count(virial, cross(second, first), turned)
        _push(forces, rows.parents[s, 0], rest)
        for c in range(3):
            forces[i, c] = 0.0
    return GO_ON


class SitePasses:
    """The operations of the sites of a system, if it has any.
    images : Images of its cell."""

    def __init__(self, system: System, images: Images) -> None:
        self._rows = system.sites and system.sites.rows(system.positions, images)
        self._calls = DirectCalls()

    def place(self) -> None:
        """Bring sites to their places, which there must be."""
        place(self._rows)

    def before(self) -> Iterator[Operation]:
        """What comes before all others in an evaluation."""
        if self._rows:
            yield operation(self._calls, place_sites, self._rows)

    def after(self, target: Target) -> Iterator[Operation]:
        """What comes after all others."""
        if self._rows:
            handing = Handing(self._rows, target.forces, target.virials, target.detail)
            yield operation(self._calls, hand_over, handing)
