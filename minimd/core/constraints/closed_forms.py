"""Constraints in closed form: bonds that share no atom, linear molecules of three atoms, and triangles such as water.

As many bonds or molecules at a time as a vector has lanes; lanes that are too many repeat the last one, whose atoms
then are written several times, the same each time. Solvers return the largest number of iterations, here 1; n < 0 says
that the bond (or molecule) −1 − n could not be kept.

Bonds

    drift        r′ = p + λ w s,  |r′|² = d²        p = s + Δt v_ij,  w = 1/m_i + 1/m_j,  λ the root nearest to zero
    velocities   v′_ij = v_ij + μ w r,  r · v′_ij = 0

s is r_j − r_i + offset before the drift, r is the same now. H. C. Andersen, J. Comput. Phys. 52, 24 (1983).

Linear molecules. Three fixed lengths cannot constrain them: at 180° their gradients are linearly dependent.

    b = α a + β c,  |c − a| = d      with α = |bc|/|ac|, β = |ab|/|ac|

These are three linear constraints and one length. They are solved by two multipliers, a vector μ on b and a number λ
along s = c − a before the drift, with the forces (−α μ − λ s, μ, −β μ + λ s) on a, b and c.
With e = b − α a − β c and p = c − a after the drift

    κ = α/m_a − β/m_c      Q = 1/m_b + α²/m_a + β²/m_c      W = 1/m_a + 1/m_c − κ²/Q
    μ = −(e + λ κ s)/Q     |p − κ e/Q + λ W s|² = d²

G. Ciccotti, M. Ferrario, J.-P. Ryckaert, Mol. Phys. 47, 1253 (1982).

SETTLE: the drift of rigid triangles with two equal sides and two equal masses, such as water.

Positions are relative to the center of mass: 0 before the drift, 1 after it, 3 with the constraints. a is the apex, b
and c are the other atoms. r_a and r_b are the distances of the center of mass from a and from the middle of bc, r_c is
half of |bc|. The axes are z ∥ b₀ × c₀ (with b₀, c₀ taken from a), x ∥ a₁ × z and y = z × x. The new triangle is an
upright one in the plane of x and y, turned by ψ around y, φ around x and θ around z:

    sin φ = z_a1/r_a                                      sin ψ = (z_b1 − z_c1)/(2 r_c cos φ)
    b₂ = (−r_c cos ψ, −r_b cos φ − r_c sin ψ sin φ)       c₂ = (r_c cos ψ, −r_b cos φ + r_c sin ψ sin φ)
    α = x_b2 (x_b0 − x_c0) + y_b0 y_b2 + y_c0 y_c2        β = x_b2 (y_c0 − y_b0) + x_b0 y_b2 + x_c0 y_c2
    γ = x_b0 y_b1 − x_b1 y_b0 + x_c0 y_c1 − x_c1 y_c0     sin θ = (α γ − β √(α² + β² − γ²))/(α² + β²)
    r₃ = (x₂ cos θ − y₂ sin θ,  x₂ sin θ + y₂ cos θ,  z₁)  of b and c

θ solves α sin θ + β cos θ = γ: the forces of the constraints act along the old bonds, so that m (r₃ − r₁) has no moment
about the old a. S. Miyamoto, P. A. Kollman, J. Comput. Chem. 13, 952 (1992), eq. A8-A17.

So m (r₃ − r₁) is a sum of impulses along the old bonds, equal and opposite on the two atoms of each. These impulses are
applied: the rounding of r₃, divided by a short Δt, then changes neither momentum nor angular momentum. With δ = r₃ −
r₁, e₀ = c₀ − b₀, plane vectors u × w = x_u y_w − y_u x_w, and λ in units of the mass of b:

    λ_ab = δ_b × e₀/(b₀ × c₀)      λ_ac = δ_c × e₀/(b₀ × c₀)      λ_bc = (δ_b × b₀ − δ_c × c₀)/(2 b₀ × c₀)
    δ_b = λ_ab b₀ − λ_bc e₀        δ_c = λ_ac c₀ + λ_bc e₀        m_a δ_a = −m_b (λ_ab b₀ + λ_ac c₀)
"""

from collections import namedtuple
from math import sqrt

import numpy as np
from numba import types

from minimd.core.compiled.kernels import by_type, inlined, kernel, scalar, type_of
from minimd.core.compiled.simd import bits_from_mask, lane, select, trailing_zeros, with_lane, zeros
from minimd.core.compiled.simd.vector import count
from minimd.core.structure.vectors import combined, cross, dot, minus, plus, times, unit

NOTHING = -1


class Atoms(namedtuple("Atoms", "positions vectors inverse_masses lanes")):
    """positions : (N, 3) [length].
    vectors : (N, 3) velocities or accelerations.
    inverse_masses : (N,) [1/mass].
    lanes : Lanes."""


class Bonds(namedtuple("Bonds", "first second offsets lengths2 tolerance")):
    """first, second : (K,) atoms.
    offsets : (K, 3) [length], added to r_j − r_i.
    lengths2 : (K,) d² [length²].
    tolerance : of |r² − d²|/d²."""


class TriatomicMolecules(namedtuple("TriatomicMolecules", "atoms offsets shapes sides")):
    """atoms : three of (M,), a, b, c.
    offsets : two of (M, 3), of b and c from a [length].
    shapes : some of (M,), see each solver.
    sides : the constraints with a target and a multiplier, (M,) int or three of them, ab, ac, bc."""


@by_type
def _place(at, block, n):
    """The place of lane n of a block (k, end, lanes): at[k + n] or, if at is (), k + n.
    Lanes from the end on repeat the last one before."""
    if isinstance(at, types.Array):
        return lambda at, block, n: np.uintp(at[min(block[0] + n, block[1] - 1)])
    return lambda at, block, n: np.uintp(min(block[0] + n, block[1] - 1))


@scalar
def numbers(values, at, block):
    """A vector: lane n has the value of the n-th item of a block.

    values : (N,).
    at, block : see _place."""
    x = zeros(block[2])
    for n in range(count(block[2])):
        x = with_lane(x, n, values[_place(at, block, n)])
    return x


@scalar
def rows(values, at, block):
    """Vectors x, y, z: lane n has those of the n-th item of a block.

    values : (N, 3).
    at, block : see _place."""
    x = y = z = zeros(block[2])
    for n in range(count(block[2])):
        i = _place(at, block, n)
        x = with_lane(x, n, values[i, 0])
        y = with_lane(y, n, values[i, 1])
        z = with_lane(z, n, values[i, 2])
    return x, y, z


@scalar
def put_numbers(values, at, block, x):
    """The opposite of numbers: values (N,) of the items of a block = the lanes of x."""
    for n in range(count(block[2])):
        values[_place(at, block, n)] = lane(x, n)


@scalar
def put_rows(values, at, block, xyz):
    """The opposite of rows: values (N, 3) of the items of a block = the lanes of x, y, z."""
    x, y, z = xyz
    for n in range(count(block[2])):
        i = _place(at, block, n)
        values[i, 0] = lane(x, n)
        values[i, 1] = lane(y, n)
        values[i, 2] = lane(z, n)


@inlined
def add_opposite(vectors, inverse_masses, bonds, k, scale, s):
    """Opposite impulses on the two atoms of a bond k, from i to j:

        x_j += scale s/m_j,  x_i −= scale s/m_i

    vectors : (N, 3), changed: positions or velocities.
    inverse_masses : (N,) [1/mass].
    bonds : Bonds.
    s : (3,), along the bond."""
    i, j = bonds.first[k], bonds.second[k]
    on_i = scale * inverse_masses[i]
    on_j = scale * inverse_masses[j]
    for x in range(3):
        vectors[i, x] -= on_i * s[x]
        vectors[j, x] += on_j * s[x]


@kernel
def drift_some(positions, velocities, atoms, duration):
    """positions += duration · velocities, of some atoms.

    positions, velocities : (N, 3).
    atoms : (F,) their numbers.
    duration : [time]."""
    for i in atoms:
        for x in range(3):
            positions[i, x] += duration * velocities[i, x]


def in_blocks(treat):
    """A solver of components first to last − 1, a block of lanes at a time: treat(block, atoms, *arguments) returns how
    many could be kept; that of lanes or more if all."""

    @scalar
    def solver(first, last, atoms, *arguments):
        for k in range(first, last, count(atoms.lanes)):
            n_kept = treat((k, last, atoms.lanes), atoms, *arguments)
            if n_kept < count(atoms.lanes):
                return NOTHING - k - n_kept
        return 1

    return solver


@scalar
def n_without_failure(least):
    """The number of the first lane that is negative or no number; that of lanes or more if there is none."""
    return np.int64(trailing_zeros(np.uint64(~bits_from_mask(least >= 0.0))))


@scalar
def drift_pairs(block, atoms, bonds, duration):
    """Drift of bonds that share no atom.

        a λ² + 2 b λ + c = 0,  a = w² s²,  b = w p · s,  c = p² − d²

    atoms : Atoms, changed.
    bonds : Bonds.
    duration : [time]."""
    positions, velocities, inverse_masses, _ = atoms
    i, j = bonds.first, bonds.second
    x, y = rows(positions, i, block), rows(positions, j, block)
    u, v = rows(velocities, i, block), rows(velocities, j, block)
    wi, wj = numbers(inverse_masses, i, block), numbers(inverse_masses, j, block)
    s = plus(minus(y, x), rows(bonds.offsets, (), block))
    p = combined(1.0, s, duration, minus(v, u))
    w = wi + wj

    a = w * w * dot(s, s)
    b = w * dot(p, s)
    c = dot(p, p) - numbers(bonds.lengths2, (), block)
    discriminant = b * b - a * c
    n_kept = n_without_failure(select(b > 0.0, discriminant, -1.0))
    if n_kept >= count(block[2]):
        scale = -c / (b + sqrt(discriminant)) / duration
        u = combined(1.0, u, -scale * wi, s)
        v = combined(1.0, v, scale * wj, s)
        put_rows(velocities, i, block, u)
        put_rows(velocities, j, block, v)
        put_rows(positions, i, block, combined(1.0, x, duration, u))
        put_rows(positions, j, block, combined(1.0, y, duration, v))

    return n_kept


@scalar
def project_pairs(block, atoms, bonds, targets, multipliers):
    """Vectors of bonds, given a component along each bond: r · (x_j − x_i) = target.

    Velocities with targets 0 keep the lengths; accelerations with −v².
    atoms : Atoms; its vectors are changed.
    bonds : Bonds.
    targets : (K,) [length · that of vectors].
    multipliers : (K,), output: x_j gains multiplier r/m_j."""
    positions, vectors, inverse_masses, _ = atoms
    i, j = bonds.first, bonds.second
    x, y = rows(positions, i, block), rows(positions, j, block)
    u, v = rows(vectors, i, block), rows(vectors, j, block)
    wi, wj = numbers(inverse_masses, i, block), numbers(inverse_masses, j, block)
    r = plus(minus(y, x), rows(bonds.offsets, (), block))
    scale = (numbers(targets, (), block) - dot(r, minus(v, u))) / ((wi + wj) * dot(r, r))
    put_numbers(multipliers, (), block, scale)
    put_rows(vectors, i, block, combined(1.0, u, -scale * wi, r))
    put_rows(vectors, j, block, combined(1.0, v, scale * wj, r))
    return count(block[2])


@scalar
def corners(values, atoms, block):
    """The rows of values (N, 3) that belong to the atoms a, b, c of molecules."""
    return (
        rows(values, atoms[0], block),
        rows(values, atoms[1], block),
        rows(values, atoms[2], block),
    )


@scalar
def put_corners(values, atoms, block, xyz):
    """Write them."""
    put_rows(values, atoms[0], block, xyz[0])
    put_rows(values, atoms[1], block, xyz[1])
    put_rows(values, atoms[2], block, xyz[2])


@scalar
def three(values, at, block):
    """The numbers at three places, of each molecule of a block."""
    return (
        numbers(values, at[0], block),
        numbers(values, at[1], block),
        numbers(values, at[2], block),
    )


@scalar
def arms(abc, offsets, block):
    """r_b − r_a and r_c − r_a of molecules, from the positions of their atoms."""
    a, b, c = abc
    to_b = plus(minus(b, a), rows(offsets[0], (), block))
    to_c = plus(minus(c, a), rows(offsets[1], (), block))
    return to_b, to_c


@scalar
def inertia(masses, alpha, beta):
    """κ, Q and W of linear molecules.
    masses : inverse, of a, b, c."""
    wa, wb, wc = masses
    kappa = alpha * wa - beta * wc
    q = wb + alpha * alpha * wa + beta * beta * wc
    return kappa, q, wa + wc - kappa * kappa / q


@scalar
def pushed(vectors, masses, alpha, beta, mu, along):
    """Vectors of a, b, c + M⁻¹ times (−α μ − λ s, μ, −β μ + λ s).

    masses : inverse, of a, b, c.
    mu : μ.
    along : λ s."""
    a, b, c = vectors
    wa, wb, wc = masses
    on_a = combined(alpha, mu, 1.0, along)
    on_c = combined(beta, mu, -1.0, along)
    return combined(1.0, a, -wa, on_a), combined(1.0, b, wb, mu), combined(1.0, c, -wc, on_c)


@scalar
def moved(abc, duration, velocities):
    """Positions of a, b, c after a drift."""
    return (
        combined(1.0, abc[0], duration, velocities[0]),
        combined(1.0, abc[1], duration, velocities[1]),
        combined(1.0, abc[2], duration, velocities[2]),
    )


@scalar
def drift_linear(block, atoms, molecules, duration):
    """Drift of linear molecules, b in the middle.

    atoms : Atoms, changed.
    molecules : TriatomicMolecules; shapes : α, β, d² [length²].
    duration : [time]."""
    abc, offsets, shapes, _ = molecules
    before = corners(atoms.positions, abc, block)
    velocities = corners(atoms.vectors, abc, block)
    masses = three(atoms.inverse_masses, abc, block)
    alpha = numbers(shapes[0], (), block)
    beta = numbers(shapes[1], (), block)
    length2 = numbers(shapes[2], (), block)
    kappa, q, w = inertia(masses, alpha, beta)

    after = moved(before, duration, velocities)
    _, s = arms(before, offsets, block)
    to_b, p = arms(after, offsets, block)
    e = combined(1.0, to_b, -beta, p)
    p = combined(1.0, p, -kappa / q, e)

    along = w * dot(p, s)
    square = w * w * dot(s, s)
    gap = dot(p, p) - length2
    discriminant = along * along - square * gap
    n_kept = n_without_failure(select(along > 0.0, discriminant, -1.0))
    if n_kept >= count(block[2]):
        scale = -gap / (along + sqrt(discriminant))
        mu = combined(-1.0 / q, e, -scale * kappa / q, s)
        after = pushed(after, masses, alpha, beta, mu, times(scale, s))
        put_corners(atoms.positions, abc, block, after)
        mu = times(1.0 / duration, mu)
        push = times(scale / duration, s)
        velocities = pushed(velocities, masses, alpha, beta, mu, push)
        put_corners(atoms.vectors, abc, block, velocities)

    return n_kept


@scalar
def project_linear(block, atoms, molecules, targets, multipliers):
    """Vectors x of molecules: x_b = α x_a + β x_c, and r · (x_c − x_a) = target.
    Arguments as drift_linear, project_pairs."""
    abc, offsets, shapes, side = molecules
    vectors = corners(atoms.vectors, abc, block)
    a, b, c = vectors
    masses = three(atoms.inverse_masses, abc, block)
    alpha = numbers(shapes[0], (), block)
    beta = numbers(shapes[1], (), block)
    kappa, q, w = inertia(masses, alpha, beta)
    _, r = arms(corners(atoms.positions, abc, block), offsets, block)
    e = minus(b, combined(alpha, a, beta, c))
    along = dot(r, combined(1.0, minus(c, a), -kappa / q, e))
    scale = (numbers(targets, side, block) - along) / (w * dot(r, r))
    put_numbers(multipliers, side, block, scale)
    mu = combined(-1.0 / q, e, -scale * kappa / q, r)
    vectors = pushed(vectors, masses, alpha, beta, mu, times(scale, r))
    put_corners(atoms.vectors, abc, block, vectors)
    return count(block[2])


@scalar
def impulses(b0, c0, drifted, r_a, r_b, r_c):
    """λ_ab, λ_ac, λ_bc of triangles [dimensionless], and a number that is negative, or none, where they do not exist.
    b0, c0 : separations a to b and a to c before the drift.
    drifted : a₁, b₁, c₁.
    r_a, r_b, r_c : see above.
        All [length]."""
    a1, b1, c1 = drifted
    z = unit(cross(b0, c0))
    x = unit(cross(a1, z))
    y = cross(z, x)

    sin_phi = dot(a1, z) / r_a
    cos_phi2 = 1.0 - sin_phi * sin_phi
    cos_phi = sqrt(cos_phi2)
    sin_psi = (dot(b1, z) - dot(c1, z)) / (2.0 * r_c * cos_phi)
    cos_psi2 = 1.0 - sin_psi * sin_psi
    cos_psi = sqrt(cos_psi2)

    xb = -r_c * cos_psi
    yb = -r_b * cos_phi - r_c * sin_psi * sin_phi
    yc = -r_b * cos_phi + r_c * sin_psi * sin_phi

    xb0, yb0 = dot(b0, x), dot(b0, y)
    xc0, yc0 = dot(c0, x), dot(c0, y)
    xb1, yb1 = dot(b1, x), dot(b1, y)
    xc1, yc1 = dot(c1, x), dot(c1, y)

    alpha = xb * (xb0 - xc0) + yb0 * yb + yc0 * yc
    beta = xb * (yc0 - yb0) + xb0 * yb + xc0 * yc
    gamma = xb0 * yb1 - xb1 * yb0 + xc0 * yc1 - xc1 * yc0
    square = alpha * alpha + beta * beta
    rest = square - gamma * gamma
    sine = (alpha * gamma - beta * sqrt(rest)) / square
    cosine = sqrt(max(1.0 - sine * sine, 0.0))

    dxb = xb * cosine - yb * sine - xb1
    dyb = xb * sine + yb * cosine - yb1
    dxc = -xb * cosine - yc * sine - xc1
    dyc = -xb * sine + yc * cosine - yc1

    xe, ye = xc0 - xb0, yc0 - yb0
    area = xb0 * yc0 - yb0 * xc0
    ab = (dxb * ye - dyb * xe) / area
    ac = (dxc * ye - dyc * xe) / area
    bc = 0.5 * (dxb * yb0 - dyb * xb0 - dxc * yc0 + dyc * xc0) / area
    exist = select(cos_phi2 > 0.0, select(cos_psi2 > 0.0, rest, -1.0), -1.0)
    return ab, ac, bc, exist


@scalar
def drift_triangles(block, atoms, triangles, duration):
    """Drift of triangles by SETTLE.

    atoms : Atoms, changed.
    triangles : TriatomicMolecules; shapes : r_a, r_b, r_c [length], and the share of b, and of c, in the mass.
    duration : [time]."""
    abc, offsets, shapes, _ = triangles
    push = 1.0 / duration
    before = corners(atoms.positions, abc, block)
    u, v, w = corners(atoms.vectors, abc, block)
    r_a = numbers(shapes[0], (), block)
    r_b = numbers(shapes[1], (), block)
    r_c = numbers(shapes[2], (), block)
    share = numbers(shapes[3], (), block)
    b0, c0 = arms(before, offsets, block)
    p = combined(1.0, b0, duration, minus(v, u))
    q = combined(1.0, c0, duration, minus(w, u))
    a1 = combined(-share, p, -share, q)
    ab, ac, bc, exist = impulses(b0, c0, (a1, plus(a1, p), plus(a1, q)), r_a, r_b, r_c)
    n_kept = n_without_failure(exist)
    if n_kept >= count(block[2]):
        on_bc = times(bc, minus(c0, b0))
        u = combined(1.0, u, -share / (1.0 - 2.0 * share) * push, combined(ab, b0, ac, c0))
        v = combined(1.0, v, push, combined(ab, b0, -1.0, on_bc))
        w = combined(1.0, w, push, combined(ac, c0, 1.0, on_bc))
        put_corners(atoms.vectors, abc, block, (u, v, w))
        put_corners(atoms.positions, abc, block, moved(before, duration, (u, v, w)))

    return n_kept


@scalar
def project_triangles(block, atoms, triangles, targets, multipliers):
    """Vectors of triangles, given a component along each side: r · (x_j − x_i) = target.

        A λ = targets − r · x,  A_kl = ±(r_k · r_l)/m of the shared atom

    by the inverse of A; projected twice, to remove the rounding of the first projection.
    Arguments as project_pairs."""
    abc, offsets, _, sides = triangles
    ab, ac = arms(corners(atoms.positions, abc, block), offsets, block)
    bc = minus(ac, ab)
    u, v, w = three(atoms.inverse_masses, abc, block)

    g = dot(ab, ab)
    h = dot(ac, ac)
    k = dot(ab, ac)

    # A and its adjugate
    xx = (u + v) * g
    yy = (u + w) * h
    zz = (v + w) * (g + h - k - k)
    xy = u * k
    xz = v * (g - k)
    yz = w * (h - k)

    minor_xx = yy * zz - yz * yz
    minor_yy = xx * zz - xz * xz
    minor_zz = xx * yy - xy * xy
    minor_xy = xz * yz - xy * zz
    minor_xz = xy * yz - xz * yy
    minor_yz = xy * xz - xx * yz

    scale = 1.0 / (xx * minor_xx + xy * minor_xy + xz * minor_xz)

    of_ab, of_ac, of_bc = three(targets, sides, block)
    a, b, c = corners(atoms.vectors, abc, block)
    sum_ab = sum_ac = sum_bc = 0.0 * scale

    for _ in range(2):
        x = of_ab - dot(ab, minus(b, a))
        y = of_ac - dot(ac, minus(c, a))
        z = of_bc - dot(bc, minus(c, b))
        on_ab = scale * (minor_xx * x + minor_xy * y + minor_xz * z)
        on_ac = scale * (minor_xy * x + minor_yy * y + minor_yz * z)
        on_bc = scale * (minor_xz * x + minor_yz * y + minor_zz * z)
        a = combined(1.0, a, -u, combined(on_ab, ab, on_ac, ac))
        b = combined(1.0, b, v, combined(on_ab, ab, -on_bc, bc))
        c = combined(1.0, c, w, combined(on_ac, ac, on_bc, bc))
        sum_ab = sum_ab + on_ab
        sum_ac = sum_ac + on_ac
        sum_bc = sum_bc + on_bc

    put_corners(atoms.vectors, abc, block, (a, b, c))

    put_numbers(multipliers, sides[0], block, sum_ab)
    put_numbers(multipliers, sides[1], block, sum_ac)
    put_numbers(multipliers, sides[2], block, sum_bc)
    return count(block[2])


DriftPairs = type_of(in_blocks(drift_pairs))(namedtuple("DriftPairs", ()))
ProjectPairs = type_of(in_blocks(project_pairs))(namedtuple("ProjectPairs", ()))
DriftLinear = type_of(in_blocks(drift_linear))(namedtuple("DriftLinear", ()))
ProjectLinear = type_of(in_blocks(project_linear))(namedtuple("ProjectLinear", ()))
DriftTriangles = type_of(in_blocks(drift_triangles))(namedtuple("DriftTriangles", ()))
ProjectTriangles = type_of(in_blocks(project_triangles))(namedtuple("ProjectTriangles", ()))
