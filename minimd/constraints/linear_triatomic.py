"""Rigid linear molecules of three atoms.

Three fixed lengths cannot constrain them: at 180° their gradients are linearly dependent.

    b = α a + β c,  |c − a| = d      with α = |bc|/|ac|, β = |ab|/|ac|

These are three linear constraints and one length. They are solved by two multipliers, a vector μ on b and a number λ
along s = c − a before the drift, with the forces (−α μ − λ s, μ, −β μ + λ s) on a, b and c.
With e = b − α a − β c and p = c − a after the drift

    κ = α/m_a − β/m_c      Q = 1/m_b + α²/m_a + β²/m_c      W = 1/m_a + 1/m_c − κ²/Q
    μ = −(e + λ κ s)/Q     |p − κ e/Q + λ W s|² = d²

G. Ciccotti, M. Ferrario, J.-P. Ryckaert, Mol. Phys. 47, 1253 (1982).
"""

from collections import namedtuple
from math import sqrt

from minimd.compiled.kernels import inlined, type_of
from minimd.constraints.vectors import NOTHING
from minimd.structure.vectors import dot, separation


@inlined
def inertia(inverse_masses, molecule):
    """κ, Q and W of a molecule (a, b, c, α, β)."""
    a, b, c, alpha, beta = molecule
    kappa = alpha * inverse_masses[a] - beta * inverse_masses[c]
    q = inverse_masses[b] + alpha * alpha * inverse_masses[a] + beta * beta * inverse_masses[c]
    return kappa, q, inverse_masses[a] + inverse_masses[c] - kappa * kappa / q


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
        u, p = (
            separation(positions, a, b, molecules.offsets[m, 0]),
            separation(positions, a, c, molecules.offsets[m, 1]),
        )
        e = (u[0] - beta * p[0], u[1] - beta * p[1], u[2] - beta * p[2])
        p = (p[0] - kappa / q * e[0], p[1] - kappa / q * e[1], p[2] - kappa / q * e[2])
        along, square = w * dot(p, s), w * w * dot(s, s)
        gap = dot(p, p) - length2
        discriminant = along * along - square * gap
        if not (discriminant >= 0.0 and along > 0.0):
            return NOTHING - m
        scale = -gap / (along + sqrt(discriminant))
        mu = (
            -(e[0] + scale * kappa * s[0]) / q,
            -(e[1] + scale * kappa * s[1]) / q,
            -(e[2] + scale * kappa * s[2]) / q,
        )
        apply(positions, inverse_masses, molecule, mu, scale, s)
        apply(
            velocities,
            inverse_masses,
            molecule,
            (mu[0] / duration, mu[1] / duration, mu[2] / duration),
            scale / duration,
            s,
        )
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
        mu = (
            -(e[0] + scale * kappa * r[0]) / q,
            -(e[1] + scale * kappa * r[1]) / q,
            -(e[2] + scale * kappa * r[2]) / q,
        )
        multipliers[m] = scale
        apply(vectors, inverse_masses, molecule, mu, scale, r)
    return 1


DriftLinear = type_of(drift_linear)(namedtuple("DriftLinear", ()))
ProjectLinear = type_of(project_linear)(namedtuple("ProjectLinear", ()))
