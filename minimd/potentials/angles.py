"""Angles: a harmonic law of the angle at the middle atom of fixed triples."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.compiled.kernels import inlined, scalar
from minimd.compiled.simd import fma, select
from minimd.console.words import shown
from minimd.potentials.each import checked_each, columns_of
from minimd.potentials.links import LinkedTerm, arm, link_shape, push
from minimd.potentials.term import NoTerm, OwnPotential, Term, no_bonds
from minimd.structure.bond_graph import checked_groups
from minimd.structure.system import System
from minimd.structure.vectors import combined, cross, dot, times


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
        ValueError : if a triple names a missing atom, or an array of k or angle has another length than that list.
        """
        triples = system.angles if self.triples is None else checked_groups("triples", self.triples, 3, len(system))
        k, angle = columns_of("angles", {"k": self.k, "angle": self.angle}, len(triples))
        if len(triples) == 0 and self.triples is None:
            return NoTerm(no_bonds(repr(self), "angles"))
        i, j, l = triples.T
        return LinkedTerm(([j, j], [i, l]), triples, Bend(), (), (k, np.sin(angle), np.cos(angle)))


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


@scalar
def _bend(links, block, _law, numbers):
    """Harmonic angles u = ½ k (θ − θ₀)², with a = r_i − r_j, b = r_k − r_j, n = a × b.

        tan(θ − θ₀) = (|n| cos θ₀ − a·b sin θ₀)/(a·b cos θ₀ + |n| sin θ₀)
        F_i = u′(θ) n × a/(a²|n|),   F_k = u′(θ) b × n/(b²|n|),   all zero if n = 0

    numbers : k [energy/rad²], sin θ₀, cos θ₀. θ near 0 and π, and θ − θ₀ if θ₀ is 0 or π, have all their digits.
    """
    (a, lost_a), (b, lost_b), (k, sine, cosine) = arm(links, 0, block), arm(links, 1, block), numbers
    n = _normal(a, b, lost_a, lost_b)
    size, ab = dot(n, n) ** 0.5, dot(a, b)
    stretch = np.arctan2(size * cosine - ab * sine, ab * cosine + size * sine)
    slope = k * stretch
    s = select(size > 0.0, slope / size, 0.0)
    is_beyond = push(links, 0, block, times(s / dot(a, a), cross(n, a)))
    return 0.5 * slope * stretch, push(links, 1, block, times(s / dot(b, b), cross(b, n))) or is_beyond


Bend = link_shape("Bend", _bend)
