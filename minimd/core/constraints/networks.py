"""Distance constraints of any shape: Newton's method on all of a component, within an envelope, or sweeps.

    drift        r′ = r + Δt v + M⁻¹ Gᵀ λ,  |r′_ij|² = d²,  v′ = (r′ − r)/Δt        G : rows s_k = r_ij before the drift
    velocities   v′ = v + M⁻¹ Gᵀ μ,  r_ij · v′_ij = 0                                G : rows r_k = r_ij now

with r_ij = r_j − r_i + offset. J.-P. Ryckaert, G. Ciccotti, H. J. C. Berendsen, J. Comput. Phys. 23, 327 (1977);
H. C. Andersen, J. Comput. Phys. 52, 24 (1983); V. Kräutler, W. F. van Gunsteren, P. H. Hünenberger, J. Comput. Chem.
22, 501 (2001).

SHAKE and RATTLE sweep: one constraint after the other, repeatedly, until all are kept to a tolerance.

    λ_k = (d² − |r_k|²) / (2 (1/m_i + 1/m_j) r_k · s_k)          positions, along the bonds s before the drift
    μ_k = −r_k · v_k / ((1/m_i + 1/m_j) |r_k|²)                  velocities
"""

from collections import namedtuple
from math import sqrt

from minimd.core.compiled.kernels import inlined, kernel, type_of
from minimd.core.compiled.machine import EPS
from minimd.core.constraints.closed_forms import NOTHING, add_opposite, drift_some
from minimd.core.structure.vectors import dot, minus, separation

MAX_ITERATIONS = 50
MAX_SWEEPS = 10_000
ROUNDING = 4.0 * EPS  # of |r|² against d²: no iteration makes it smaller
# of residuals below this, one more iteration makes rounding (it squares them), even where the equations are stiff
LAST = 1e-9
DEPENDENT = 1e-10  # relative to its diagonal: a smaller pivot is rounding


class NetworkScratch(namedtuple("NetworkScratch", "r s x total lower upper")):
    """Scratch: r, s : (K, 3) separations.
    x, total : (K,) multipliers.
    lower, upper : factors, in the envelope."""


@inlined
def find_separations(positions, bonds, start, end, out):
    """out[k] = r_ij of constraints start to end − 1."""
    for k in range(start, end):
        i, j = bonds.first[k], bonds.second[k]
        for x in range(3):
            out[k, x] = positions[j, x] - positions[i, x] + bonds.offsets[k, x]


@inlined
def factorize(components, start, end, r, s, lower, upper):
    """A = L U within the envelope, L with ones on its diagonal.

        A_kl = c_kl r_k · s_l

    components : Components.
    start, end : constraints start to end − 1 are those of the component.
    r, s : (K, 3) separations now, and those along which forces act.
    lower : output, row k of L left of the diagonal.
    upper : output, column k of U down to the diagonal.
    Returns the row without a pivot, or −1."""
    origins = components.origins
    lowest = components.lowest
    coupling = components.coupling

    for k in range(start, end):
        at_k = origins[k]

        for l in range(lowest[k], k):
            at_l = origins[l]
            c = coupling[at_k + l]
            in_column = c * dot(r[l], s[k]) if c != 0.0 else 0.0
            in_row = c * dot(r[k], s[l]) if c != 0.0 else 0.0
            for m in range(max(lowest[k], lowest[l]), l):
                in_column -= lower[at_l + m] * upper[at_k + m]
                in_row -= lower[at_k + m] * upper[at_l + m]
            upper[at_k + l] = in_column
            lower[at_k + l] = in_row / upper[at_l + l]

        pivot = coupling[at_k + k] * dot(r[k], s[k])
        for m in range(lowest[k], k):
            pivot -= lower[at_k + m] * upper[at_k + m]
        if not abs(pivot) > 0.0:
            return k
        upper[at_k + k] = pivot

    return NOTHING


@inlined
def solve(components, start, end, lower, upper, x):
    """x ← A⁻¹ x.

    lower, upper : the factors of A, see factorize.
    x : (K,), changed."""
    for k in range(start, end):
        at = components.origins[k]
        for m in range(components.lowest[k], k):
            x[k] -= lower[at + m] * x[m]
    for k in range(end - 1, start - 1, -1):
        at = components.origins[k]
        x[k] /= upper[at + k]
        for m in range(components.lowest[k], k):
            x[m] -= upper[at + m] * x[k]


@inlined
def restore_lengths(atoms, components, bonds, start, end, memory):
    """λ of a component by Newton's method, from positions that have drifted.

    start, end : constraints start to end − 1 are those of the component.
    memory : NetworkScratch; λ is added to its total.
    Returns the iterations, or −1 − the constraint that could not be kept."""
    r, s, x, total, lower, upper = memory

    for iteration in range(MAX_ITERATIONS):
        find_separations(atoms.positions, bonds, start, end, r)
        worst = 0.0
        where = start

        for k in range(start, end):
            x[k] = 0.5 * (bonds.lengths2[k] - dot(r[k], r[k]))
            violation = abs(2.0 * x[k]) / bonds.lengths2[k]
            if not violation <= worst:
                worst = violation
                where = k

        if worst <= ROUNDING:
            return iteration
        singular = factorize(components, start, end, r, s, lower, upper)
        if singular >= 0:
            return NOTHING - singular
        solve(components, start, end, lower, upper, x)
        for k in range(start, end):
            total[k] += x[k]
            add_opposite(atoms.positions, atoms.inverse_masses, bonds, k, x[k], s[k])
        if worst < LAST:
            return iteration + 1

    return NOTHING - where


@inlined
def sweep_lengths(atoms, _components, bonds, start, end, memory):
    """As restore_lengths, by sweeps. Returns the number of sweeps."""
    positions = atoms.positions
    inverse_masses = atoms.inverse_masses
    s = memory.s
    where = start

    for sweep in range(1, MAX_SWEEPS + 1):
        worst = 0.0

        for k in range(start, end):
            i, j = bonds.first[k], bonds.second[k]
            r = separation(positions, i, j, bonds.offsets[k])
            gap = bonds.lengths2[k] - dot(r, r)
            if not abs(gap) <= worst * bonds.lengths2[k]:
                worst = abs(gap) / bonds.lengths2[k]
                where = k
            scale = gap / (2.0 * (inverse_masses[i] + inverse_masses[j]) * dot(r, s[k]))
            memory.total[k] += scale
            add_opposite(positions, inverse_masses, bonds, k, scale, s[k])

        if worst <= bonds.tolerance:
            return sweep

    return NOTHING - where


def drift_with(restore):
    """The drift of components of any shape, with a solver that restores their lengths, such as restore_lengths."""

    @inlined
    def drift_components(first, last, atoms, components, bonds, memory, duration):
        """Drift of components first to last − 1.

        atoms : Atoms, changed.
        components : Components.
        bonds : Bonds.
        memory : NetworkScratch.
        duration : [time].
        Returns the largest number of iterations, or −1 − the constraint that could not be kept."""
        s = memory.s
        total = memory.total
        most = 0

        for c in range(first, last):
            start = components.starts[c]
            end = components.starts[c + 1]
            find_separations(atoms.positions, bonds, start, end, s)
            first_atom = components.atom_starts[c]
            last_atom = components.atom_starts[c + 1]
            members = components.atoms[first_atom:last_atom]
            drift_some(atoms.positions, atoms.vectors, members, duration)
            for k in range(start, end):
                total[k] = 0.0
            n_iterations = restore(atoms, components, bonds, start, end, memory)
            if n_iterations < 0:
                return n_iterations

            for k in range(start, end):
                add_opposite(
                    atoms.vectors, atoms.inverse_masses, bonds, k, total[k] / duration, s[k]
                )

            most = max(most, n_iterations)

        return most

    return drift_components


@inlined
def project_components(first, last, atoms, components, bonds, memory, targets, total):
    """As project_pairs, for components of any shape; projected twice, to remove the rounding of the first projection.

    targets : (K,).
    total : (K,), output, the multipliers.
    Returns 1, or −1 − the constraint that depends on others."""
    vectors = atoms.vectors
    r, _, x, _, lower, upper = memory

    for c in range(first, last):
        start = components.starts[c]
        end = components.starts[c + 1]
        find_separations(atoms.positions, bonds, start, end, r)
        singular = factorize(components, start, end, r, r, lower, upper)
        if singular >= 0:
            return NOTHING - singular

        for correction in range(2):
            for k in range(start, end):
                i, j = bonds.first[k], bonds.second[k]
                x[k] = targets[k]
                for d in range(3):
                    x[k] -= r[k, d] * (vectors[j, d] - vectors[i, d])

            solve(components, start, end, lower, upper, x)
            for k in range(start, end):
                total[k] = x[k] + (total[k] if correction else 0.0)
                add_opposite(vectors, atoms.inverse_masses, bonds, k, x[k], r[k])

    return 1


@kernel
def dependent_constraint(positions, components, bonds, memory):
    """A constraint that others imply or contradict: its pivot vanishes relative to its diagonal; −1 if there is none.

    positions : (N, 3) [length].
    components : Components.
    bonds : Bonds.
    memory : NetworkScratch."""
    r, _, _, _, lower, upper = memory

    for c in range(components.starts.size - 1):
        start = components.starts[c]
        end = components.starts[c + 1]
        find_separations(positions, bonds, start, end, r)
        singular = factorize(components, start, end, r, r, lower, upper)
        if singular >= 0:
            return singular

        for k in range(start, end):
            at = components.origins[k] + k
            if not upper[at] > DEPENDENT * (components.coupling[at] * dot(r[k], r[k])):
                return k

    return NOTHING


@inlined
def sweep_component(atoms, bonds, start, end):
    """Velocities of a component, constraints start to end − 1. Returns the number of sweeps."""
    velocities = atoms.vectors
    inverse_masses = atoms.inverse_masses
    where = start

    for sweep in range(1, MAX_SWEEPS + 1):
        worst = 0.0

        for k in range(start, end):
            i, j = bonds.first[k], bonds.second[k]
            r = separation(atoms.positions, i, j, bonds.offsets[k])
            v = minus(velocities[j], velocities[i])
            along = dot(r, v)
            r2 = dot(r, r)
            v2 = dot(v, v)
            if along != 0.0 and not abs(along) <= worst * sqrt(r2 * v2):
                worst = abs(along) / sqrt(r2 * v2)
                where = k
            scale = -along / ((inverse_masses[i] + inverse_masses[j]) * r2)
            add_opposite(velocities, inverse_masses, bonds, k, scale, r)

        if worst <= bonds.tolerance:
            return sweep

    return NOTHING - where


@inlined
def sweep_velocities(first, last, atoms, components, bonds, _memory, _targets, _multipliers):
    """Velocities of components first to last − 1, by sweeps, if all targets are zero.
    The tolerance is that of |r · v|/(|r| |v|), v the relative velocity of a bond."""
    most = 0
    for c in range(first, last):
        sweeps = sweep_component(atoms, bonds, components.starts[c], components.starts[c + 1])
        if sweeps < 0:
            return sweeps
        most = max(most, sweeps)
    return most


DriftComponents = type_of(drift_with(restore_lengths))(namedtuple("DriftComponents", ()))
ProjectComponents = type_of(project_components)(namedtuple("ProjectComponents", ()))
SweepDrift = type_of(drift_with(sweep_lengths))(namedtuple("SweepDrift", ()))
SweepVelocities = type_of(sweep_velocities)(namedtuple("SweepVelocities", ()))
