"""SHAKE and RATTLE by sweeps: one constraint after the other, again and again, until all are kept to a tolerance.

    λ_k = (d² − |r_k|²) / (2 (1/m_i + 1/m_j) r_k · s_k)          positions, along the bonds s before the drift
    μ_k = −r_k · v_k / ((1/m_i + 1/m_j) |r_k|²)                  velocities

J.-P. Ryckaert, G. Ciccotti, H. J. C. Berendsen, J. Comput. Phys. 23, 327 (1977); H. C. Andersen, J. Comput. Phys. 52, 24 (1983).
"""

from math import sqrt
from typing import NamedTuple

from minimd.compiled.kernels import inlined, type_of
from minimd.constraints.newton import NOTHING, add_opposite, dot, drift_some, find_separations, separation


@inlined
def sweep_drift(first, last, positions, velocities, inverse_masses, graph, offsets, lengths2, duration, tolerance, max_sweeps, memory):
    """Drift of components by sweeps; arguments as constraint_solvers.drift_components, tolerance of |r² − d²|/d²."""
    s, total = memory.s, memory.total
    most = 0
    for c in range(first, last):
        start, end = graph.starts[c], graph.starts[c + 1]
        find_separations(positions, graph, offsets, start, end, s)
        drift_some(positions, velocities, graph.atoms[graph.atom_starts[c] : graph.atom_starts[c + 1]], duration)
        for k in range(start, end):
            total[k] = 0.0
        sweeps, worst, where = 0, 2.0 * tolerance, start
        while not worst <= tolerance:
            if sweeps == max_sweeps:
                return NOTHING - where
            sweeps, worst = sweeps + 1, 0.0
            for k in range(start, end):
                i, j = graph.first[k], graph.second[k]
                r = separation(positions, i, j, offsets[k])
                gap = lengths2[k] - dot(r, r)
                if not abs(gap) <= worst * lengths2[k]:
                    worst, where = abs(gap) / lengths2[k], k
                scale = gap / (2.0 * (inverse_masses[i] + inverse_masses[j]) * dot(r, s[k]))
                total[k] += scale
                add_opposite(positions, inverse_masses, i, j, scale, s[k])
        for k in range(start, end):
            add_opposite(velocities, inverse_masses, graph.first[k], graph.second[k], total[k] / duration, s[k])
        most = max(most, sweeps)
    return most


@type_of(sweep_drift)
class SweepDrift(NamedTuple):
    """Marker of sweep_drift."""


@inlined
def sweep_velocities(first, last, positions, velocities, inverse_masses, graph, offsets, tolerance, max_sweeps):
    """Velocities of components, by sweeps; tolerance of |r · v|/(|r| |v|) for the velocity v of one end beside the other."""
    most = 0
    for c in range(first, last):
        start, end = graph.starts[c], graph.starts[c + 1]
        sweeps, worst, where = 0, 2.0 * tolerance, start
        while not worst <= tolerance:
            if sweeps == max_sweeps:
                return NOTHING - where
            sweeps, worst = sweeps + 1, 0.0
            for k in range(start, end):
                i, j = graph.first[k], graph.second[k]
                r = separation(positions, i, j, offsets[k])
                v = (velocities[j, 0] - velocities[i, 0], velocities[j, 1] - velocities[i, 1], velocities[j, 2] - velocities[i, 2])
                along, r2, v2 = dot(r, v), dot(r, r), dot(v, v)
                if along != 0.0 and not abs(along) <= worst * sqrt(r2 * v2):
                    worst, where = abs(along) / sqrt(r2 * v2), k
                add_opposite(velocities, inverse_masses, i, j, -along / ((inverse_masses[i] + inverse_masses[j]) * r2), r)
        most = max(most, sweeps)
    return most


@type_of(sweep_velocities)
class SweepVelocities(NamedTuple):
    """Marker of sweep_velocities."""
