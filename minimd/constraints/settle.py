"""SETTLE: the drift of rigid triangles with two equal sides and two equal masses, such as water, in closed form.

The new triangle lies in three rotations (φ, ψ, θ) from a frame whose plane is that of the old one; the Lagrange conditions
fix the angles. S. Miyamoto, P. A. Kollman, J. Comput. Chem. 13, 952 (1992), eq. A8-A17; a is the apex, b and c the others.
"""

from math import sqrt
from typing import NamedTuple

from minimd.compiled.kernels import inlined, type_of
from minimd.constraints.newton import NOTHING, dot, separation


@inlined
def cross(u, v):
    """U × v."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@inlined
def unit(u):
    """U/|u|."""
    scale = 1.0 / sqrt(dot(u, u))
    return u[0] * scale, u[1] * scale, u[2] * scale


@inlined
def combined(x, u, y, v):
    """X u + y v."""
    return x * u[0] + y * v[0], x * u[1] + y * v[1], x * u[2] + y * v[2]


@inlined
def moved(s, positions, velocities, i, j, duration):
    """S + Δt (v_j − v_i), a separation after the drift."""
    return (
        s[0] + duration * (velocities[j, 0] - velocities[i, 0]),
        s[1] + duration * (velocities[j, 1] - velocities[i, 1]),
        s[2] + duration * (velocities[j, 2] - velocities[i, 2]),
    )


@inlined
def settled(b0, c0, a1, b1, c1, height, foot, half):
    """Where a, b, c belong, relative to the center of mass.

    b0, c0 : old separations a to b, a to c.  a1, b1, c1 : drifted, relative to their center of mass.
    height, foot : distances of the center of mass from a, and from the middle of bc.  half : of |bc|.  All [length].
    Returns three vectors and whether they exist.
    """
    z = unit(cross(b0, c0))
    x = unit(cross(a1, z))
    y = cross(z, x)
    sin_phi = dot(a1, z) / height
    cos_phi2 = 1.0 - sin_phi * sin_phi
    sin_psi = (dot(b1, z) - dot(c1, z)) / (2.0 * half * sqrt(max(cos_phi2, 0.0))) if cos_phi2 > 0.0 else 2.0
    cos_psi2 = 1.0 - sin_psi * sin_psi
    if not cos_psi2 > 0.0:
        return a1, b1, c1, False
    cos_phi, cos_psi = sqrt(cos_phi2), sqrt(cos_psi2)
    ya, xb = height * cos_phi, -half * cos_psi
    yb, yc = -foot * cos_phi - half * sin_psi * sin_phi, -foot * cos_phi + half * sin_psi * sin_phi
    xb0, yb0, xc0, yc0 = dot(b0, x), dot(b0, y), dot(c0, x), dot(c0, y)
    xb1, yb1, xc1, yc1 = dot(b1, x), dot(b1, y), dot(c1, x), dot(c1, y)
    alpha = xb * (xb0 - xc0) + yb0 * yb + yc0 * yc
    beta = xb * (yc0 - yb0) + xb0 * yb + xc0 * yc
    gamma = xb0 * yb1 - xb1 * yb0 + xc0 * yc1 - xc1 * yc0
    square = alpha * alpha + beta * beta
    rest = square - gamma * gamma
    if not rest >= 0.0:
        return a1, b1, c1, False
    sine = (alpha * gamma - beta * sqrt(rest)) / square
    cosine = sqrt(max(1.0 - sine * sine, 0.0))
    za, zb, zc = dot(a1, z), dot(b1, z), dot(c1, z)
    a3 = combined(-ya * sine, x, ya * cosine, y)
    b3 = combined(xb * cosine - yb * sine, x, xb * sine + yb * cosine, y)
    c3 = combined(-xb * cosine - yc * sine, x, -xb * sine + yc * cosine, y)
    return combined(1.0, a3, za, z), combined(1.0, b3, zb, z), combined(1.0, c3, zc, z), True


@inlined
def drift_triangles(first, last, positions, velocities, inverse_masses, triangles, offsets, shapes, duration):
    """Drift of rigid triangles.

    (N, 3), (N, 3), (N,); (T, 3) atoms a, b, c; (T, 2, 3) offsets of b and c from a; (T, 2) |ab|, |bc| [length]; [time].
    Returns 1, or −1 − the triangle that cannot be kept.
    """
    for t in range(first, last):
        a, b, c = triangles[t]
        side, half = shapes[t, 0], 0.5 * shapes[t, 1]
        total = 1.0 / inverse_masses[a] + 2.0 / inverse_masses[b]
        share = 1.0 / (inverse_masses[b] * total)  # of b, and of c, in the mass
        whole = sqrt(side * side - half * half)
        height = 2.0 * share * whole
        b0, c0 = separation(positions, a, b, offsets[t, 0]), separation(positions, a, c, offsets[t, 1])
        p, q = moved(b0, positions, velocities, a, b, duration), moved(c0, positions, velocities, a, c, duration)
        a1 = combined(-share, p, -share, q)
        b1, c1 = combined(1.0, a1, 1.0, p), combined(1.0, a1, 1.0, q)
        a3, b3, c3, exists = settled(b0, c0, a1, b1, c1, height, whole - height, half)
        if not exists:
            return NOTHING - t
        for d in range(3):
            for i, old, new in ((a, a1, a3), (b, b1, b3), (c, c1, c3)):
                v = velocities[i, d] + (new[d] - old[d]) / duration
                velocities[i, d] = v
                positions[i, d] += duration * v
    return 1


@type_of(drift_triangles)
class DriftTriangles(NamedTuple):
    """Marker of drift_triangles."""
