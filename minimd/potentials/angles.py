"""Angles: a harmonic law of the angle at the middle atom of fixed triples."""

from __future__ import annotations

from collections import namedtuple
from math import pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.compiled.kernels import inlined, kernel
from minimd.compiled.simd import fma
from minimd.potentials.accumulators import force_along, in_steps, watch
from minimd.potentials.each import checked_each, columns_of
from minimd.potentials.term import FORCES, PER_ATOM, NoTerm, OwnPotential, OwnTerm, Term, no_bonds
from minimd.structure.bond_graph import checked_groups
from minimd.structure.cell import minimum_image_translations
from minimd.structure.checks import shown
from minimd.structure.system import System
from minimd.structure.vectors import combined, cross, dot


class HarmonicAngle(OwnPotential):
    """Harmonic angle u(θ) = ½ k (θ − θ₀)² at the middle atom of each triple.

    Where θ is exactly 0 or π, the force has no direction; it is then zero.

    Parameters
    ----------
    k : stiffness [energy/rad²], one number or one for each angle.
    angle : θ₀ [rad], between 0 and π, one number or one for each angle.
    triples : (A, 3) int, atoms i, j, k with j in the middle; system.angles if not given.

    Raises
    ------
    ValueError : if a number is not finite or out of range, or shapes do not fit.
    """

    def __init__(self, k: ArrayLike, angle: ArrayLike, triples: ArrayLike | None = None) -> None:
        self.triples = None if triples is None else checked_groups("triples", triples, 3)
        self.k, self.angle = checked_each("angles", {"k": k, "angle": angle}, not_negative=("k",)).values()
        if np.any((self.angle < 0.0) | (self.angle > pi)):
            raise ValueError(f"angle must lie between 0 and pi (radians); angle = {shown(self.angle.tolist())}")

    def arguments(self) -> dict[str, Any]:
        """See OwnPotential."""
        return {"k": self.k, "angle": self.angle, "triples": self.triples}

    def bind(self, system: System) -> Term:
        """The term of these angles in a system.

        Raises
        ------
        ValueError : if a triple names a missing atom, or an array of k or angle has
            another length than the list of angles.
        """
        triples = system.angles if self.triples is None else checked_groups("triples", self.triples, 3, len(system))
        k, angle = columns_of("angles", {"k": self.k, "angle": self.angle}, len(triples))
        if len(triples) == 0 and self.triples is None:
            return NoTerm(no_bonds(repr(self), "angles"))
        return AngleTerm(triples, k, angle)


class Angles(namedtuple("Angles", "first middle last first_translations last_translations k sine cosine")):
    """first, middle, last : (A,) int.  first_translations, last_translations : (A, 3) [length],
    added to r_first − r_middle and r_last − r_middle.

    k : (A,) stiffness [energy/rad²].  sine, cosine : (A,) of θ₀.
    """


@inlined
def _difference(x, y, translation):
    """x − y + translation rounded, and the sum of the two rounding errors (D. E. Knuth's two-sum)."""
    d = x - y
    z = d - x
    lost = (x - (d - z)) - (y + z)
    s = d + translation
    z = s - d
    return s, lost + ((d - (s - z)) + (translation - z))


@inlined
def _arm(positions, i, j, offset):
    """r_i − r_j + offset rounded, and what rounding has left out [length]."""
    x, lost_x = _difference(positions[i, 0], positions[j, 0], offset[0])
    y, lost_y = _difference(positions[i, 1], positions[j, 1], offset[1])
    z, lost_z = _difference(positions[i, 2], positions[j, 2], offset[2])
    return (x, y, z), (lost_x, lost_y, lost_z)


@inlined
def _minor(a, b, c, d):
    """a b − c d, right to a few roundings even where the products nearly cancel, if fma rounds once (W. Kahan)."""
    x, y = a * b, c * d
    return (x - y) + (fma(a, b, -x) - fma(c, d, -y))


@inlined
def _normal(a, b, lost_a, lost_b):
    """(a + lost_a) × (b + lost_b), to a few roundings however small the angle between them is."""
    n = _minor(a[1], b[2], a[2], b[1]), _minor(a[2], b[0], a[0], b[2]), _minor(a[0], b[1], a[1], b[0])
    return combined(1.0, n, 1.0, combined(1.0, cross(lost_a, b), 1.0, cross(a, lost_b)))


@kernel
def add_angle_forces(positions, angles, detail, sums):
    """Add harmonic angles u = ½ k (θ − θ₀)², with a = r_i − r_j, b = r_k − r_j, n = a × b.

        tan(θ − θ₀) = (|n| cos θ₀ − a·b sin θ₀)/(a·b cos θ₀ + |n| sin θ₀)
        F_i = u′(θ) n × a/(a²|n|),   F_k = u′(θ) b × n/(b²|n|),   F_j = −F_i − F_k,   all zero if n = 0

    positions : (N, 3) [length].  angles : Angles.  detail : see Term.add.  sums : its accumulators forces,
        energies and virials; or GridSums.
    θ near 0 and π, and θ − θ₀ if θ₀ is 0 or π, have all their digits.
    The virial a ⊗ F_i + b ⊗ F_k is symmetric because angles feel no torque. TOTALS adds an angle to its middle atom,
    PER_ATOM a third of it to each atom.
    """
    forces, energies, virials = sums[0], sums[1], sums[2]
    for t in range(angles.middle.size):
        i, j, l = angles.first[t], angles.middle[t], angles.last[t]
        a, lost_a = _arm(positions, i, j, angles.first_translations[t])
        b, lost_b = _arm(positions, l, j, angles.last_translations[t])
        n = _normal(a, b, lost_a, lost_b)
        size, ab, sine, cosine = dot(n, n) ** 0.5, dot(a, b), angles.sine[t], angles.cosine[t]
        stretch = np.arctan2(size * cosine - ab * sine, ab * cosine + size * sine)
        slope = angles.k[t] * stretch
        s = slope / size if size > 0.0 else 0.0
        across_a, across_b, s_a, s_b = cross(n, a), cross(b, n), s / dot(a, a), s / dot(b, b)
        size2 = 0.0
        for c in range(3):
            force_i, force_l = s_a * across_a[c], s_b * across_b[c]
            on_i, on_l = force_along(force_i, 1.0, sums), force_along(force_l, 1.0, sums)
            forces[i, c] += on_i
            forces[l, c] += on_l
            forces[j, c] -= on_i + on_l
            size2 += force_i * force_i + force_l * force_l
            for d in range(c, 3 if detail != FORCES else c):
                w, component = a[d] * force_i + b[d] * force_l, c if c == d else 6 - c - d
                if detail == PER_ATOM:
                    for atom in (i, j, l):
                        virials[atom, component] += in_steps(w / 3.0, sums)
                else:
                    virials[j, component] += in_steps(w, sums)
        watch(size2, sums)
        if detail == PER_ATOM:
            for atom in (i, j, l):
                energies[atom] += in_steps(0.5 * slope * stretch / 3.0, sums)
        elif detail != FORCES:
            energies[j] += in_steps(0.5 * slope * stretch, sums)


class AngleTerm(OwnTerm):
    """Harmonic angles, each arm taken at its nearest image."""

    def __init__(self, triples: NDArray[np.int64], k: NDArray[np.float64], angle: NDArray[np.float64]) -> None:
        first, middle, last = (np.array(triples[:, k]) for k in range(3))
        translations = np.zeros((2, len(triples), 3))
        self._angles = Angles(first, middle, last, translations[0], translations[1], k, np.sin(angle), np.cos(angle))

    def follow(self, system: System) -> bool:
        """See Term; images are looked for again."""
        self._angles.first_translations[:], self._angles.last_translations[:] = 0.0, 0.0
        return True

    def add_to(self, system: System, detail: int, sums: Any) -> None:
        """See Term."""
        cell, angles = system.cell, self._angles
        if cell.is_periodic:
            lattice = (cell.lattice, cell.inverse, cell.pbc, cell.safe_distance2)
            minimum_image_translations(
                system.positions, angles.middle, angles.first, *lattice, angles.first_translations
            )
            minimum_image_translations(system.positions, angles.middle, angles.last, *lattice, angles.last_translations)
        add_angle_forces(system.positions, angles, detail, sums)
