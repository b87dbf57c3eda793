"""Bonded potentials: laws between fixed pairs, and harmonic angles between fixed triples."""

from collections.abc import Callable
from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.compiled.kernels import kernel
from minimd.potentials.law import user_law
from minimd.potentials.laws import HarmonicLaw
from minimd.potentials.pair_loop import FORCES, PER_ATOM

STRAIGHT = 1e-8  # sin θ below which the derivative of a harmonic angle is taken at its limit


class BondPotential:
    """A law u(r) along bonds, whatever their length.

    Parameters
    ----------
    law : function law(r2, *parameters) as for PairPotential.
    parameters : one entry for each parameter of the law: a number for all bonds, or an array with one number for each.
    pairs : (B, 2) int, the bonded atoms; system.bonds if not given.

    Each bond runs to the nearest image of its partner. Raises ValueError for parameters that are not finite.
    """

    def __init__(self, law: Callable | tuple, parameters: tuple[ArrayLike, ...] = (), pairs: ArrayLike | None = None) -> None:
        self.law = law if isinstance(law, tuple) else user_law(law)
        self.pairs = pairs
        self.parameters = tuple(np.array(parameter, dtype=np.float64) for parameter in parameters)
        for parameter in self.parameters:
            if not np.isfinite(parameter).all():
                raise ValueError(f"bond parameters must be finite; they are {parameter.tolist()}")

    def table(self, n_bonds: int) -> NDArray[np.float64]:
        """Numbers of each bond: (B, 1 + P), the squared cutoff (infinite) first.

        Raises
        ------
        ValueError : if an array of parameters has another length than the list of bonds.
        """
        for parameter in self.parameters:
            if parameter.shape not in ((), (n_bonds,)):
                raise ValueError(f"a bond parameter must be one number or {n_bonds}, one for each bond; its shape is {parameter.shape}")
        columns = [np.broadcast_to(column, n_bonds) for column in (np.array(np.inf), *self.parameters)]
        return np.stack(columns, axis=-1)


class HarmonicBond(BondPotential):
    """Harmonic bond u(r) = ½ k (r − r₀)².

    Parameters
    ----------
    k : stiffness [energy/length²], one number or one for each bond.
    length : r₀ [length], one number or one for each bond.
    pairs : (B, 2) int, the bonded atoms; system.bonds if not given.

    Raises
    ------
    ValueError : if k is negative, or a length is, or one of them is not finite.
    """

    def __init__(self, k: ArrayLike, length: ArrayLike, pairs: ArrayLike | None = None) -> None:
        for name, values in (("k", k), ("length", length)):
            if np.any(np.asarray(values, dtype=np.float64) < 0.0):
                raise ValueError(f"{name} of a harmonic bond must not be negative; {name} = {np.asarray(values).tolist()}")
        super().__init__(HarmonicLaw(), (k, length), pairs)


class HarmonicAngle:
    """Harmonic angle u(θ) = ½ k (θ − θ₀)² at the middle atom of each triple.

    Parameters
    ----------
    k : stiffness [energy/rad²], one number or one for each angle.
    angle : θ₀ [rad], between 0 and π, one number or one for each angle.
    triples : (A, 3) int, atoms i, j, k with j in the middle.

    Raises
    ------
    ValueError : if a number is not finite or out of range, or shapes do not fit.
    """

    def __init__(self, k: ArrayLike, angle: ArrayLike, triples: ArrayLike) -> None:
        self.triples = _checked_triples(triples)
        self.k = _one_each("k", k, len(self.triples))
        self.angle = _one_each("angle", angle, len(self.triples))
        if np.any((self.angle < 0.0) | (self.angle > pi)):
            raise ValueError(f"angle must lie between 0 and pi (radians); angle = {self.angle.tolist()}")


class Triples(NamedTuple):
    """first, middle, last : (A,) int.  first_translations, last_translations : (A, 3) [length], added to r_first − r_middle and r_last − r_middle."""

    first: Any
    middle: Any
    last: Any
    first_translations: Any
    last_translations: Any


@kernel
def add_angle_forces(positions, triples, k, angle, detail, forces, energies, virials):
    """Add harmonic angles u = ½ k (θ − θ₀)², with cos θ = a·b/(|a||b|), a = r_i − r_j, b = r_k − r_j.

        F_i = s (b/(|a||b|) − cos θ a/|a|²),   F_k = s (a/(|a||b|) − cos θ b/|b|²),   F_j = −F_i − F_k,   s = u′(θ)/sin θ

    Shapes and detail as in add_pair_forces; the virial a ⊗ F_i + b ⊗ F_k is symmetric because angles feel no torque.
    TOTALS books an angle on its middle atom, PER_ATOM a third of it on each atom.
    """
    for t in range(triples.middle.size):
        i, j, l = triples.first[t], triples.middle[t], triples.last[t]
        a = np.empty(3)
        b = np.empty(3)
        for c in range(3):
            a[c] = positions[i, c] - positions[j, c] + triples.first_translations[t, c]
            b[c] = positions[l, c] - positions[j, c] + triples.last_translations[t, c]
        a2, b2 = a[0] * a[0] + a[1] * a[1] + a[2] * a[2], b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
        ab = (a2 * b2) ** 0.5
        cosine = min(1.0, max(-1.0, (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) / ab))
        theta = np.arccos(cosine)
        slope = k[t] * (theta - angle[t])
        s = slope / max(STRAIGHT, (1.0 - cosine * cosine) ** 0.5)
        for c in range(3):
            force_i = s * (b[c] / ab - cosine * a[c] / a2)
            force_l = s * (a[c] / ab - cosine * b[c] / b2)
            forces[i, c] += force_i
            forces[l, c] += force_l
            forces[j, c] -= force_i + force_l
            if detail != FORCES:
                for d in range(c, 3):
                    w = a[d] * force_i + b[d] * force_l
                    component = c if c == d else 6 - c - d
                    if detail == PER_ATOM:
                        virials[i, component] += w / 3.0
                        virials[j, component] += w / 3.0
                        virials[l, component] += w / 3.0
                    else:
                        virials[j, component] += w
        if detail == PER_ATOM:
            energies[i] += 0.5 * slope * (theta - angle[t]) / 3.0
            energies[j] += 0.5 * slope * (theta - angle[t]) / 3.0
            energies[l] += 0.5 * slope * (theta - angle[t]) / 3.0
        elif detail != FORCES:
            energies[j] += 0.5 * slope * (theta - angle[t])


def _checked_triples(triples: ArrayLike) -> NDArray[np.int64]:
    array = np.array(triples)
    if array.ndim != 2 or array.shape[1] != 3 or not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"triples must be an (A, 3) array of atom indices; its shape is {array.shape}, its type {array.dtype}")
    return array.astype(np.int64)


def _one_each(name: str, values: ArrayLike, n: int) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape not in ((), (n,)):
        raise ValueError(f"{name} must be one number or {n}, one for each angle; its shape is {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite; {name} = {array.tolist()}")
    return np.ascontiguousarray(np.broadcast_to(array, n))
