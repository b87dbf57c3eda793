"""Bonds that share no atom, in closed form.

    drift        r′ = p + λ w s,  |r′|² = d²        p = s + Δt v_ij,  w = 1/m_i + 1/m_j,  λ the root nearest to zero
    velocities   v′_ij = v_ij + μ w r,  r · v′_ij = 0

s is r_j − r_i + offset before the drift, r is the same now. H. C. Andersen, J. Comput. Phys. 52, 24 (1983).
"""

from collections import namedtuple
from math import sqrt

import numpy as np

from minimd.compiled.kernels import inlined, type_of
from minimd.constraints.vectors import NOTHING, add_opposite, moved
from minimd.structure.vectors import dot, separation


@inlined
def drift_pairs(start, end, atoms, bonds, duration):
    """Drift of bonds start to end − 1: a λ² + 2 b λ + c = 0 with a = w² s², b = w p · s, c = p² − d².  Atoms, Bonds,
    [time]."""
    positions, velocities, inverse_masses = atoms
    for k in range(start, end):
        i, j = (
            np.uintp(bonds.first[k]),
            np.uintp(bonds.second[k]),
        )  # unsigned: no check for indices that count from the end
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
        along = (
            r[0] * (vectors[j, 0] - vectors[i, 0])
            + r[1] * (vectors[j, 1] - vectors[i, 1])
            + r[2] * (vectors[j, 2] - vectors[i, 2])
        )
        multipliers[k] = (targets[k] - along) / ((inverse_masses[i] + inverse_masses[j]) * dot(r, r))
        add_opposite(vectors, inverse_masses, i, j, multipliers[k], r)
    return 1


DriftPairs = type_of(drift_pairs)(namedtuple("DriftPairs", ()))
ProjectPairs = type_of(project_pairs)(namedtuple("ProjectPairs", ()))
