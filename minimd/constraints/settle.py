"""SETTLE: the drift of rigid triangles with two equal sides and two equal masses, such as water, in closed form.

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

from minimd.compiled.kernels import inlined, type_of
from minimd.constraints.vectors import NOTHING, moved
from minimd.structure.vectors import combined, cross, dot, separation, unit


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
        b0, c0 = (
            separation(positions, a, b, triangles.offsets[t, 0]),
            separation(positions, a, c, triangles.offsets[t, 1]),
        )
        p, q = moved(b0, velocities, a, b, duration), moved(c0, velocities, a, c, duration)
        a1 = combined(-fraction, p, -fraction, q)
        b1, c1 = combined(1.0, a1, 1.0, p), combined(1.0, a1, 1.0, q)
        ab, ac, bc, exists = impulses(b0, c0, (a1, b1, c1), r_a, r_b, half)
        if not exists:
            return NOTHING - t
        recoil = -fraction / (1.0 - 2.0 * fraction) * push
        for x in range(3):
            along = bc * (c0[x] - b0[x])
            for i, change in (
                (a, recoil * (ab * b0[x] + ac * c0[x])),
                (b, push * (ab * b0[x] - along)),
                (c, push * (ac * c0[x] + along)),
            ):
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
        ab, ac = (
            separation(positions, a, b, triangles.offsets[t, 0]),
            separation(positions, a, c, triangles.offsets[t, 1]),
        )
        bc = ac[0] - ab[0], ac[1] - ab[1], ac[2] - ab[2]
        u, v, w = inverse_masses[a], inverse_masses[b], inverse_masses[c]
        g, h, k = dot(ab, ab), dot(ac, ac), dot(ab, ac)
        xx, yy, zz = (u + v) * g, (u + w) * h, (v + w) * (g + h - k - k)
        xy, xz, yz = u * k, v * (g - k), w * (h - k)
        minor_x, minor_y, minor_z = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        scale = 1.0 / (xx * minor_x + xy * minor_y + xz * minor_z)
        at_ab, at_ac, at_bc = sides[t]
        for correction in range(2):
            p, q = _between(vectors, a, b), _between(vectors, a, c)
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


@inlined
def _between(vectors, i, j):
    return vectors[j, 0] - vectors[i, 0], vectors[j, 1] - vectors[i, 1], vectors[j, 2] - vectors[i, 2]


DriftTriangles = type_of(drift_triangles)(namedtuple("DriftTriangles", ()))
ProjectTriangles = type_of(project_triangles)(namedtuple("ProjectTriangles", ()))
