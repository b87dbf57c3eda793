"""The loop over terms of two to four atoms, such as bonds, angles and dihedrals, and of two dihedrals: images, forces,
energies, virial.

A term is a chain or a star of links. Link l of term t leads from atom first[l, t] to atom second[l, t]:

    r_l = r_second − r_first + translation,   F_second += f_l,   F_first −= f_l,   W += r_l ⊗ f_l

    bond      i → j                  angle     i ← j → k                 dihedral  i ← j ← k → l

Terms are computed in blocks of as many as a vector has lanes; the last block is filled up with its last term. Each f_l
goes to a slot of its own; then each atom sums its slots, in a fixed order: the same bits for any number of threads.
The translation of a link is that of the nearest image, and stays as long as it certainly is that. Translations and
slots of a block lie together: all x, all y, all z.
"""

from collections import namedtuple
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.fixed_point import as_force, force_along, in_steps, is_too_large
from minimd.core.compiled.kernels import (
    DirectCalls,
    by_type,
    called_kernel,
    inlined,
    scalar,
    type_of,
)
from minimd.core.compiled.program import (
    GO_ON,
    OUT_OF_RANGE,
    Operation,
    n_chunks_of,
    operation,
    share_of,
)
from minimd.core.compiled.simd import bits_from_mask, fma, lane, select, with_lane
from minimd.core.compiled.simd.vector import (
    count,
    gathered,
    lanes_for,
    loaded,
    loaded_columns,
    stored,
)
from minimd.core.neighbors.clusters import DIMENSIONS
from minimd.core.potentials.law import evaluate_law, loop_for, on_vectors
from minimd.core.potentials.term import BOND_LOOP, FORCES, PER_ATOM, TOTALS, OwnTerm, Target
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.cell import nearest_translation, nearest_vectors
from minimd.core.structure.system import System
from minimd.core.structure.vectors import combined, cross, dot, minus, times

VIRIAL = 6  # components: xx yy zz yz xz xy
# the smallest sin² of the angle between two neighboring bonds by which forces are divided: its rounding error
STRAIGHT2 = 1e-16
# straight lines between two atoms, along which their forces act: from where, how far, and the force at the far end
Lines = tuple[Array, Array, Array]


class Links(
    ByAddress,
    namedtuple(
        "Links",
        "positions images first second sites translations slots steps detail totals each lanes",
    ),
):
    """T terms of L links, in B blocks of n lanes, and what the loop over them adds to, whatever their law.

    positions : (N, 3) [length].
    images : Images.
    first, second : (L, B n) int32, atoms.
    sites : (T, L + 1) int.
    translations : (3 L B n,) [length], kept.
    slots : (3 L B n,) output, f_l; int64 impulses in fixed-point arithmetic, where steps : Steps, else ().
    detail : see term.
    totals : (chunks, 1 + 6) output of TOTALS, energies and virials of each chunk.
    each : energies (N,) and virials (N, 6), to which PER_ATOM adds equal shares of the atoms of a term; in one chunk.
    """


class LinksOfLaw(ByAddress, namedtuple("LinksOfLaw", "links shape law columns")):
    """Links with their law: apart, so that what does not depend on it is compiled once.

    shape : how the links make a force, see link_shape.
    law : law type.
    columns : (B n,) numbers for each parameter.
    """


def link_shape(name: str, formula: Any, *ends: tuple[int, int]) -> Any:
    """The shape of terms, by the name of its variable.
    ends : columns of the sites between which each link leads.
    formula(links, b, law, numbers) takes each arm of block b, pushes its end, and returns u [energy] and whether a
    force is beyond the range of a grid."""
    shape: Any = type_of(formula)(namedtuple(name, (), module=__name__))
    shape.ends = ends
    return shape


@scalar
def _stretch(links, b, law, numbers):
    """A law of the distance: f = −u′(r)/r r_ij within the cutoff, whose square is the first number."""
    (dx, dy, dz), _ = arm(links, 0, b)
    r2 = fma(dx, dx, fma(dy, dy, dz * dz))
    u, f = evaluate_law(law, min(r2, numbers[0]), numbers[1:])
    is_near = r2 < numbers[0]
    f = select(is_near, f, 0.0)
    return select(is_near, u, 0.0), push(links, 0, b, (f * dx, f * dy, f * dz))


@inlined
def _minor(a, b, c, d):
    """a b − c d, right to a few roundings even where the products nearly cancel, if fma rounds once (W. Kahan)."""
    x = a * b
    y = c * d
    return (x - y) + (fma(a, b, -x) - fma(c, d, -y))


@inlined
def _normal(a, b, lost_a, lost_b):
    """(a + lost_a) × (b + lost_b), to a few roundings however small the angle between them is."""
    nx = _minor(a[1], b[2], a[2], b[1])
    ny = _minor(a[2], b[0], a[0], b[2])
    nz = _minor(a[0], b[1], a[1], b[0])
    lost = combined(1.0, cross(lost_a, b), 1.0, cross(a, lost_b))
    return combined(1.0, (nx, ny, nz), 1.0, lost)


@scalar
def _bend(links, block, _law, numbers):
    """Harmonic angles u = ½ k (θ − θ₀)², with a = r_i − r_j, b = r_k − r_j, n = a × b.

        tan(θ − θ₀) = (|n| cos θ₀ − a·b sin θ₀)/(a·b cos θ₀ + |n| sin θ₀)
        F_i = u′(θ) n × a/(a²|n|),   F_k = u′(θ) b × n/(b²|n|),   all zero if n = 0

    numbers : k [energy/rad²], sin θ₀, cos θ₀. θ near 0 and π, and θ − θ₀ if θ₀ is 0 or π, have all their digits.
    """
    a, lost_a = arm(links, 0, block)
    b, lost_b = arm(links, 1, block)
    k, sine, cosine = numbers
    n = _normal(a, b, lost_a, lost_b)
    size = dot(n, n) ** 0.5
    ab = dot(a, b)
    stretch = np.arctan2(size * cosine - ab * sine, ab * cosine + size * sine)
    slope = k * stretch
    s = select(size > 0.0, slope / size, 0.0)
    is_out = push(links, 0, block, times(s / dot(a, a), cross(n, a)))
    is_out |= push(links, 1, block, times(s / dot(b, b), cross(b, n)))
    return 0.5 * slope * stretch, is_out


@scalar
def _dihedral(links, l, block):
    """φ of links l to l + 2 [rad], and what _twist needs, without a division by sin φ.

        F = r_i − r_j,  G = r_j − r_k,  H = r_l − r_k,  A = F × G,  B = H × G
        cos φ = A·B/(|A||B|),   sin φ = (B × A)·G/(|A||B||G|)
        F_i = u′ |G|/A² A,   F_l = −u′ |G|/B² B,   S = u′ (F·G/(A²|G|) A − H·G/(B²|G|) B),
        F_j = −F_i − S,   F_k = −F_l + S

    A. Blondel, M. Karplus, J. Comput. Chem. 17, 1132 (1996), eq. 6, 27.
    """
    f, _ = arm(links, l, block)
    g, _ = arm(links, l + 1, block)
    h, _ = arm(links, l + 2, block)
    a = cross(f, g)
    b = cross(h, g)
    g2 = dot(g, g)
    fg = dot(f, g)
    hg = dot(h, g)
    a2 = max(dot(a, a), STRAIGHT2 * g2 * dot(f, f))
    b2 = max(dot(b, b), STRAIGHT2 * g2 * dot(h, h))
    length = g2**0.5
    phi = np.arctan2(dot(g, cross(b, a)) / length, dot(a, b))
    return phi, (a, b, a2, b2, fg, hg, length)


@scalar
def _twist(links, l, block, slope, parts):
    """Push the ends of links l to l + 2, with u′ = slope [energy/rad], see _dihedral."""
    a, b, a2, b2, fg, hg, length = parts
    s = combined(-slope * fg / (a2 * length), a, slope * hg / (b2 * length), b)
    is_out = push(links, l, block, times(slope * length / a2, a))
    is_out |= push(links, l + 1, block, s)
    is_out |= push(links, l + 2, block, times(-slope * length / b2, b))
    return is_out


@scalar
def _turn(links, block, law, numbers):
    """A law of the dihedral angle."""
    phi, parts = _dihedral(links, 0, block)
    u, slope = evaluate_law(law, phi, numbers)
    return u, _twist(links, 0, block, slope, parts)


@scalar
def _turn_both(links, block, law, numbers):
    """A law of two dihedral angles and a number, for one term at a time. The last link joins them, without a force."""
    phi, first = _dihedral(links, 0, block)
    psi, second = _dihedral(links, 3, block)
    u = slope = other = phi
    for k in range(count(phi)):
        v, f, g = evaluate_law(law, lane(phi, k), (lane(psi, k), lane(numbers[0], k)))
        u = with_lane(u, k, v)
        slope = with_lane(slope, k, f)
        other = with_lane(other, k, g)
    nothing = 0.0 * u
    is_out = _twist(links, 0, block, slope, first)
    is_out |= _twist(links, 3, block, other, second)
    is_out |= push(links, 6, block, (nothing, nothing, nothing))
    return u, is_out


Stretch = link_shape("Stretch", _stretch, (0, 1))
Bend = link_shape("Bend", _bend, (1, 0), (1, 2))
Torsion = link_shape("Torsion", _turn, (1, 0), (2, 1), (2, 3))
TwoTorsions = link_shape(
    "TwoTorsions", _turn_both, (1, 0), (2, 1), (2, 3), (5, 4), (6, 5), (6, 7), (1, 4)
)


@scalar
def block_of(links, l, b):
    """Where block b of link l begins, in translations and slots."""
    return np.uintp(l * links.first.shape[1] + b * count(links.lanes)) * np.uintp(DIMENSIONS)


@scalar
def arm(links, l, b):
    """r_l to the nearest image, rounded, and what rounding has left out [length]."""
    x, y, z = _difference(links, l, b)
    r2 = x[0] * x[0] + y[0] * y[0] + z[0] * z[0]
    is_near = bits_from_mask(r2 <= links.images.safe_distance2[0])
    n_lanes = count(links.lanes)
    if is_near != (1 << n_lanes) - 1:
        for k in range(n_lanes):
            if not is_near >> k & 1:
                _find_image(links, l, b * n_lanes + k, block_of(links, l, b) + np.uintp(k))
        x, y, z = _difference(links, l, b)
    return (x[0], y[0], z[0]), (x[1], y[1], z[1])


@scalar
def push(links, l, b, force):
    """f_l to its slots; returns whether one is beyond the range of a grid."""
    x, y, z = force
    steps = links.steps
    fx = force_along(x, 1.0, steps)
    fy = force_along(y, 1.0, steps)
    fz = force_along(z, 1.0, steps)
    stored(links.slots, block_of(links, l, b), (fx, fy, fz))
    return is_too_large(x * x + y * y + z * z, steps)


@called_kernel
def add_links(terms, chunk):
    """Forces to slots; energies and virials.  OUT_OF_RANGE if a force is beyond the range of a grid.

    terms : LinksOfLaw."""
    links = terms.links
    n_lanes = count(links.lanes)
    n_blocks = links.first.shape[1] // n_lanes
    n_chunks = links.totals.shape[0]
    is_out = False
    for c in range(1 + VIRIAL):
        links.totals[chunk, c] = 0.0
    first, last = share_of(chunk, n_chunks, n_blocks)
    for b in range(first, last):
        numbers = loaded_columns(terms.columns, b * n_lanes, links.lanes)
        u, is_beyond = _push_ends(terms.shape, links, b, terms.law, numbers)
        is_out |= is_beyond
        if links.detail != FORCES:
            _count(links, b, links.totals[chunk], u)
    return OUT_OF_RANGE if is_out else GO_ON


@by_type
def _push_ends(shape, links, b, law, numbers):
    """What the formula of the shape does, see link_shape."""
    formula = shape.instance_class.formula
    return lambda shape, links, b, law, numbers: formula(links, b, law, numbers)


@scalar
def _count(links, b, total, u):
    """total (7,) += energy and virial of a block; and with PER_ATOM equal shares of them to its atoms."""
    energies, virials = links.each
    steps = links.steps
    sites = links.sites
    n_lanes = count(links.lanes)
    n_sites = sites.shape[1] if links.detail == PER_ATOM else 0
    xx = yy = zz = yz = xz = xy = 0.0 * u

    for l in range(links.first.shape[0]):
        (x, y, z), _ = arm(links, l, b)
        gx, gy, gz = loaded(links.slots, block_of(links, l, b), links.lanes)
        fx = as_force(gx, steps)
        fy = as_force(gy, steps)
        fz = as_force(gz, steps)
        xx = xx + x * fx
        yy = yy + y * fy
        zz = zz + z * fz
        yz = yz + z * fy
        xz = xz + z * fx
        xy = xy + y * fx

    start = b * n_lanes

    for k in range(min(n_lanes, sites.shape[0] - start)):
        total[0] += in_steps(lane(u, k), steps)
        for s in range(n_sites):
            energies[sites[start + k, s]] += in_steps(lane(u, k) / n_sites, steps)

        for c, w in enumerate((xx, yy, zz, yz, xz, xy)):
            total[1 + c] += in_steps(lane(w, k), steps)
            for s in range(n_sites):
                virials[sites[start + k, s], c] += in_steps(lane(w, k) / n_sites, steps)


@scalar
def _difference(links, l, b):
    """r_l with the translation that is kept: x, y, z, each as _component."""
    lanes = links.lanes
    start = b * count(lanes)
    ax, ay, az = gathered(links.positions, links.first[l], start, lanes)
    bx, by, bz = gathered(links.positions, links.second[l], start, lanes)
    tx, ty, tz = loaded(links.translations, block_of(links, l, b), lanes)
    return _component(bx, ax, tx), _component(by, ay, ty), _component(bz, az, tz)


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
def _find_image(links, l, t, at):
    """The translation of link l of term t, in place: that of the nearest image.
    at : of its x in the translations."""
    begin = links.positions[links.first[l, t]]
    end = links.positions[links.second[l, t]]
    n = np.uintp(count(links.lanes))
    for k, x in enumerate(nearest_translation(minus(end, begin), links.images)):
        links.translations[at + np.uintp(k) * n] = x


class LinkedTerm(OwnTerm):
    """Terms of one shape, each link taken at its nearest image.
    sites : (T, L + 1) int, atoms of each term.

    shape : from link_shape.
    law : law type, which runs on vectors.
    columns : (T,) numbers of each term, for each parameter.
    first_slot : where its slots begin, see Slots.
    """

    fits_grid = True
    has_heat_flux = True

    def __init__(
        self, sites: NDArray, shape: Any, law: tuple, columns: tuple[NDArray, ...]
    ) -> None:
        self.lanes = lanes_for()
        self.n_terms = len(sites)
        n_blocks = -(-self.n_terms // self.lanes.size)
        filled = np.minimum(np.arange(n_blocks * self.lanes.size), self.n_terms - 1)
        first, second = np.transpose(shape.ends)
        self.first = np.ascontiguousarray(sites.T[first][:, filled], dtype=np.int32)
        self.second = np.ascontiguousarray(sites.T[second][:, filled], dtype=np.int32)
        self.first_slot = 0
        self._sites = np.array(sites)
        self._shape = shape
        self._law = law
        self._columns = tuple(column[filled] for column in columns)
        self._translations = np.zeros(DIMENSIONS * self.first.size)
        self._totals = np.zeros((n_chunks_of(self.n_terms), 1 + VIRIAL))
        self._loop = loop_for(add_links, law)
        self._calls = DirectCalls()

    def follow(self, system: System) -> bool:
        """See Term; images are looked for again."""
        self._translations[:] = 0.0
        return True

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        totals = self._totals[:1] if target.detail == PER_ATOM else self._totals
        start = DIMENSIONS * self.first_slot
        links = Links(
            system.positions,
            target.images,
            self.first,
            self.second,
            self._sites,
            self._translations,
            target.slots[start : start + self._translations.size],
            target.steps,
            target.detail,
            totals,
            (target.energies, target.virials),
            self.lanes,
        )
        terms = LinksOfLaw(links, self._shape, self._law, self._columns)
        yield operation(self._calls, self._loop, terms, len(totals))

    def collect(self, target: Target) -> None:
        """See Term."""
        if target.detail == TOTALS:
            totals = self._totals.sum(axis=0)
            target.energies[0] += totals[0]
            target.virials[0] += totals[1:]

    def lines(self, system: System, slots: NDArray) -> Lines:
        """The links: r_first (L, T, 3), r_l at the nearest image (L, T, 3) [length], f_l (L, T, 3) [energy/length].

        slots : (3 S,) f_l of all terms, of the last evaluation [energy/length].
        """
        n_links = len(self.first)
        start = DIMENSIONS * self.first_slot
        pairs: Indices
        blocks = slots[start : start + self._translations.size]
        blocks = blocks.reshape(n_links, -1, DIMENSIONS, self.lanes.size).swapaxes(2, 3)
        pulls = blocks.reshape(n_links, -1, DIMENSIONS)[:, : self.n_terms]
        pairs = np.stack([self.first, self.second], axis=2)[:, : self.n_terms].astype(np.int64)
        arms = nearest_vectors(system.positions, system.cell, pairs.reshape(-1, 2))
        return system.positions[pairs[..., 0]], arms.reshape(pulls.shape), pulls

    def uneven_flux(self, system: System, velocities: NDArray, slots: NDArray) -> NDArray:
        """What equal shares of the virial leave out of the heat flux, (3,): nothing for bonds.

            Σ_terms Σ_s (r_s − r̄) F_s · (v_s − v̄),   r̄, v̄: means over the atoms of the term

        slots : see lines.
        D. Surblys, H. Matsubara, G. Kikugawa, T. Ohara, Phys. Rev. E 99, 051301 (2019), on centroids.
        """
        _, arms, pulls = self.lines(system, slots)
        n_links = len(arms)
        # from sites to links: r_l = Σ_s ends_ls r_s; back, with mean 0, by its pseudoinverse
        ends = np.zeros((n_links, n_links + 1))
        first, second = np.transpose(self._shape.ends)
        ends[range(n_links), first] = -1.0
        ends[range(n_links), second] = 1.0
        places = np.tensordot(np.linalg.pinv(ends), arms, 1)
        forces = np.tensordot(ends.T, pulls, 1)
        relative = velocities[self._sites.T]
        relative -= relative.mean(axis=0)
        return np.asarray(np.einsum("stc,std,std->c", places, forces, relative))


class FixedPairs(LinkedTerm):
    """A law on pairs that never change.
    pairs : (P, 2) int.
    law : law type.
    columns : (P,) numbers of each pair, the squared cutoff first."""

    ingredient = BOND_LOOP

    def __init__(self, pairs: Indices, law: tuple, columns: tuple[NDArray, ...]) -> None:
        super().__init__(pairs, Stretch(), on_vectors(law, len(columns) - 1), columns)


class Gathering(
    ByAddress, namedtuple("Gathering", "atoms start place slots forces n_chunks lanes")
):
    """The sums of slots.
    atoms : (A,) int32, that have any.
    start : (A + 1,) int32, where those of each begin.

    place : where in slots the x of a force is that acts on the atom, or −1 − that, if its opposite does.
        slots : (3 S,).
    forces : (N, 3).
    """


@called_kernel
def sum_slots(gathering, chunk):
    """forces += Σ of the slots of each atom of a chunk, in their order."""
    atoms, start, place, slots, forces, n_chunks, lanes = gathering
    y_after_x = np.uintp(count(lanes))
    z_after_x = np.uintp(2 * count(lanes))
    begin, end = share_of(chunk, n_chunks, atoms.size)

    for a in range(np.uintp(begin), np.uintp(end)):
        i = np.uintp(atoms[a])
        x, y, z = forces[i, 0], forces[i, 1], forces[i, 2]

        for p in range(np.uintp(start[a]), np.uintp(start[a + np.uintp(1)])):
            at = place[p]
            if at >= 0:
                k = np.uintp(at)
                x, y, z = x + slots[k], y + slots[k + y_after_x], z + slots[k + z_after_x]
            else:
                k = np.uintp(-1 - at)
                x, y, z = x - slots[k], y - slots[k + y_after_x], z - slots[k + z_after_x]

        forces[i, 0] = x
        forces[i, 1] = y
        forces[i, 2] = z

    return GO_ON


class Slots:
    """The slots of the terms of a scene.
    size : their number."""

    def __init__(self, terms: list[LinkedTerm]) -> None:
        self._lanes = lanes_for()
        self._calls = DirectCalls()
        self.size = 0
        ends = [np.zeros((2, 0), dtype=np.int64)]
        n_lanes = self._lanes.size

        for term in terms:
            term.first_slot = self.size
            slots = self.size + np.arange(term.first.size).reshape(term.first.shape)
            places = slots // n_lanes * DIMENSIONS * n_lanes + slots % n_lanes
            # without the terms that fill up the last block
            atoms = np.stack([term.second, term.first])[..., : term.n_terms]
            signed = np.stack([places, -1 - places])[..., : term.n_terms]
            ends.append(np.stack([atoms.ravel(), signed.ravel()]))
            self.size += term.first.size

        atom, place = np.concatenate(ends, axis=1)
        order = np.argsort(atom, kind="stable")
        atoms, start = np.unique(atom[order], return_index=True)
        self._atoms = atoms.astype(np.int32)
        self._start = np.append(start, len(atom)).astype(np.int32)
        self._place = place[order].astype(np.int32)

    def operations(self, target: Target) -> Iterator[Operation]:
        """The sums of the slots of all atoms."""
        if self.size:
            n_chunks = n_chunks_of(len(self._atoms))
            gathering = Gathering(
                self._atoms,
                self._start,
                self._place,
                target.slots,
                target.forces,
                n_chunks,
                self._lanes,
            )
            yield operation(self._calls, sum_slots, gathering, n_chunks)
