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
"""

from collections import namedtuple
from math import sqrt

import numpy as np

from minimd.compiled.kernels import inlined, type_of
from minimd.constraints.vectors import NOTHING, add_opposite, between, moved
from minimd.structure.vectors import combined, cross, dot, separation, unit


@inlined
def drift_pairs(start, end, atoms, bonds, duration):
    """Drift of bonds start to end − 1: a λ² + 2 b λ + c = 0, a = w² s², b = w p · s, c = p² − d².  duration [time]."""
    positions, velocities, inverse_masses = atoms
    for k in range(start, end):
        i, j = np.uintp(bonds.first[k]), np.uintp(bonds.second[k])  # unsigned: none counts from the end
        s = separation(positions, i, j, bonds.offsets[k])
        p = moved(s, velocities, i, j, duration)
        w = inverse_masses[i] + inverse_masses[j]
        a, b, c = w * w * dot(s, s), w * dot(p, s), dot(p, p) - bonds.lengths2[k]
        discriminant = b * b - a * c
        if not (discriminant >= 0.0 and b > 0.0):
            return NOTHING - k
        scale = -c / (b + sqrt(discriminant)) / duration
        wi, wj = scale * inverse_masses[i], scale * inverse_masses[j]
        for x in range(3):
            vi, vj = velocities[i, x] - wi * s[x], velocities[j, x] + wj * s[x]
            velocities[i, x], velocities[j, x] = vi, vj
            positions[i, x] += duration * vi
            positions[j, x] += duration * vj
    return 1


@inlined
def project_pairs(start, end, atoms, bonds, targets, multipliers):
    """Vectors of bonds start to end − 1, given a component along each bond: r · (x_j − x_i) = target.

    Velocities with targets 0 keep the lengths; accelerations with −v². multipliers : (K,), x_j gains multiplier r/m_j.
    """
    positions, vectors, inverse_masses = atoms
    for k in range(start, end):
        i, j = bonds.first[k], bonds.second[k]
        r = separation(positions, i, j, bonds.offsets[k])
        along = dot(r, between(vectors, i, j))
        multipliers[k] = (targets[k] - along) / ((inverse_masses[i] + inverse_masses[j]) * dot(r, r))
        add_opposite(vectors, inverse_masses, i, j, multipliers[k], r)
    return 1


@inlined
def inertia(inverse_masses, molecule):
    """κ, Q and W of a molecule (a, b, c, α, β)."""
    a, b, c, alpha, beta = molecule
    kappa = alpha * inverse_masses[a] - beta * inverse_masses[c]
    q = inverse_masses[b] + alpha * alpha * inverse_masses[a] + beta * beta * inverse_masses[c]
    return kappa, q, inverse_masses[a] + inverse_masses[c] - kappa * kappa / q


@inlined
def on_middle(e, push, s, q):
    """μ, with push = λ κ."""
    return -(e[0] + push * s[0]) / q, -(e[1] + push * s[1]) / q, -(e[2] + push * s[2]) / q


@inlined
def apply(vectors, inverse_masses, molecule, mu, scale, s):
    """vectors of a, b, c += M⁻¹ times (−α μ − λ s, μ, −β μ + λ s), with λ = scale."""
    a, b, c, alpha, beta = molecule
    for x in range(3):
        vectors[a, x] -= inverse_masses[a] * (alpha * mu[x] + scale * s[x])
        vectors[b, x] += inverse_masses[b] * mu[x]
        vectors[c, x] -= inverse_masses[c] * (beta * mu[x] - scale * s[x])


@inlined
def drift_linear(first, last, atoms, molecules, duration):
    """Drift of molecules first to last − 1.

    Atoms; Molecules with b in the middle and shapes (M, 3): α, β, d² [length²]; [time]. Returns 1,
    or −1 − the molecule that cannot be kept.
    """
    positions, velocities, inverse_masses = atoms
    for m in range(first, last):
        a, b, c = molecules.atoms[m]
        alpha, beta, length2 = molecules.shapes[m]
        molecule = (a, b, c, alpha, beta)
        kappa, q, w = inertia(inverse_masses, molecule)
        s = separation(positions, a, c, molecules.offsets[m, 1])
        for i in (a, b, c):
            for x in range(3):
                positions[i, x] += duration * velocities[i, x]
        u = separation(positions, a, b, molecules.offsets[m, 0])
        p = separation(positions, a, c, molecules.offsets[m, 1])
        e = (u[0] - beta * p[0], u[1] - beta * p[1], u[2] - beta * p[2])
        p = (p[0] - kappa / q * e[0], p[1] - kappa / q * e[1], p[2] - kappa / q * e[2])
        along, square = w * dot(p, s), w * w * dot(s, s)
        gap = dot(p, p) - length2
        discriminant = along * along - square * gap
        if not (discriminant >= 0.0 and along > 0.0):
            return NOTHING - m
        scale = -gap / (along + sqrt(discriminant))
        mu = on_middle(e, scale * kappa, s, q)
        apply(positions, inverse_masses, molecule, mu, scale, s)
        mu = mu[0] / duration, mu[1] / duration, mu[2] / duration
        apply(velocities, inverse_masses, molecule, mu, scale / duration, s)
    return 1


@inlined
def project_linear(first, last, atoms, molecules, targets, multipliers):
    """Vectors x of molecules first to last − 1: x_b = α x_a + β x_c, and r · (x_c − x_a) = target.

    Arguments as drift_linear, project_pairs.
    """
    positions, vectors, inverse_masses = atoms
    for m in range(first, last):
        a, b, c = molecules.atoms[m]
        alpha, beta, _ = molecules.shapes[m]
        molecule = (a, b, c, alpha, beta)
        kappa, q, w = inertia(inverse_masses, molecule)
        r = separation(positions, a, c, molecules.offsets[m, 1])
        along = 0.0
        e = (
            vectors[b, 0] - alpha * vectors[a, 0] - beta * vectors[c, 0],
            vectors[b, 1] - alpha * vectors[a, 1] - beta * vectors[c, 1],
            vectors[b, 2] - alpha * vectors[a, 2] - beta * vectors[c, 2],
        )
        for x in range(3):
            along += r[x] * (vectors[c, x] - vectors[a, x] - kappa / q * e[x])
        scale = (targets[m] - along) / (w * dot(r, r))
        multipliers[m] = scale
        apply(vectors, inverse_masses, molecule, on_middle(e, scale * kappa, r, q), scale, r)
    return 1


@inlined
def impulses(b0, c0, drifted, r_a, r_b, r_c):
    """λ_ab, λ_ac, λ_bc of a triangle [dimensionless], and whether they exist.

    b0, c0 : separations a to b and a to c before the drift.  drifted : a₁, b₁, c₁.  r_a, r_b, r_c : see above.
        All [length].
    """
    a1, b1, c1 = drifted
    z = unit(cross(b0, c0))
    x = unit(cross(a1, z))
    y = cross(z, x)
    sin_phi = dot(a1, z) / r_a
    cos_phi2 = 1.0 - sin_phi * sin_phi
    sin_psi = (dot(b1, z) - dot(c1, z)) / (2.0 * r_c * sqrt(max(cos_phi2, 0.0))) if cos_phi2 > 0.0 else 2.0
    cos_psi2 = 1.0 - sin_psi * sin_psi
    if not cos_psi2 > 0.0:
        return 0.0, 0.0, 0.0, False
    cos_phi, cos_psi = sqrt(cos_phi2), sqrt(cos_psi2)
    xb = -r_c * cos_psi
    yb, yc = -r_b * cos_phi - r_c * sin_psi * sin_phi, -r_b * cos_phi + r_c * sin_psi * sin_phi
    xb0, yb0, xc0, yc0 = dot(b0, x), dot(b0, y), dot(c0, x), dot(c0, y)
    xb1, yb1, xc1, yc1 = dot(b1, x), dot(b1, y), dot(c1, x), dot(c1, y)
    alpha = xb * (xb0 - xc0) + yb0 * yb + yc0 * yc
    beta = xb * (yc0 - yb0) + xb0 * yb + xc0 * yc
    gamma = xb0 * yb1 - xb1 * yb0 + xc0 * yc1 - xc1 * yc0
    square = alpha * alpha + beta * beta
    rest = square - gamma * gamma
    if not rest >= 0.0:
        return 0.0, 0.0, 0.0, False
    sine = (alpha * gamma - beta * sqrt(rest)) / square
    cosine = sqrt(max(1.0 - sine * sine, 0.0))
    dxb, dyb = xb * cosine - yb * sine - xb1, xb * sine + yb * cosine - yb1
    dxc, dyc = -xb * cosine - yc * sine - xc1, -xb * sine + yc * cosine - yc1
    xe, ye, area = xc0 - xb0, yc0 - yb0, xb0 * yc0 - yb0 * xc0
    ab, ac = (dxb * ye - dyb * xe) / area, (dxc * ye - dyc * xe) / area
    return ab, ac, 0.5 * (dxb * yb0 - dyb * xb0 - dxc * yc0 + dyc * xc0) / area, True


@inlined
def drift_triangles(first, last, atoms, triangles, duration):
    """Drift of triangles first to last − 1.

    Atoms; Molecules with shapes (T, 4): r_a, r_b, r_c [length] and the share of b, and of c, in the mass; [time].
    Returns 1, or −1 − the triangle that cannot be kept.
    """
    positions, velocities = atoms.positions, atoms.vectors
    push = 1.0 / duration
    for t in range(first, last):
        a, b, c = triangles.atoms[t]
        r_a, r_b, half, fraction = triangles.shapes[t]
        b0 = separation(positions, a, b, triangles.offsets[t, 0])
        c0 = separation(positions, a, c, triangles.offsets[t, 1])
        p, q = moved(b0, velocities, a, b, duration), moved(c0, velocities, a, c, duration)
        a1 = combined(-fraction, p, -fraction, q)
        b1, c1 = combined(1.0, a1, 1.0, p), combined(1.0, a1, 1.0, q)
        ab, ac, bc, exists = impulses(b0, c0, (a1, b1, c1), r_a, r_b, half)
        if not exists:
            return NOTHING - t
        recoil = -fraction / (1.0 - 2.0 * fraction) * push
        for x in range(3):
            along = bc * (c0[x] - b0[x])
            of_a = recoil * (ab * b0[x] + ac * c0[x])
            for i, change in ((a, of_a), (b, push * (ab * b0[x] - along)), (c, push * (ac * c0[x] + along))):
                v = velocities[i, x] + change
                velocities[i, x] = v
                positions[i, x] += duration * v
    return 1


@inlined
def project_triangles(first, last, atoms, triangles, sides, targets, multipliers):
    """Vectors of triangles first to last − 1, given a component along each side: r · (x_j − x_i) = target.

    A λ = targets − r · x, with A_kl = ±(r_k · r_l)/m of the shared atom, by the inverse of A; projected twice,
    to remove the rounding of the first projection.

    sides : (T, 3) int, the constraints ab, ac, bc.  Other arguments, returns : as drift_triangles, project_pairs.
    """
    positions, vectors, inverse_masses = atoms
    for t in range(first, last):
        a, b, c = triangles.atoms[t]
        ab = separation(positions, a, b, triangles.offsets[t, 0])
        ac = separation(positions, a, c, triangles.offsets[t, 1])
        bc = ac[0] - ab[0], ac[1] - ab[1], ac[2] - ab[2]
        u, v, w = inverse_masses[a], inverse_masses[b], inverse_masses[c]
        g, h, k = dot(ab, ab), dot(ac, ac), dot(ab, ac)
        xx, yy, zz = (u + v) * g, (u + w) * h, (v + w) * (g + h - k - k)
        xy, xz, yz = u * k, v * (g - k), w * (h - k)
        minor_x, minor_y, minor_z = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        scale = 1.0 / (xx * minor_x + xy * minor_y + xz * minor_z)
        at_ab, at_ac, at_bc = sides[t]
        for correction in range(2):
            p, q = between(vectors, a, b), between(vectors, a, c)
            x, y = targets[at_ab] - dot(ab, p), targets[at_ac] - dot(ac, q)
            z = targets[at_bc] - (bc[0] * (q[0] - p[0]) + bc[1] * (q[1] - p[1]) + bc[2] * (q[2] - p[2]))
            on_ab = scale * (minor_x * x + minor_y * y + minor_z * z)
            on_ac = scale * (minor_y * x + (xx * zz - xz * xz) * y + (xy * xz - xx * yz) * z)
            on_bc = scale * (minor_z * x + (xy * xz - xx * yz) * y + (xx * yy - xy * xy) * z)
            for d in range(3):
                vectors[a, d] -= u * (on_ab * ab[d] + on_ac * ac[d])
                vectors[b, d] += v * (on_ab * ab[d] - on_bc * bc[d])
                vectors[c, d] += w * (on_ac * ac[d] + on_bc * bc[d])
            multipliers[at_ab] = on_ab + (multipliers[at_ab] if correction else 0.0)
            multipliers[at_ac] = on_ac + (multipliers[at_ac] if correction else 0.0)
            multipliers[at_bc] = on_bc + (multipliers[at_bc] if correction else 0.0)
    return 1


DriftPairs = type_of(drift_pairs)(namedtuple("DriftPairs", ()))
ProjectPairs = type_of(project_pairs)(namedtuple("ProjectPairs", ()))
DriftLinear = type_of(drift_linear)(namedtuple("DriftLinear", ()))
ProjectLinear = type_of(project_linear)(namedtuple("ProjectLinear", ()))
DriftTriangles = type_of(drift_triangles)(namedtuple("DriftTriangles", ()))
ProjectTriangles = type_of(project_triangles)(namedtuple("ProjectTriangles", ()))
