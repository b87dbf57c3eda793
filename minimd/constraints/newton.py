"""Solvers for distance constraints: bonds of their own in closed form, sweeps, and Newton's method within an envelope.

    drift        r′ = r + Δt v + M⁻¹ Gᵀ λ,  |r′_ij|² = d²,  v′ = (r′ − r)/Δt        G : rows s_k = r_ij before the drift
    velocities   v′ = v + M⁻¹ Gᵀ μ,  r_ij · v′_ij = 0                                G : rows r_k = r_ij now

with r_ij = r_j − r_i + offset. J.-P. Ryckaert, G. Ciccotti, H. J. C. Berendsen, J. Comput. Phys. 23, 327 (1977);
H. C. Andersen, J. Comput. Phys. 52, 24 (1983); V. Kräutler, W. F. van Gunsteren, P. H. Hünenberger, J. Comput. Chem. 22, 501 (2001).

Kernels return the worst case: a number of iterations, negative if the constraint −1 − that number could not be kept.
"""

from math import sqrt
from typing import Any, NamedTuple

from minimd.compiled.kernels import inlined, kernel, type_of
from minimd.compiled.machine import EPS

ROUNDING = 4.0 * EPS  # of |r|² against d²: there is nothing left to gain
LAST = 1e-9  # residuals below: one more iteration of Newton's squares them to rounding, even where their equations are stiff
NOTHING = -1
DEPENDENT = 1e-10  # a pivot this small beside its diagonal is rounding


class Memory(NamedTuple):
    """What the solvers work in. r, s : (K, 3) separations.  x, total : (K,) multipliers.  lower, upper : factors, in the envelope."""

    r: Any
    s: Any
    x: Any
    total: Any
    lower: Any
    upper: Any


@inlined
def separation(positions, i, j, offset):
    """r_j − r_i + offset [length]."""
    return positions[j, 0] - positions[i, 0] + offset[0], positions[j, 1] - positions[i, 1] + offset[1], positions[j, 2] - positions[i, 2] + offset[2]


@inlined
def add_opposite(vectors, inverse_masses, i, j, scale, s):
    """Vectors of j += scale s/m_j, of i −= scale s/m_i."""
    wi, wj = scale * inverse_masses[i], scale * inverse_masses[j]
    for x in range(3):
        vectors[i, x] -= wi * s[x]
        vectors[j, x] += wj * s[x]


@kernel
def drift_some(positions, velocities, atoms, duration):
    """positions += duration · velocities, of some atoms. (N, 3), (N, 3), (F,), [time]."""
    for i in atoms:
        for x in range(3):
            positions[i, x] += duration * velocities[i, x]


@inlined
def drift_pairs(start, end, positions, velocities, inverse_masses, first, second, offsets, lengths2, duration):
    """Drift of bonds that share no atom: λ is the smaller root of a quadratic equation.

    (N, 3), (N, 3), (N,); (K,), (K,), (K, 3), (K,) d² [length²]; [time].
    """
    for k in range(start, end):
        i, j = first[k], second[k]
        s = separation(positions, i, j, offsets[k])
        px = s[0] + duration * (velocities[j, 0] - velocities[i, 0])
        py = s[1] + duration * (velocities[j, 1] - velocities[i, 1])
        pz = s[2] + duration * (velocities[j, 2] - velocities[i, 2])
        w = inverse_masses[i] + inverse_masses[j]
        a = w * w * (s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
        b = w * (px * s[0] + py * s[1] + pz * s[2])
        c = px * px + py * py + pz * pz - lengths2[k]
        discriminant = b * b - a * c
        if not (discriminant >= 0.0 and b > 0.0):
            return NOTHING - k
        scale = -c / (b + sqrt(discriminant))
        wi, wj = scale * inverse_masses[i], scale * inverse_masses[j]
        for x in range(3):
            vi, vj = velocities[i, x] - wi / duration * s[x], velocities[j, x] + wj / duration * s[x]
            velocities[i, x], velocities[j, x] = vi, vj
            positions[i, x] += duration * vi
            positions[j, x] += duration * vj
    return 1


@type_of(drift_pairs)
class DriftPairs(NamedTuple):
    """Marker of drift_pairs."""


@inlined
def project_pairs(start, end, positions, vectors, inverse_masses, first, second, offsets, targets, multipliers):
    """Vectors of bonds that share no atom, given a component along each bond: r · (x_j − x_i) = target.

    Velocities with targets 0 keep the lengths; accelerations with −v². multipliers : (K,), x_j gains multiplier r/m_j.
    """
    for k in range(start, end):
        i, j = first[k], second[k]
        r = separation(positions, i, j, offsets[k])
        along = r[0] * (vectors[j, 0] - vectors[i, 0]) + r[1] * (vectors[j, 1] - vectors[i, 1]) + r[2] * (vectors[j, 2] - vectors[i, 2])
        multipliers[k] = (targets[k] - along) / ((inverse_masses[i] + inverse_masses[j]) * dot(r, r))
        add_opposite(vectors, inverse_masses, i, j, multipliers[k], r)
    return 1


@type_of(project_pairs)
class ProjectPairs(NamedTuple):
    """Marker of project_pairs."""


@inlined
def find_separations(positions, graph, offsets, start, end, out):
    """out[k] = r_ij of constraints start … end − 1."""
    for k in range(start, end):
        i, j = graph.first[k], graph.second[k]
        for x in range(3):
            out[k, x] = positions[j, x] - positions[i, x] + offsets[k, x]


@inlined
def dot(a, b):
    """a · b of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def assemble(graph, start, end, r, s, lower, upper):
    """A_kl = c_kl r_k · s_l within the envelope: row k left of the diagonal into lower, column k down to it into upper."""
    for k in range(start, end):
        at = graph.begins[k] - graph.lowest[k]
        for l in range(graph.lowest[k], k + 1):
            c = graph.coupling[at + l]
            lower[at + l] = c * dot(r[k], s[l]) if c != 0.0 else 0.0
            upper[at + l] = c * dot(r[l], s[k]) if c != 0.0 else 0.0


@inlined
def factorize(graph, start, end, lower, upper):
    """A = L U in place, L with ones on its diagonal. Returns the row without a pivot, or −1."""
    for k in range(start, end):
        at_k, first_k = graph.begins[k] - graph.lowest[k], graph.lowest[k]
        for l in range(first_k, k):
            at_l = graph.begins[l] - graph.lowest[l]
            in_column, in_row = upper[at_k + l], lower[at_k + l]
            for m in range(max(first_k, graph.lowest[l]), l):
                in_column -= lower[at_l + m] * upper[at_k + m]
                in_row -= lower[at_k + m] * upper[at_l + m]
            upper[at_k + l], lower[at_k + l] = in_column, in_row / upper[at_l + l]
        pivot = upper[at_k + k]
        for m in range(first_k, k):
            pivot -= lower[at_k + m] * upper[at_k + m]
        if not abs(pivot) > 0.0:
            return k
        upper[at_k + k] = pivot
    return NOTHING


@inlined
def solve(graph, start, end, lower, upper, x):
    """X ← A⁻¹ x with the factors of A."""
    for k in range(start, end):
        at = graph.begins[k] - graph.lowest[k]
        for m in range(graph.lowest[k], k):
            x[k] -= lower[at + m] * x[m]
    for k in range(end - 1, start - 1, -1):
        at = graph.begins[k] - graph.lowest[k]
        x[k] /= upper[at + k]
        for m in range(graph.lowest[k], k):
            x[m] -= upper[at + m] * x[k]


@inlined
def worst_violation(r, lengths2, start, end, x):
    """x_k = (d² − r²)/2, and the constraint with the largest |r² − d²|/d², and that value."""
    worst, where = 0.0, start
    for k in range(start, end):
        x[k] = 0.5 * (lengths2[k] - dot(r[k], r[k]))
        violation = abs(2.0 * x[k]) / lengths2[k]
        if not violation <= worst:
            worst, where = violation, k
    return worst, where


@inlined
def restore_lengths(positions, inverse_masses, graph, offsets, lengths2, c, max_iterations, memory):
    """Newton's method for the λ of component c, from positions that have drifted; memory.total gathers them."""
    start, end = graph.starts[c], graph.starts[c + 1]
    r, s, x, total, lower, upper = memory
    for k in range(start, end):
        total[k] = 0.0
    for iteration in range(max_iterations):
        find_separations(positions, graph, offsets, start, end, r)
        worst, where = worst_violation(r, lengths2, start, end, x)
        if worst <= ROUNDING:
            return iteration
        assemble(graph, start, end, r, s, lower, upper)
        singular = factorize(graph, start, end, lower, upper)
        if singular >= 0:
            return NOTHING - singular
        solve(graph, start, end, lower, upper, x)
        for k in range(start, end):
            total[k] += x[k]
            add_opposite(positions, inverse_masses, graph.first[k], graph.second[k], x[k], s[k])
        if worst < LAST:
            return iteration + 1
    return NOTHING - where


@inlined
def drift_components(first, last, positions, velocities, inverse_masses, graph, offsets, lengths2, duration, max_iterations, memory):
    """Drift of components of any shape, by Newton's method on all constraints of each.

    (N, 3), (N, 3), (N,); Graph; (K, 3), (K,) d² [length²]; [time]; Memory.
    """
    s, total = memory.s, memory.total
    most = 0
    for c in range(first, last):
        start, end = graph.starts[c], graph.starts[c + 1]
        find_separations(positions, graph, offsets, start, end, s)
        drift_some(positions, velocities, graph.atoms[graph.atom_starts[c] : graph.atom_starts[c + 1]], duration)
        n_iterations = restore_lengths(positions, inverse_masses, graph, offsets, lengths2, c, max_iterations, memory)
        if n_iterations < 0:
            return n_iterations
        for k in range(start, end):
            add_opposite(velocities, inverse_masses, graph.first[k], graph.second[k], total[k] / duration, s[k])
        most = max(most, n_iterations)
    return most


@type_of(drift_components)
class DriftComponents(NamedTuple):
    """Marker of drift_components."""


@inlined
def project_components(first, last, positions, vectors, inverse_masses, graph, offsets, targets, memory):
    """As project_pairs, for components of any shape; corrected once more for the rounding of the first time.

    memory.total holds the multipliers. Returns 1, or −1 − the constraint that depends on others.
    """
    r, x, total, lower, upper = memory.r, memory.x, memory.total, memory.lower, memory.upper
    for c in range(first, last):
        start, end = graph.starts[c], graph.starts[c + 1]
        find_separations(positions, graph, offsets, start, end, r)
        assemble(graph, start, end, r, r, lower, upper)
        singular = factorize(graph, start, end, lower, upper)
        if singular >= 0:
            return NOTHING - singular
        for correction in range(2):
            for k in range(start, end):
                i, j = graph.first[k], graph.second[k]
                x[k] = targets[k]
                for d in range(3):
                    x[k] -= r[k, d] * (vectors[j, d] - vectors[i, d])
            solve(graph, start, end, lower, upper, x)
            for k in range(start, end):
                total[k] = x[k] + (total[k] if correction else 0.0)
                add_opposite(vectors, inverse_masses, graph.first[k], graph.second[k], x[k], r[k])
    return 1


@type_of(project_components)
class ProjectComponents(NamedTuple):
    """Marker of project_components."""


@kernel
def dependent_constraint(positions, graph, offsets, memory):
    """A constraint whose pivot vanishes beside its diagonal, so that it follows from others or contradicts them; −1 if there is none."""
    r, total, lower, upper = memory.r, memory.total, memory.lower, memory.upper
    for c in range(graph.starts.size - 1):
        start, end = graph.starts[c], graph.starts[c + 1]
        find_separations(positions, graph, offsets, start, end, r)
        assemble(graph, start, end, r, r, lower, upper)
        for k in range(start, end):
            total[k] = upper[graph.begins[k + 1] - 1]
        singular = factorize(graph, start, end, lower, upper)
        if singular >= 0:
            return singular
        for k in range(start, end):
            if not upper[graph.begins[k + 1] - 1] > DEPENDENT * total[k]:
                return k
    return NOTHING
