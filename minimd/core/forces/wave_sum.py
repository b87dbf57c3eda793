"""The smooth part of Coulomb's law in a periodic cell: a sum over waves, wave by wave.

    U = ½/V Σ_k L̂(k) |S(k)|² − ½ L(0) Σ qᵢ²,   S(k) = Σ qⱼ exp(i k·rⱼ),   F_i = qᵢ/V Σ_k L̂(k) k Im(S* exp(i k·rᵢ))

k runs over the reciprocal vectors 2π (a, b, c) in fractional coordinates with 0 < |k| ≤ c/r_c: half of them, since −k
has the same share. exp(i k·r) = X_a Y_b Z_c, of which a cell (a, b ≥ 0, c ≥ 0) needs the products for ±b and ±c: four
waves for eight multiplications with an addition. Atoms are taken in blocks, whose X, Y, Z stay in the cache; each chunk
of atoms has sums of its own, which are added in their order: the same bits for any number of threads.

In fixed-point arithmetic products are rounded before they are added, so that S is the same for atoms in any order.
Positions are counted from an atom that the other forces choose, see choose_atom, and wrapped: forces are the same for
atoms that are numbered differently, wrapped, or moved together. The chosen atom also takes what is left of Σ F.

P. P. Ewald, Ann. Phys. 369, 253 (1921); net charges: a uniform background, of energy −½ Q²/V ∫ S(r) d³r,
Q = Σ q; the share of atom i is −½ q_i Q/V ∫ S(r) d³r.
"""

from collections import namedtuple
from collections.abc import Iterator
from math import pi

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.fixed_point import (
    force_along,
    on_grid,
    plus_rounded,
    rounder_for,
    sum_in_any_order,
)
from minimd.core.compiled.kernels import DirectCalls, called_kernel, scalar
from minimd.core.compiled.program import GO_ON, Operation, n_chunks_of, operation, share_of
from minimd.core.compiled.simd import broadcast, fma, load, store, total, zeros
from minimd.core.compiled.simd.vector import count, lanes_for
from minimd.core.potentials.prolates import Split
from minimd.core.potentials.term import FORCES, PER_ATOM, VOIGT, OwnTerm, Target
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.system import System
from minimd.core.structure.vectors import across, along

BLOCK = 128  # atoms whose tables are made at once
MOST_SUMS = 16  # chunks of atoms, each with sums of its own
# of fractional coordinates: atoms are wrapped at a place where those of crystals are not
CUT = 0.618
MOST_CELLS = 100_000  # of four waves each: their sums take half a gigabyte
ROOM = 1.2  # for waves that come when the cell becomes larger
# of a, b, c, for the four waves of a cell
SIGNS = np.array(
    [
        (1, 1, 1),
        (1, 1, -1),
        (1, -1, 1),
        (1, -1, -1),
    ]
)
SUMS, AMPLITUDES = 8, 8  # numbers for each cell
# columns of rows: a, b, the number of the first cell, how many cells c = 0, 1, …
A, B, FIRST, N_CELLS = range(4)
# sizes: of rows, cells; places of tables: X, Y, Z, XY, forces
N_ROWS, N_ALL, X, Y, Z, XY, F = range(7)


class Waves(
    ByAddress,
    namedtuple(
        "Waves",
        "positions charges rounder lattice inverse chosen sizes rows weights bends tables sums amplitudes totals "
        "rest forces steps detail lanes",
    ),
):
    """What the sum works on.

    positions : (N, 3) [length].
    charges : (N,) [√(energy · length)].
    rounder : see rounder_for; () without a grid.
    lattice, inverse : (3, 3) [length], [1/length].
    chosen : (1,) int, see choose_atom.
    sizes : (7,) int, see N_ROWS.
    rows : (R, 4) int, cells of the same a and b.
    weights, bends : (C, 4) of L̂ and dL̂/dk², for the four waves of a cell.
    tables : (chunks, …) of the atoms of a block.
    sums : (chunks, C · 8 · lanes).
    amplitudes : (C, 8).
    totals : (1, 7) output: energy and virial.
    rest : (chunks, 3), the sums of forces.
    forces : (N, 3) output; int64 impulses in fixed-point arithmetic, where steps : Steps, else ().
    detail : see term.
    """


@called_kernel
def choose_atom(waves, _chunk):
    """The atom on which the other forces are largest along x; of those with equal forces its position decides."""
    best = 0
    for i in range(1, waves.charges.size):
        if _rank(waves, i) > _rank(waves, best):
            best = i
    waves.chosen[0] = best
    return GO_ON


@scalar
def _rank(waves, i):
    """What decides which atom is chosen."""
    r = waves.positions
    return waves.forces[i, 0], r[i, 0], r[i, 1], r[i, 2]


@called_kernel
def sum_waves(waves, chunk):
    """The sums S of a chunk of atoms, lane by lane, in the eight parts of _add_cell.

    waves : Waves; its sums[chunk] are overwritten.
    chunk : number of the chunk.
    """
    n = waves.charges.size
    n_chunks = waves.sums.shape[0]
    lanes = waves.lanes
    table = waves.tables[chunk]
    sums = waves.sums[chunk]
    n_lanes = np.uintp(count(waves.lanes))
    n_sums = np.uintp(waves.sizes[N_ALL] * SUMS)
    for k in range(np.uintp(0), n_sums, np.uintp(1)):
        store(sums, k * n_lanes, zeros(lanes))

    first, last = share_of(chunk, n_chunks, n)

    for start in range(first, last, BLOCK):
        _fill_tables(waves, table, start, min(start + BLOCK, last))
        for row in range(waves.sizes[N_ROWS]):
            _multiply(waves, table, row)
            for cell in range(waves.rows[row, N_CELLS]):
                _add_cell(waves, table, sums, waves.rows[row, FIRST] + cell, cell)

    return GO_ON


@scalar
def _fill_tables(waves, table, first, last):
    """q exp(2πi a s₁), exp(2πi b s₂), exp(2πi c s₃) of the atoms of a block, for all a, b, c from 0 on.

        X_0 = q, Y_0 = Z_0 = 1,   X_{a+1} = X_a exp(2πi s₁), and so on

    s are fractional coordinates, counted from the chosen atom and wrapped, see CUT.
    table : of the chunk; real and imaginary parts lie in blocks, one behind the other.
    first, last : atoms of the block; where there are fewer than BLOCK, the last one is repeated without charge.
    """
    lattice = waves.lattice
    inverse = waves.inverse
    sizes = waves.sizes
    n_lanes = np.uintp(count(waves.lanes))
    place = np.uintp(sizes[F])
    r = waves.positions
    o = np.uintp(waves.chosen[0])

    for k in range(BLOCK):
        i = np.uintp(min(first + k, last - 1))
        x = r[i, 0] - r[o, 0]
        y = r[i, 1] - r[o, 1]
        z = r[i, 2] - r[o, 2]

        for d in range(3):
            cells = np.floor(along((x, y, z), inverse, d) + CUT)
            x = x - cells * lattice[d, 0]
            y = y - cells * lattice[d, 1]
            z = z - cells * lattice[d, 2]

        for d in range(3):
            s = along((x, y, z), inverse, d)
            table[place + np.uintp(d * BLOCK + k)] = 2.0 * pi * s
        table[np.uintp(sizes[X] + k)] = waves.charges[i] if first + k < last else 0.0

    for d in range(3):
        begin = np.uintp(sizes[X + d])
        end = np.uintp(sizes[X + d + 1])

        for k in range(np.uintp(0), np.uintp(BLOCK), n_lanes):
            angle = load(table, place + np.uintp(d * BLOCK) + k, waves.lanes)
            c = np.cos(angle)
            s = np.sin(angle)
            x = broadcast(1.0, c)
            if d == 0:
                x = load(table, begin + k, waves.lanes)
            y = 0.0 * x

            for at in range(begin, end, np.uintp(2 * BLOCK)):
                _store_complex(table, at + k, x, y)
                turned = fma(x, c, -(y * s))
                y = fma(x, s, y * c)
                x = turned


@scalar
def _complex_at(table, at, lanes):
    """Real and imaginary parts of as many atoms as a vector has lanes; both lie in blocks, one behind the other.

    at : place of the first real part.
    """
    return load(table, at, lanes), load(table, at + np.uintp(BLOCK), lanes)


@scalar
def _store_complex(table, at, real, imaginary):
    """The reverse of _complex_at."""
    store(table, at, real)
    store(table, at + np.uintp(BLOCK), imaginary)


@scalar
def _multiply(waves, table, row):
    """X_a Y_b and X_a Y_b* of a row: waves with b and with −b.

    table : of the chunk, with X and Y; its place XY is overwritten.
    row : number of the row of cells with these a and b.
    """
    sizes = waves.sizes
    lanes = waves.lanes
    block = np.uintp(BLOCK)
    at_x = np.uintp(sizes[X] + 2 * BLOCK * waves.rows[row, A])
    at_y = np.uintp(sizes[Y] + 2 * BLOCK * waves.rows[row, B])
    at = np.uintp(sizes[XY])

    for k in range(np.uintp(0), block, np.uintp(count(lanes))):
        xr, xi = _complex_at(table, at_x + k, lanes)
        yr, yi = _complex_at(table, at_y + k, lanes)
        rr = xr * yr
        ii = xi * yi
        ri = xr * yi
        ir = xi * yr
        _store_complex(table, at + k, rr - ii, ri + ir)
        _store_complex(table, at + block + block + k, rr + ii, ir - ri)


@scalar
def _add_cell(waves, table, sums, cell, c):
    """The products of P = X Y and M = X Y* with Z_c, summed over the atoms of a block, lane by lane.

        Re P Re Z, Im P Im Z, Re P Im Z, Im P Re Z, and the same of M:

    the real part of S is the difference of the first two for c, their sum for −c; its imaginary part likewise.
    sums : of the chunk; the eight numbers of the cell grow.
    cell, c : number of the cell, and its c.
    """
    lanes = waves.lanes
    n_lanes = np.uintp(count(waves.lanes))
    block = np.uintp(BLOCK)
    rounder = waves.rounder
    at = np.uintp(waves.sizes[XY])
    at_z = np.uintp(waves.sizes[Z] + 2 * BLOCK * c)
    place = np.uintp(cell * SUMS) * n_lanes
    p_rc = load(sums, place, lanes)
    p_is = load(sums, place + n_lanes, lanes)
    p_rs = load(sums, place + np.uintp(2) * n_lanes, lanes)
    p_ic = load(sums, place + np.uintp(3) * n_lanes, lanes)
    m_rc = load(sums, place + np.uintp(4) * n_lanes, lanes)
    m_is = load(sums, place + np.uintp(5) * n_lanes, lanes)
    m_rs = load(sums, place + np.uintp(6) * n_lanes, lanes)
    m_ic = load(sums, place + np.uintp(7) * n_lanes, lanes)

    for k in range(np.uintp(0), block, n_lanes):
        zc, zs = _complex_at(table, at_z + k, lanes)
        pr, pi_ = _complex_at(table, at + k, lanes)
        mr, mi = _complex_at(table, at + block + block + k, lanes)
        p_rc = plus_rounded(pr, zc, p_rc, rounder)
        p_is = plus_rounded(pi_, zs, p_is, rounder)
        p_rs = plus_rounded(pr, zs, p_rs, rounder)
        p_ic = plus_rounded(pi_, zc, p_ic, rounder)
        m_rc = plus_rounded(mr, zc, m_rc, rounder)
        m_is = plus_rounded(mi, zs, m_is, rounder)
        m_rs = plus_rounded(mr, zs, m_rs, rounder)
        m_ic = plus_rounded(mi, zc, m_ic, rounder)

    for part in (p_rc, p_is, p_rs, p_ic, m_rc, m_is, m_rs, m_ic):
        store(sums, place, part)
        place += n_lanes


@called_kernel
def weigh_waves(waves, _chunk):
    """Amplitudes A = L̂ S* of all waves; energy and virial, if they are wanted.

    For ±c of each b: A₊ + A₋ and A₊ − A₋, real and imaginary parts, as _add_row needs them.
    waves : Waves; its amplitudes and totals are overwritten.
    """
    for c in range(7):
        waves.totals[0, c] = 0.0

    for row in range(waves.sizes[N_ROWS]):
        for c in range(waves.rows[row, N_CELLS]):
            cell = waves.rows[row, FIRST] + c
            for side in range(2):
                rc = _added(waves, cell, 4 * side)
                im = _added(waves, cell, 4 * side + 1)
                rs = _added(waves, cell, 4 * side + 2)
                ic = _added(waves, cell, 4 * side + 3)
                up = waves.weights[cell, 2 * side]
                down = waves.weights[cell, 2 * side + 1]
                # S for c and for −c
                ur = rc - im
                ui = rs + ic
                dr = rc + im
                di = ic - rs
                amplitudes = waves.amplitudes[cell]
                amplitudes[4 * side] = up * ur + down * dr
                amplitudes[4 * side + 1] = -(up * ui + down * di)
                amplitudes[4 * side + 2] = up * ur - down * dr
                amplitudes[4 * side + 3] = down * di - up * ui
                if waves.detail != FORCES:
                    a = waves.rows[row, A]
                    b = waves.rows[row, B] * (1 - 2 * side)
                    bend = waves.bends[cell, 2 * side]
                    _count(waves, (a, b, c), up, bend, ur * ur + ui * ui)
                    bend = waves.bends[cell, 2 * side + 1]
                    _count(waves, (a, b, -c), down, bend, dr * dr + di * di)

    return GO_ON


@scalar
def _added(waves, cell, part):
    """One of the sums of a cell, of all chunks and lanes [√(energy · length)].

    part : 0 to 7, see _add_cell.
    """
    n_lanes = np.uintp(count(waves.lanes))
    at = np.uintp(cell * SUMS + part) * n_lanes
    added = 0.0
    for chunk in range(waves.sums.shape[0]):
        added += total(load(waves.sums[chunk], at, waves.lanes))
    return added


@scalar
def _count(waves, wave, weight, bend, size2):
    """totals += energy and virial of one wave.

        u = w |S|²,   W = u 1 + 2 (dw/dk²) |S|² k ⊗ k

    wave : (a, b, c).
    weight, bend : w and dw/dk² [1/length³], [1/length].
    size2 : |S|² [energy · length].
    """
    inverse = waves.inverse
    totals = waves.totals
    kx = 2.0 * pi * across(inverse, 0, wave)
    ky = 2.0 * pi * across(inverse, 1, wave)
    kz = 2.0 * pi * across(inverse, 2, wave)
    u = weight * size2
    g = 2.0 * bend * size2
    totals[0, 0] += u
    totals[0, 1] += u + g * kx * kx
    totals[0, 2] += u + g * ky * ky
    totals[0, 3] += u + g * kz * kz
    totals[0, 4] += g * ky * kz
    totals[0, 5] += g * kx * kz
    totals[0, 6] += g * kx * ky


@called_kernel
def push_atoms(waves, chunk):
    """forces += those of all waves on a chunk of atoms.

        F = 2 q/V Σ_k L̂(k) k Im(S* exp(i k·r)), over half of the waves,   k = 2π (a, b, c) · inverse

    In fixed-point arithmetic each is rounded, and their sum kept in rest, see balance_impulses.
    """
    n = waves.charges.size
    n_chunks = waves.tables.shape[0]
    lanes = waves.lanes
    table = waves.tables[chunk]
    at = np.uintp(waves.sizes[F])
    n_lanes = np.uintp(count(lanes))
    block = np.uintp(BLOCK)
    first, last = share_of(chunk, n_chunks, n)
    for d in range(3):
        waves.rest[chunk, d] = 0

    for start in range(first, last, BLOCK):
        stop = min(start + BLOCK, last)
        _fill_tables(waves, table, start, stop)
        for k in range(np.uintp(0), np.uintp(3 * BLOCK), n_lanes):
            store(table, at + k, zeros(lanes))

        for row in range(waves.sizes[N_ROWS]):
            _multiply(waves, table, row)
            for k in range(np.uintp(0), block, n_lanes):
                _add_row(waves, table, row, k)

        for i in range(start, stop):
            k = at + np.uintp(i - start)
            fractional = table[k], table[k + block], table[k + block + block]
            for d in range(3):
                f = 4.0 * pi * across(waves.inverse, d, fractional)
                g = force_along(f, 1.0, waves.steps)
                waves.forces[np.uintp(i), d] += g
                waves.rest[chunk, d] += g

    return GO_ON


@scalar
def _add_row(waves, table, row, k):
    """Fractional forces of the waves of a row on as many atoms as a vector has lanes.

        fa += a Σ Im(A X Y Z),   fb += b Σ Im(A X Y Z),   fc += Σ c Im(A X Y Z)

    The sums over c of A Z and c A Z are made first, for P and M at once; then each is multiplied by X Y once.
    table : of the chunk; its place F grows.
    row : number of the row.
    k : of the first atom, in the block.
    """
    lanes = waves.lanes
    block = np.uintp(BLOCK)
    at = np.uintp(waves.sizes[XY]) + k
    at_z = np.uintp(waves.sizes[Z]) + k
    at_f = np.uintp(waves.sizes[F]) + k
    pr = pi_ = mr = mi = pzr = pzi = mzr = mzi = zeros(lanes)  # Σ A Z, and Σ c A Z
    n = zeros(lanes)
    first = np.uintp(waves.rows[row, FIRST])

    for cell in range(first, first + np.uintp(waves.rows[row, N_CELLS])):
        a = waves.amplitudes[cell]
        zc, zs = _complex_at(table, at_z, lanes)
        nc = n * zc
        ns = n * zs
        pr = fma(zc, a[0], fma(zs, -a[3], pr))
        pi_ = fma(zc, a[1], fma(zs, a[2], pi_))
        pzr = fma(nc, a[2], fma(ns, -a[1], pzr))
        pzi = fma(nc, a[3], fma(ns, a[0], pzi))
        mr = fma(zc, a[4], fma(zs, -a[7], mr))
        mi = fma(zc, a[5], fma(zs, a[6], mi))
        mzr = fma(nc, a[6], fma(ns, -a[5], mzr))
        mzi = fma(nc, a[7], fma(ns, a[4], mzi))
        n = n + 1.0
        at_z = at_z + block + block

    xr, xi = _complex_at(table, at, lanes)
    yr, yi = _complex_at(table, at + block + block, lanes)
    of_p = fma(xr, pi_, xi * pr)
    of_m = fma(yr, mi, yi * mr)
    of_z = fma(xr, pzi, xi * pzr) + fma(yr, mzi, yi * mzr)
    a = float(waves.rows[row, A])
    b = float(waves.rows[row, B])

    fa = load(table, at_f, lanes)
    store(table, at_f, fma(of_p + of_m, a, fa))
    at_f = at_f + block
    fb = load(table, at_f, lanes)
    store(table, at_f, fma(of_p - of_m, b, fb))
    at_f = at_f + block
    fc = load(table, at_f, lanes)
    store(table, at_f, of_z + fc)


@called_kernel
def balance_impulses(waves, _chunk):
    """The impulses of all waves add up to a few steps, left by rounding: the chosen atom gives them back."""
    for chunk in range(waves.rest.shape[0]):
        for d in range(3):
            waves.forces[waves.chosen[0], d] -= waves.rest[chunk, d]
    return GO_ON


def virials_of(k: Array, weights: Array, bends: Array) -> Array:
    """W/|S|² = w 1 + 2 (dw/dk²) k ⊗ k of waves k (M, 3), as xx yy zz yz xz xy, (M, 6)."""
    products = k[:, VOIGT[0]] * k[:, VOIGT[1]]
    virials = 2.0 * bends[:, None] * products
    virials[:, :3] += weights[:, None]
    return virials


class ChargeSum(OwnTerm):
    """A sum over the waves of the charges of a system.
    charges : (N,) [√(energy · length)].
    split : of 1/r."""

    name = "Coulomb's sum over waves"

    def __init__(self, system: System, charges: Array, split: Split) -> None:
        self._charges = charges
        self._split = split
        self._calls = DirectCalls()
        self._n_chunks = min(n_chunks_of(len(charges)), MOST_SUMS)
        self._energy = -0.5 * split.at_zero * charges**2  # of each charge with its own smooth part
        self._net = float(sum_in_any_order(charges))
        self._lattice, self._inverse = np.zeros((2, 3, 3))
        self._totals = np.zeros((1, 7))
        self._said = (
            f"error of forces at most {split.bound:.1g} of their rms, or of that between neighbors"
        )

    def _keep(self, system: System) -> None:
        """Take the present cell, without LAPACK, whose rounding depends on the processor."""
        lattice = system.cell.lattice
        normals = np.cross(lattice[[1, 2, 0]], lattice[[2, 0, 1]])
        volume = float((lattice[0] * normals[0]).sum())
        self._lattice[:] = lattice
        self._inverse[:] = (normals / volume).T
        self._volume = abs(volume)

    def _of_atoms(self) -> tuple[Array, Array]:
        """Each atom's share of energy and virial, (N,) and (N, 6)."""
        raise NotImplementedError

    def collect(self, target: Target) -> None:
        """See Term."""
        if target.detail == FORCES:
            return
        # the uniform background fills what S leaves of a net charge
        background = -0.5 * self._net**2 / self._volume * self._split.moment
        if target.detail == PER_ATOM:
            # of each charge q: q Q
            shares = -0.5 * self._charges * self._net / self._volume * self._split.moment
            energies, virials = self._of_atoms()
            target.energies[:] += energies + self._energy + shares
            target.virials[:] += virials
            target.virials[:, :3] += shares[:, None]
        else:
            totals = self._totals[0].copy()
            totals[:4] += background
            totals[0] += sum_in_any_order(self._energy)
            totals = on_grid(totals, target.steps.energy if target.steps else 0.0)
            target.energies[0] += totals[0]
            target.virials[0] += totals[1:]


class WaveSum(ChargeSum):
    """The sum wave by wave."""

    fits_grid = True

    def __init__(self, system: System, charges: Array, split: Split) -> None:
        super().__init__(system, charges, split)
        self._sizes = np.zeros(7, dtype=np.int64)
        self._lanes = lanes_for()
        self._chosen = np.zeros(1, np.int64)
        rows, weights, bends = self._waves(system)
        room = int(ROOM * len(weights)) + 8
        self._rows = np.zeros((room, 4), np.int64)
        self._weights = np.zeros((room, 4))
        self._bends = np.zeros((room, 4))
        self._room = int(ROOM * self._places(rows)[-1]) + 8 * BLOCK + 3 * BLOCK
        self._tables = np.zeros((self._n_chunks, self._room))
        self._sums = np.zeros((self._n_chunks, room * SUMS * self._lanes.size))
        self._amplitudes = np.zeros((room, AMPLITUDES))
        self._take(system, rows, weights, bends)

    @property
    def n_waves(self) -> int:
        """The number of waves, k and −k as one."""
        weights = self._weights[: self._sizes[N_ALL]]
        return int(np.count_nonzero(weights))

    @property
    def summary(self) -> str:  # type: ignore[override]
        """The sum, for the report."""
        return f"sum over {self.n_waves} waves ({self._said})"

    def follow(self, system: System) -> bool:
        """See Term."""
        rows, weights, bends = self._waves(system)
        has_tables = self._places(rows)[-1] + 3 * BLOCK <= self._room
        if len(weights) > len(self._weights) or not has_tables:
            return False
        self._take(system, rows, weights, bends)
        return True

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        rounder = rounder_for(self._charges) if target.steps else ()
        waves = Waves(
            positions=system.positions,
            charges=self._charges,
            rounder=rounder,
            lattice=self._lattice,
            inverse=self._inverse,
            chosen=self._chosen,
            sizes=self._sizes,
            rows=self._rows,
            weights=self._weights,
            bends=self._bends,
            tables=self._tables,
            sums=self._sums,
            amplitudes=self._amplitudes,
            totals=self._totals,
            rest=np.zeros_like(target.forces[: self._n_chunks]),
            forces=target.forces,
            steps=target.steps,
            detail=target.detail,
            lanes=self._lanes,
        )
        if target.steps:
            yield operation(self._calls, choose_atom, waves)
        yield operation(self._calls, sum_waves, waves, self._n_chunks)
        yield operation(self._calls, weigh_waves, waves)
        yield operation(self._calls, push_atoms, waves, self._n_chunks)
        if target.steps:
            yield operation(self._calls, balance_impulses, waves)

    def _waves(self, system: System) -> tuple[Indices, Array, Array]:
        """rows, weights and bends for the present cell."""
        lattice = system.cell.lattice
        largest = self._split.largest_wave
        self._keep(system)
        ends = np.floor(largest * np.linalg.norm(lattice, axis=1) / (2.0 * pi))
        needed = float(np.prod(ends + 1.0))
        if needed > MOST_CELLS:
            raise ValueError(
                f"cutoff of Coulomb must be larger; {self._split.cutoff:.3g} needs some {2.0 * needed:.1g} waves "
                f"in this cell, but at most {2 * MOST_CELLS} are allowed"
            )

        most = ends.astype(np.int64)
        axes = [np.arange(n + 1) for n in most]
        cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        k = np.einsum("csi,di->csd", cells[:, None] * SIGNS, 2.0 * pi * self._inverse)
        k2 = (k**2).sum(axis=-1)  # (C, 4)
        a, b, c = (cells[:, None, d] for d in range(3))
        # of ±b, and of ±c, the same waves once
        has_two_b = (a > 0) & (b > 0)
        has_two_c = (c > 0) & ((a > 0) | (b > 0))
        is_new_b = (SIGNS[:, 1] > 0) | has_two_b
        is_new_c = (SIGNS[:, 2] > 0) | has_two_c
        is_inside = (k2 > 0.0) & (k2 <= largest**2)
        counts = is_new_b & is_new_c & is_inside

        # cells without such waves are left out at the end of each row
        height = np.where(counts.any(axis=1), cells[:, 2] + 1, 0)
        firsts = np.flatnonzero(cells[:, 2] == 0)
        place = cells[:, 0] * (most[1] + 1) + cells[:, 1]
        n_cells = np.maximum.reduceat(height, firsts)
        kept = cells[:, 2] < n_cells[place]
        firsts = firsts[n_cells > 0]
        n_cells = n_cells[n_cells > 0]
        first_cells = np.cumsum(n_cells) - n_cells
        rows = np.column_stack([cells[firsts, :2], first_cells, n_cells])
        self._cells = cells[kept]
        counts = counts[kept]
        k2 = k2[kept]
        spectrum, bend = self._split.spectrum(np.where(counts, k2, 1.0))
        weights = np.where(counts, spectrum, 0.0) / self._volume
        bends = np.where(counts, bend, 0.0) / self._volume
        return rows, weights, bends

    def _places(self, rows: Indices) -> Indices:
        """Where the tables X, Y, Z, XY and those of forces begin."""
        largest = rows.max(axis=0, initial=0)
        of_x = 2 * BLOCK * (largest[A] + 1)
        of_y = 2 * BLOCK * (largest[B] + 1)
        of_z = 2 * BLOCK * largest[N_CELLS]
        return np.cumsum([0, of_x, of_y, of_z, 4 * BLOCK])

    def _take(self, system: System, rows: NDArray, weights: NDArray, bends: NDArray) -> None:
        """Write waves to memory that stays in its place: operations know its address."""
        self._rows[: len(rows)] = rows
        self._weights[: len(weights)] = weights
        self._bends[: len(bends)] = bends
        self._sizes[:] = len(rows), len(weights), *self._places(rows)
        self._positions = system.positions

    def _of_atoms(self) -> tuple[Array, Array]:
        """Each atom's share of energy and virial: q Re(Σ w S* exp(i k·r)), and so on; (N,) and (N, 6)."""
        n_all = self._sizes[N_ALL]
        used = self._weights[:n_all] != 0.0
        weights = self._weights[:n_all][used]
        bends = self._bends[:n_all][used]
        k = 2.0 * pi * (self._cells[:, None] * SIGNS)[used] @ self._inverse.T
        n_atoms = len(self._charges)
        blocks = np.array_split(np.arange(n_atoms), -(-n_atoms // BLOCK))
        amplitudes = sum(self._phases(block, k).sum(axis=0) for block in blocks)
        conjugate = np.conj(amplitudes)
        energies = []
        virials = []

        for block in blocks:
            share = (self._phases(block, k) * conjugate).real
            energies.append(share @ weights)
            virials.append(share @ virials_of(k, weights, bends))

        return np.concatenate(energies), np.concatenate(virials)

    def _phases(self, atoms: Indices, k: Array) -> NDArray:
        """q exp(i k·r) of some atoms, (atoms, waves)."""
        angles = self._positions[atoms] @ k.T
        return np.exp(1j * angles) * self._charges[atoms, None]
