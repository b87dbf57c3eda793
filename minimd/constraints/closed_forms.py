"""Constraints in closed form: bonds that share no atom, linear molecules of three atoms, and triangles such as water.

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

All of them compute as many bonds or molecules at a time as a vector has lanes; lanes that are too many repeat the last
one, whose atoms then are written several times, the same each time.
"""

from collections import namedtuple
from math import sqrt

import numpy as np

from minimd.compiled.kernels import scalar, type_of
from minimd.compiled.simd import bits_from_mask, select, trailing_zeros
from minimd.compiled.simd.lanes import count
from minimd.constraints.vectors import NOTHING, minus, numbers, plus, put_numbers, put_rows, rows
from minimd.structure.vectors import combined, cross, dot, unit


@scalar
def drift_pairs(start, end, atoms, bonds, duration):
    """Drift of bonds start to end − 1: a λ² + 2 b λ + c = 0, a = w² s², b = w p · s, c = p² − d².  duration [time]."""
    positions, velocities, inverse_masses, lanes = atoms
    for k in range(start, end, count(lanes)):
        first, second, own = (bonds.first, k, end, lanes), (bonds.second, k, end, lanes), ((), k, end, lanes)
        r, q, u, v = rows(positions, first), rows(positions, second), rows(velocities, first), rows(velocities, second)
        wi, wj = numbers(inverse_masses, first), numbers(inverse_masses, second)
        s = plus(minus(q, r), rows(bonds.offsets, own))
        p, w = combined(1.0, s, duration, minus(v, u)), wi + wj
        a, b, c = w * w * dot(s, s), w * dot(p, s), dot(p, p) - numbers(bonds.lengths2, own)
        discriminant = b * b - a * c
        n_kept = n_without_failure(select(b > 0.0, discriminant, -1.0))
        if n_kept < count(lanes):
            return NOTHING - k - n_kept
        scale = -c / (b + sqrt(discriminant)) / duration
        u, v = combined(1.0, u, -scale * wi, s), combined(1.0, v, scale * wj, s)
        put_rows(velocities, first, u)
        put_rows(velocities, second, v)
        put_rows(positions, first, combined(1.0, r, duration, u))
        put_rows(positions, second, combined(1.0, q, duration, v))
    return 1


@scalar
def n_without_failure(least):
    """The number of the first lane that is negative or no number; that of lanes or more if there is none."""
    return np.int64(trailing_zeros(np.uint64(~bits_from_mask(least >= 0.0))))


@scalar
def project_pairs(start, end, atoms, bonds, targets, multipliers):
    """Vectors of bonds start to end − 1, given a component along each bond: r · (x_j − x_i) = target.

    Velocities with targets 0 keep the lengths; accelerations with −v². multipliers : (K,), x_j gains multiplier r/m_j.
    """
    positions, vectors, inverse_masses, lanes = atoms
    for k in range(start, end, count(lanes)):
        first, second, own = (bonds.first, k, end, lanes), (bonds.second, k, end, lanes), ((), k, end, lanes)
        r = plus(minus(rows(positions, second), rows(positions, first)), rows(bonds.offsets, own))
        u, v = rows(vectors, first), rows(vectors, second)
        wi, wj = numbers(inverse_masses, first), numbers(inverse_masses, second)
        scale = (numbers(targets, own) - dot(r, minus(v, u))) / ((wi + wj) * dot(r, r))
        put_numbers(multipliers, own, scale)
        put_rows(vectors, first, combined(1.0, u, -scale * wi, r))
        put_rows(vectors, second, combined(1.0, v, scale * wj, r))
    return 1


@scalar
def corners(values, molecules, m, last, lanes):
    """The rows of values (N, 3) that belong to the atoms a, b, c of molecules."""
    a, b, c = molecules.atoms
    return rows(values, (a, m, last, lanes)), rows(values, (b, m, last, lanes)), rows(values, (c, m, last, lanes))


@scalar
def put_corners(values, molecules, m, last, lanes, xyz):
    """Write them."""
    a, b, c = molecules.atoms
    put_rows(values, (a, m, last, lanes), xyz[0])
    put_rows(values, (b, m, last, lanes), xyz[1])
    put_rows(values, (c, m, last, lanes), xyz[2])


@scalar
def masses_of(inverse_masses, molecules, m, last, lanes):
    """The inverse masses of the atoms a, b, c of molecules."""
    a, b, c = molecules.atoms
    of_a, of_b = numbers(inverse_masses, (a, m, last, lanes)), numbers(inverse_masses, (b, m, last, lanes))
    return of_a, of_b, numbers(inverse_masses, (c, m, last, lanes))


@scalar
def arms(positions, molecules, m, last, lanes):
    """r_b − r_a and r_c − r_a of molecules, from the positions of their atoms."""
    (a, b, c), own, (to_b, to_c) = positions, ((), m, last, lanes), molecules.offsets
    return plus(minus(b, a), rows(to_b, own)), plus(minus(c, a), rows(to_c, own))


@scalar
def of_shape(molecules, m, last, lanes):
    """α, β, κ, Q and W of linear molecules, and d² [length²]."""
    own, (alpha, beta, length2) = ((), m, last, lanes), molecules.shapes
    return numbers(alpha, own), numbers(beta, own), numbers(length2, own)


@scalar
def inertia(masses, alpha, beta):
    """κ, Q and W of linear molecules.  masses : inverse, of a, b, c."""
    wa, wb, wc = masses
    kappa, q = alpha * wa - beta * wc, wb + alpha * alpha * wa + beta * beta * wc
    return kappa, q, wa + wc - kappa * kappa / q


@scalar
def pushed(vectors, masses, alpha, beta, mu, along):
    """vectors of a, b, c + M⁻¹ times (−α μ − λ s, μ, −β μ + λ s), with along = λ s."""
    (a, b, c), (wa, wb, wc) = vectors, masses
    on_a, on_c = combined(alpha, mu, 1.0, along), combined(beta, mu, -1.0, along)
    return combined(1.0, a, -wa, on_a), combined(1.0, b, wb, mu), combined(1.0, c, -wc, on_c)


@scalar
def drift_linear(first, last, atoms, molecules, duration):
    """Drift of molecules first to last − 1.

    Atoms; Molecules with b in the middle and shapes (M,): α, β, d² [length²]; [time]. Returns 1,
    or −1 − the molecule that cannot be kept.
    """
    positions, velocities, inverse_masses, lanes = atoms
    for m in range(first, last, count(lanes)):
        here, masses = (
            corners(positions, molecules, m, last, lanes),
            masses_of(inverse_masses, molecules, m, last, lanes),
        )
        moving, (alpha, beta, length2) = (
            corners(velocities, molecules, m, last, lanes),
            of_shape(molecules, m, last, lanes),
        )
        kappa, q, w = inertia(masses, alpha, beta)
        _, s = arms(here, molecules, m, last, lanes)
        (a, b, c), (u, v, x) = here, moving
        there = combined(1.0, a, duration, u), combined(1.0, b, duration, v), combined(1.0, c, duration, x)
        to_b, p = arms(there, molecules, m, last, lanes)
        e = combined(1.0, to_b, -beta, p)
        p = combined(1.0, p, -kappa / q, e)
        along, square, gap = w * dot(p, s), w * w * dot(s, s), dot(p, p) - length2
        discriminant = along * along - square * gap
        n_kept = n_without_failure(select(along > 0.0, discriminant, -1.0))
        if n_kept < count(lanes):
            return NOTHING - m - n_kept
        scale = -gap / (along + sqrt(discriminant))
        mu = combined(-1.0 / q, e, -scale * kappa / q, s)
        there = pushed(there, masses, alpha, beta, mu, combined(scale, s, 0.0, s))
        mu, push = combined(1.0 / duration, mu, 0.0, mu), combined(scale / duration, s, 0.0, s)
        put_corners(positions, molecules, m, last, lanes, there)
        put_corners(velocities, molecules, m, last, lanes, pushed(moving, masses, alpha, beta, mu, push))
    return 1


@scalar
def project_linear(first, last, atoms, molecules, targets, multipliers):
    """Vectors x of molecules first to last − 1: x_b = α x_a + β x_c, and r · (x_c − x_a) = target.

    Arguments as drift_linear, project_pairs.
    """
    positions, vectors, inverse_masses, lanes = atoms
    for m in range(first, last, count(lanes)):
        here, masses = (
            corners(positions, molecules, m, last, lanes),
            masses_of(inverse_masses, molecules, m, last, lanes),
        )
        (a, b, c), (alpha, beta, _) = corners(vectors, molecules, m, last, lanes), of_shape(molecules, m, last, lanes)
        (kappa, q, w), own = inertia(masses, alpha, beta), ((), m, last, lanes)
        _, r = arms(here, molecules, m, last, lanes)
        e = minus(b, combined(alpha, a, beta, c))
        along = dot(r, combined(1.0, minus(c, a), -kappa / q, e))
        scale = (numbers(targets, own) - along) / (w * dot(r, r))
        put_numbers(multipliers, own, scale)
        mu = combined(-1.0 / q, e, -scale * kappa / q, r)
        turned = pushed((a, b, c), masses, alpha, beta, mu, combined(scale, r, 0.0, r))
        put_corners(vectors, molecules, m, last, lanes, turned)
    return 1


@scalar
def impulses(b0, c0, drifted, r_a, r_b, r_c):
    """λ_ab, λ_ac, λ_bc of triangles [dimensionless], and a number that is negative, or none, where they do not exist.

    b0, c0 : separations a to b and a to c before the drift.  drifted : a₁, b₁, c₁.  r_a, r_b, r_c : see above.
        All [length].
    """
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
    yb, yc = -r_b * cos_phi - r_c * sin_psi * sin_phi, -r_b * cos_phi + r_c * sin_psi * sin_phi
    xb0, yb0, xc0, yc0 = dot(b0, x), dot(b0, y), dot(c0, x), dot(c0, y)
    xb1, yb1, xc1, yc1 = dot(b1, x), dot(b1, y), dot(c1, x), dot(c1, y)
    alpha = xb * (xb0 - xc0) + yb0 * yb + yc0 * yc
    beta = xb * (yc0 - yb0) + xb0 * yb + xc0 * yc
    gamma = xb0 * yb1 - xb1 * yb0 + xc0 * yc1 - xc1 * yc0
    square = alpha * alpha + beta * beta
    rest = square - gamma * gamma
    sine = (alpha * gamma - beta * sqrt(rest)) / square
    cosine = sqrt(max(1.0 - sine * sine, 0.0))
    dxb, dyb = xb * cosine - yb * sine - xb1, xb * sine + yb * cosine - yb1
    dxc, dyc = -xb * cosine - yc * sine - xc1, -xb * sine + yc * cosine - yc1
    xe, ye, area = xc0 - xb0, yc0 - yb0, xb0 * yc0 - yb0 * xc0
    ab, ac = (dxb * ye - dyb * xe) / area, (dxc * ye - dyc * xe) / area
    exist = select(cos_phi2 > 0.0, select(cos_psi2 > 0.0, rest, -1.0), -1.0)
    return ab, ac, 0.5 * (dxb * yb0 - dyb * xb0 - dxc * yc0 + dyc * xc0) / area, exist


@scalar
def drift_triangles(first, last, atoms, triangles, duration):
    """Drift of triangles first to last − 1.

    Atoms; Molecules with shapes (T,): r_a, r_b, r_c [length] and the share of b, and of c, in the mass; [time].
    Returns 1, or −1 − the triangle that cannot be kept.
    """
    positions, velocities, _, lanes = atoms
    push = 1.0 / duration
    for t in range(first, last, count(lanes)):
        own, (r_a, r_b, half, fraction) = ((), t, last, lanes), triangles.shapes
        here, (u, v, w) = corners(positions, triangles, t, last, lanes), corners(velocities, triangles, t, last, lanes)
        b0, c0 = arms(here, triangles, t, last, lanes)
        p, q = combined(1.0, b0, duration, minus(v, u)), combined(1.0, c0, duration, minus(w, u))
        share = numbers(fraction, own)
        a1 = combined(-share, p, -share, q)
        drifted, sides = (a1, plus(a1, p), plus(a1, q)), (numbers(r_a, own), numbers(r_b, own), numbers(half, own))
        ab, ac, bc, exist = impulses(b0, c0, drifted, *sides)
        n_kept = n_without_failure(exist)
        if n_kept < count(lanes):
            return NOTHING - t - n_kept
        recoil, across = -share / (1.0 - 2.0 * share) * push, combined(bc, minus(c0, b0), 0.0, b0)
        u = combined(1.0, u, recoil, combined(ab, b0, ac, c0))
        v, w = (
            combined(1.0, v, push, combined(ab, b0, -1.0, across)),
            combined(1.0, w, push, combined(ac, c0, 1.0, across)),
        )
        a, b, c = here
        moved = combined(1.0, a, duration, u), combined(1.0, b, duration, v), combined(1.0, c, duration, w)
        put_corners(velocities, triangles, t, last, lanes, (u, v, w))
        put_corners(positions, triangles, t, last, lanes, moved)
    return 1


@scalar
def project_triangles(first, last, atoms, triangles, sides, targets, multipliers):
    """Vectors of triangles first to last − 1, given a component along each side: r · (x_j − x_i) = target.

    A λ = targets − r · x, with A_kl = ±(r_k · r_l)/m of the shared atom, by the inverse of A; projected twice,
    to remove the rounding of the first projection.

    sides : three of (T,) int, the constraints ab, ac, bc.  Others, returns : as drift_triangles, project_pairs.
    """
    positions, vectors, inverse_masses, lanes = atoms
    for t in range(first, last, count(lanes)):
        ab, ac = arms(corners(positions, triangles, t, last, lanes), triangles, t, last, lanes)
        bc, (u, v, w) = minus(ac, ab), masses_of(inverse_masses, triangles, t, last, lanes)
        g, h, k = dot(ab, ab), dot(ac, ac), dot(ab, ac)
        xx, yy, zz = (u + v) * g, (u + w) * h, (v + w) * (g + h - k - k)
        xy, xz, yz = u * k, v * (g - k), w * (h - k)
        minor_x, minor_y, minor_z = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        scale = 1.0 / (xx * minor_x + xy * minor_y + xz * minor_z)
        at_ab, at_ac, at_bc = (sides[0], t, last, lanes), (sides[1], t, last, lanes), (sides[2], t, last, lanes)
        of_ab, of_ac, of_bc = numbers(targets, at_ab), numbers(targets, at_ac), numbers(targets, at_bc)
        a, b, c = corners(vectors, triangles, t, last, lanes)
        sum_ab = sum_ac = sum_bc = 0.0 * scale
        for _ in range(2):
            x, y, z = of_ab - dot(ab, minus(b, a)), of_ac - dot(ac, minus(c, a)), of_bc - dot(bc, minus(c, b))
            on_ab = scale * (minor_x * x + minor_y * y + minor_z * z)
            on_ac = scale * (minor_y * x + (xx * zz - xz * xz) * y + (xy * xz - xx * yz) * z)
            on_bc = scale * (minor_z * x + (xy * xz - xx * yz) * y + (xx * yy - xy * xy) * z)
            a = combined(1.0, a, -u, combined(on_ab, ab, on_ac, ac))
            b, c = (
                combined(1.0, b, v, combined(on_ab, ab, -on_bc, bc)),
                combined(1.0, c, w, combined(on_ac, ac, on_bc, bc)),
            )
            sum_ab, sum_ac, sum_bc = sum_ab + on_ab, sum_ac + on_ac, sum_bc + on_bc
        put_corners(vectors, triangles, t, last, lanes, (a, b, c))
        put_numbers(multipliers, at_ab, sum_ab)
        put_numbers(multipliers, at_ac, sum_ac)
        put_numbers(multipliers, at_bc, sum_bc)
    return 1


DriftPairs = type_of(drift_pairs)(namedtuple("DriftPairs", ()))
ProjectPairs = type_of(project_pairs)(namedtuple("ProjectPairs", ()))
DriftLinear = type_of(drift_linear)(namedtuple("DriftLinear", ()))
ProjectLinear = type_of(project_linear)(namedtuple("ProjectLinear", ()))
DriftTriangles = type_of(drift_triangles)(namedtuple("DriftTriangles", ()))
ProjectTriangles = type_of(project_triangles)(namedtuple("ProjectTriangles", ()))
