"""Rigid linear molecules of three atoms, where three lengths would not do: at 180° their gradients depend on each other.

    b = α a + β c,  |c − a| = d      with α = |bc|/|ac|, β = |ab|/|ac|

Three linear constraints and one length: the middle atom hangs on the ends, and what remains is a bond whose ends have other masses.
G. Ciccotti, M. Ferrario, J.-P. Ryckaert, Mol. Phys. 47, 1253 (1982).
"""

from math import sqrt
from typing import NamedTuple

from minimd.compiled.kernels import inlined, type_of
from minimd.constraints.newton import NOTHING, dot, separation


@inlined
def leverage(inverse_masses, a, b, c, alpha, beta):
    """κ = α/m_a − β/m_c,  Q = 1/m_b + α²/m_a + β²/m_c,  W = 1/m_a + 1/m_c − κ²/Q."""
    kappa = alpha * inverse_masses[a] - beta * inverse_masses[c]
    q = inverse_masses[b] + alpha * alpha * inverse_masses[a] + beta * beta * inverse_masses[c]
    return kappa, q, inverse_masses[a] + inverse_masses[c] - kappa * kappa / q


@inlined
def apply(vectors, inverse_masses, a, b, c, alpha, beta, mu, scale, s):
    """Vectors of a, b, c += M⁻¹ times (−α μ − scale s, μ, −β μ + scale s)."""
    for x in range(3):
        vectors[a, x] -= inverse_masses[a] * (alpha * mu[x] + scale * s[x])
        vectors[b, x] += inverse_masses[b] * mu[x]
        vectors[c, x] -= inverse_masses[c] * (beta * mu[x] - scale * s[x])


@inlined
def drift_rods(first, last, positions, velocities, inverse_masses, rods, offsets, shares, lengths2, duration):
    """Drift of linear molecules.

    (N, 3), (N, 3), (N,); (R, 3) atoms a, b, c, b in the middle; (R, 2, 3) offsets of b and c from a; (R, 2) α, β; (R,) d²; [time].
    Returns 1, or −1 − the molecule that cannot be kept.
    """
    for m in range(first, last):
        a, b, c = rods[m]
        alpha, beta = shares[m]
        kappa, q, w = leverage(inverse_masses, a, b, c, alpha, beta)
        s = separation(positions, a, c, offsets[m, 1])
        for i in (a, b, c):
            for x in range(3):
                positions[i, x] += duration * velocities[i, x]
        u, p = separation(positions, a, b, offsets[m, 0]), separation(positions, a, c, offsets[m, 1])
        bend = (u[0] - beta * p[0], u[1] - beta * p[1], u[2] - beta * p[2])
        p = (p[0] - kappa / q * bend[0], p[1] - kappa / q * bend[1], p[2] - kappa / q * bend[2])
        along, square = w * dot(p, s), w * w * dot(s, s)
        gap = dot(p, p) - lengths2[m]
        discriminant = along * along - square * gap
        if not (discriminant >= 0.0 and along > 0.0):
            return NOTHING - m
        scale = -gap / (along + sqrt(discriminant))
        mu = (-(bend[0] + scale * kappa * s[0]) / q, -(bend[1] + scale * kappa * s[1]) / q, -(bend[2] + scale * kappa * s[2]) / q)
        apply(positions, inverse_masses, a, b, c, alpha, beta, mu, scale, s)
        apply(velocities, inverse_masses, a, b, c, alpha, beta, (mu[0] / duration, mu[1] / duration, mu[2] / duration), scale / duration, s)
    return 1


@type_of(drift_rods)
class DriftRods(NamedTuple):
    """Marker of drift_rods."""


@inlined
def project_rods(first, last, positions, vectors, inverse_masses, rods, offsets, shares, targets, multipliers):
    """Vectors of linear molecules: the middle one follows the ends, which have r · (x_c − x_a) = target. Arguments as drift_rods, project_pairs."""
    for m in range(first, last):
        a, b, c = rods[m]
        alpha, beta = shares[m]
        kappa, q, w = leverage(inverse_masses, a, b, c, alpha, beta)
        r = separation(positions, a, c, offsets[m, 1])
        along = 0.0
        bend = (
            vectors[b, 0] - alpha * vectors[a, 0] - beta * vectors[c, 0],
            vectors[b, 1] - alpha * vectors[a, 1] - beta * vectors[c, 1],
            vectors[b, 2] - alpha * vectors[a, 2] - beta * vectors[c, 2],
        )
        for x in range(3):
            along += r[x] * (vectors[c, x] - vectors[a, x] - kappa / q * bend[x])
        scale = (targets[m] - along) / (w * dot(r, r))
        mu = (-(bend[0] + scale * kappa * r[0]) / q, -(bend[1] + scale * kappa * r[1]) / q, -(bend[2] + scale * kappa * r[2]) / q)
        multipliers[m] = scale
        apply(vectors, inverse_masses, a, b, c, alpha, beta, mu, scale, r)
    return 1


@type_of(project_rods)
class ProjectRods(NamedTuple):
    """Marker of project_rods."""
