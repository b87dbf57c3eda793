"""The loop over terms of two to four atoms, such as bonds, angles and dihedrals: images, forces, energies, virial.

A term is a chain or a star of links. Link l of term t leads from atom first[l, t] to atom second[l, t]:

    r_l = r_second − r_first + translation,   F_second += f_l,   F_first −= f_l,   W += r_l ⊗ f_l

    bond      i → j                  angle     i ← j → k                 dihedral  i ← j ← k → l

Each f_l goes to a slot of its own; then each atom sums its slots, in a fixed order: the same bits for any number of
threads. The translation of a link is that of the nearest image, and stays as long as it certainly is that.
"""

from collections import namedtuple
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.by_address import ByAddress
from minimd.compiled.kernels import DirectCalls, by_type, called_kernel, scalar, type_of, without_cache
from minimd.compiled.program import GO_ON, OUT_OF_RANGE, Operation, n_chunks_of, operation
from minimd.compiled.simd import fma
from minimd.potentials.accumulators import as_force, force_along, in_steps, is_too_large
from minimd.potentials.law import evaluate_law
from minimd.potentials.pair_loop import ByPair, from_table, parameters_of_pair
from minimd.potentials.term import BOND_LOOP, FORCES, PER_ATOM, TOTALS, OwnTerm, Target
from minimd.potentials.user_laws import is_recognized
from minimd.structure.cell import minimum_image
from minimd.structure.system import System

VIRIAL = 6  # components: xx yy zz yz xz xy


class Links(
    ByAddress,
    namedtuple(
        "Links", "positions images first second sites translations shape law parameters slots steps detail totals each"
    ),
):
    """What the loop over T terms of L links works on.

    positions : (N, 3) [length].  images : Images.  first, second : (L, T) int32.  sites : (T, L + 1) int, their atoms.
    translations : (L, T, 3) [length], kept.
    shape : how the links make a force, see link_shape.  law : law type.  parameters : see parameters_of_pair.
    slots : (L, T, 3) output, f_l; int64 impulses in fixed-point arithmetic, where steps : Steps, else ().
    detail : see term.  totals : (chunks, 1 + 6) output of TOTALS, energies and virials of each chunk.
    each : energies (N,) and virials (N, 6), to which PER_ATOM adds equal shares of the atoms of a term; in one chunk.
    """


def link_shape(name: str, formula: Any) -> Any:
    """The shape of terms: formula(links, t, law, numbers) takes each arm of term t, pushes its end, and returns
    u [energy] and whether a force is beyond the range of a grid.

    name : of the variable that it is assigned to, in the module of the formula.
    """
    return type_of(formula)(namedtuple(name, (), module=formula.py_func.__module__))


@scalar
def _stretch(links, t, law, numbers):
    """A law of the distance: f = −u′(r)/r r_ij within the cutoff, whose square is the first number."""
    (dx, dy, dz), _ = arm(links, 0, t)
    r2 = fma(dx, dx, fma(dy, dy, dz * dz))
    u, f = evaluate_law(law, r2, numbers[1:]) if r2 < numbers[0] else (0.0, 0.0)
    return u, push(links, 0, t, (f * dx, f * dy, f * dz))


Stretch = link_shape("Stretch", _stretch)


@scalar
def arm(links, l, t):
    """r_l to the nearest image, rounded, and what rounding has left out [length]."""
    translation = links.translations[l, t]
    x, y, z = _difference(links, l, t, translation)
    if not x[0] * x[0] + y[0] * y[0] + z[0] * z[0] <= links.images.safe_distance2[0]:
        _find_image(links, l, t, translation)
        x, y, z = _difference(links, l, t, translation)
    return (x[0], y[0], z[0]), (x[1], y[1], z[1])


@scalar
def push(links, l, t, force):
    """f_l to its slot; returns whether it is beyond the range of a grid."""
    (x, y, z), slots, steps = force, links.slots, links.steps
    slots[l, t, 0], slots[l, t, 1] = force_along(x, 1.0, steps), force_along(y, 1.0, steps)
    slots[l, t, 2] = force_along(z, 1.0, steps)
    return is_too_large(x * x + y * y + z * z, steps)


@called_kernel
def add_links(links, chunk):
    """Forces to slots; energies and virials.  OUT_OF_RANGE if a force is beyond the range of a grid."""
    n, n_chunks, is_out = links.first.shape[1], links.totals.shape[0], False
    for c in range(1 + VIRIAL):
        links.totals[chunk, c] = 0.0
    for t in range(np.uintp(chunk * n // n_chunks), np.uintp((chunk + 1) * n // n_chunks)):
        u, is_beyond = _acting(links.shape, links, t, links.law, parameters_of_pair(links.parameters, t, 0, 0))
        is_out |= is_beyond
        if links.detail != FORCES:
            _count(links, t, links.totals[chunk], in_steps(u, links.steps))
    return OUT_OF_RANGE if is_out else GO_ON


@by_type
def _acting(shape, links, t, law, numbers):
    formula = shape.instance_class.formula
    return lambda shape, links, t, law, numbers: formula(links, t, law, numbers)


@scalar
def _count(links, t, total, u):
    """total (7,) += energy and virial of a term; and with PER_ATOM equal shares of them to its atoms."""
    (energies, virials), steps, sites = links.each, links.steps, links.sites
    n_sites = sites.shape[1] if links.detail == PER_ATOM else 0
    xx = yy = zz = yz = xz = xy = 0.0
    for l in range(links.slots.shape[0]):
        (x, y, z), _ = arm(links, l, t)
        gx, gy, gz = links.slots[l, t, 0], links.slots[l, t, 1], links.slots[l, t, 2]
        fx, fy, fz = as_force(gx, steps), as_force(gy, steps), as_force(gz, steps)
        xx, yy, zz, yz, xz, xy = xx + x * fx, yy + y * fy, zz + z * fz, yz + z * fy, xz + z * fx, xy + y * fx
    total[0] += u
    for s in range(n_sites):
        energies[sites[t, s]] += in_steps(u / n_sites, steps)
    for c, w in enumerate((xx, yy, zz, yz, xz, xy)):
        total[1 + c] += in_steps(w, steps)
        for s in range(n_sites):
            virials[sites[t, s], c] += in_steps(w / n_sites, steps)


@scalar
def _difference(links, l, t, translation):
    i, j, positions = np.uintp(links.first[l, t]), np.uintp(links.second[l, t]), links.positions
    return (
        _component(positions[j, 0], positions[i, 0], translation[0]),
        _component(positions[j, 1], positions[i, 1], translation[1]),
        _component(positions[j, 2], positions[i, 2], translation[2]),
    )


@scalar
def _component(x, y, translation):
    """x − y + translation rounded, and the sum of the two rounding errors (D. E. Knuth's two-sum)."""
    d = x - y
    z = d - x
    lost = (x - (d - z)) - (y + z)
    s = d + translation
    z = s - d
    return s, lost + ((d - (s - z)) + (translation - z))


@scalar
def _find_image(links, l, t, translation):
    """translation : (3,) output, that of the nearest image."""
    i, j, positions = links.first[l, t], links.second[l, t], links.positions
    lattice, inverse, pbc, safe_distance2 = links.images
    x, y, z = positions[j, 0] - positions[i, 0], positions[j, 1] - positions[i, 1], positions[j, 2] - positions[i, 2]
    a, b, c = minimum_image(x, y, z, lattice, inverse, pbc, safe_distance2[0])
    for k in range(3):
        translation[k] = a * lattice[0, k] + b * lattice[1, k] + c * lattice[2, k]


class LinkedTerm(OwnTerm):
    """Terms of one shape, each link taken at its nearest image.

    first, second : (L, T) int, atoms of each link.  sites : (T, L + 1) int.  shape : from link_shape.  law : law type.
    columns : (T,) numbers of each term, for each parameter.  n_slots, first_slot : its slots, see Slots.
    """

    def __init__(self, links: tuple[Any, Any], sites: Any, shape: tuple, law: tuple, columns: tuple[Any, ...]) -> None:
        self.first, self.second = (np.ascontiguousarray(ends, dtype=np.int32) for ends in links)
        self._sites, self._shape, self._law, self._columns = np.array(sites), shape, law, ByPair(columns)
        self._translations = np.zeros((*self.first.shape, 3))
        self._loop = add_links if is_recognized(law) else without_cache(add_links)
        self._calls, self.n_slots, self.first_slot = DirectCalls(), self.first.size, 0
        self._totals = np.zeros((n_chunks_of(self.first.shape[1]), 1 + VIRIAL))

    def follow(self, system: System) -> bool:
        """See Term; images are looked for again."""
        self._translations[:] = 0.0
        return True

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        totals = self._totals[:1] if target.detail == PER_ATOM else self._totals
        slots = target.slots[self.first_slot : self.first_slot + self.n_slots].reshape(*self.first.shape, 3)
        place = system.positions, target.images, self.first, self.second, self._sites, self._translations
        what = self._shape, self._law, self._columns, slots, target.steps, target.detail
        links = Links(*place, *what, totals, (target.energies, target.virials))
        yield operation(self._calls, self._loop, links, len(totals))

    def collect(self, target: Target) -> None:
        """See Term."""
        if target.detail == TOTALS:
            totals = self._totals.sum(axis=0)
            target.energies[0] += totals[0]
            target.virials[0] += totals[1:]


class FixedPairs(LinkedTerm):
    """A law on pairs that never change.  pairs : (P, 2) int.  law : law type.
    table : (P, 1 + n) numbers of each pair, the squared cutoff first."""

    ingredient = BOND_LOOP

    def __init__(self, pairs: NDArray[np.int64], law: tuple, table: NDArray[np.float64]) -> None:
        super().__init__((pairs[:, :1].T, pairs[:, 1:].T), pairs, Stretch(), law, from_table(table))


class Gathering(ByAddress, namedtuple("Gathering", "atoms start slot slots forces n_chunks")):
    """The sums of slots.  atoms : (A,) int32, that have any.  start : (A + 1,) int32, where those of each begin.

    slot : the number s of a slot, whose force acts on the atom, or −1 − s if its opposite does.  slots : (S, 3).
        forces : (N, 3).
    """


@called_kernel
def sum_slots(gathering, chunk):
    """forces += Σ of the slots of each atom of a chunk, in their order."""
    atoms, start, slot, slots, forces, n_chunks = gathering
    for a in range(np.uintp(chunk * atoms.size // n_chunks), np.uintp((chunk + 1) * atoms.size // n_chunks)):
        i = np.uintp(atoms[a])
        x, y, z = forces[i, 0], forces[i, 1], forces[i, 2]
        for p in range(np.uintp(start[a]), np.uintp(start[a + np.uintp(1)])):
            s = slot[p]
            if s >= 0:
                k = np.uintp(s)
                x, y, z = x + slots[k, 0], y + slots[k, 1], z + slots[k, 2]
            else:
                k = np.uintp(-1 - s)
                x, y, z = x - slots[k, 0], y - slots[k, 1], z - slots[k, 2]
        forces[i, 0], forces[i, 1], forces[i, 2] = x, y, z
    return GO_ON


class Slots:
    """The slots of the terms of a scene.  size : their number."""

    def __init__(self, terms: list[LinkedTerm]) -> None:
        ends, self.size = [np.zeros((0, 3), dtype=np.int64)], 0
        for term in terms:
            term.first_slot, numbers = self.size, self.size + np.arange(term.n_slots)
            both = (term.second.ravel(), numbers), (term.first.ravel(), -1 - numbers)
            ends += [np.column_stack(one) for one in both]
            self.size += term.n_slots
        atom, slot = np.concatenate([one[:, :2] for one in ends]).T
        order = np.argsort(atom, kind="stable")
        self._atoms, start = np.unique(atom[order], return_index=True)
        self._start = np.append(start, len(atom)).astype(np.int32)
        self._slot, self._atoms = slot[order].astype(np.int32), self._atoms.astype(np.int32)
        self._calls = DirectCalls()

    def operations(self, target: Target) -> Iterator[Operation]:
        """The sums of the slots of all atoms."""
        if self.size:
            n_chunks = n_chunks_of(len(self._atoms))
            made = Gathering(self._atoms, self._start, self._slot, target.slots, target.forces, n_chunks)
            yield operation(self._calls, sum_slots, made, n_chunks)
