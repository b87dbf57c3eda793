"""SHAKE and RATTLE by sweeps: one constraint after the other, repeatedly, until all are kept to a tolerance.

    λ_k = (d² − |r_k|²) / (2 (1/m_i + 1/m_j) r_k · s_k)          positions, along the bonds s before the drift
    μ_k = −r_k · v_k / ((1/m_i + 1/m_j) |r_k|²)                  velocities

J.-P. Ryckaert, G. Ciccotti, H. J. C. Berendsen, J. Comput. Phys. 23, 327 (1977); H. C. Andersen, J. Comput. Phys. 52, 24 (1983).
"""

from collections import namedtuple
from math import sqrt

from minimd.compiled.kernels import inlined, type_of
from minimd.constraints.newton import drift_with
from minimd.constraints.vectors import NOTHING, add_opposite, dot, separation

MAX_SWEEPS = 10_000


@inlined
def sweep_lengths(atoms, components, bonds, c, memory):
    """λ of component c by sweeps, from positions that have drifted: memory.total. Returns the number of sweeps."""
    start, end = components.starts[c], components.starts[c + 1]
    s, total = memory.s, memory.total
    for k in range(start, end):
        total[k] = 0.0
    sweeps, worst, where = 0, 2.0 * bonds.tolerance, start
    while not worst <= bonds.tolerance:
        if sweeps == MAX_SWEEPS:
            return NOTHING - where
        sweeps, worst = sweeps + 1, 0.0
        for k in range(start, end):
            i, j = bonds.first[k], bonds.second[k]
            r = separation(atoms.positions, i, j, bonds.offsets[k])
            gap = bonds.lengths2[k] - dot(r, r)
            if not abs(gap) <= worst * bonds.lengths2[k]:
                worst, where = abs(gap) / bonds.lengths2[k], k
            scale = gap / (2.0 * (atoms.inverse_masses[i] + atoms.inverse_masses[j]) * dot(r, s[k]))
            total[k] += scale
            add_opposite(atoms.positions, atoms.inverse_masses, i, j, scale, s[k])
    return sweeps


@inlined
def sweep_velocities(first, last, atoms, components, bonds):
    """Velocities of components first to last − 1, by sweeps. The tolerance is that of |r · v|/(|r| |v|), v the relative velocity of a bond."""
    velocities, inverse_masses = atoms.vectors, atoms.inverse_masses
    most = 0
    for c in range(first, last):
        start, end = components.starts[c], components.starts[c + 1]
        sweeps, worst, where = 0, 2.0 * bonds.tolerance, start
        while not worst <= bonds.tolerance:
            if sweeps == MAX_SWEEPS:
                return NOTHING - where
            sweeps, worst = sweeps + 1, 0.0
            for k in range(start, end):
                i, j = bonds.first[k], bonds.second[k]
                r = separation(atoms.positions, i, j, bonds.offsets[k])
                v = (velocities[j, 0] - velocities[i, 0], velocities[j, 1] - velocities[i, 1], velocities[j, 2] - velocities[i, 2])
                along, r2, v2 = dot(r, v), dot(r, r), dot(v, v)
                if along != 0.0 and not abs(along) <= worst * sqrt(r2 * v2):
                    worst, where = abs(along) / sqrt(r2 * v2), k
                add_opposite(velocities, inverse_masses, i, j, -along / ((inverse_masses[i] + inverse_masses[j]) * r2), r)
        most = max(most, sweeps)
    return most


SweepDrift = type_of(drift_with(sweep_lengths))(namedtuple("SweepDrift", ()))
SweepVelocities = type_of(sweep_velocities)(namedtuple("SweepVelocities", ()))
