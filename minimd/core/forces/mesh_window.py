"""The window by which atoms and the points of a mesh see each other: ψ₀, so that it has few waves beyond those wanted.

    φ(x) = [ψ₀(2x/P) − ψ₀(1)]/ψ₀(0) for |x| < P/2, in units of the spacing h of the points;  φ̂(f) = ∫ φ cos(2π f x) dx

A wave of frequency f = h |k|/2π is seen by the points as those of f ± 1, … are: atoms seem to have waves that they have
not, in the ratio ρ = φ̂(f ± 1)/φ̂(f). In a mixture of charges q at random the mean square error of a force is

    q⁴ n Σ ∫ L̂² ρ² (k² + |k ± 2π/h|²) d³k/(2π)³ + 3/2 q⁴ (2π/h Σ ∫ L̂ ρ d³k/(2π)³)²

with n atoms in a volume. The first sum is over the three directions and both signs, the second, of the force on an
atom by its own image, over the signs; 3/2 is three directions and a mean sin². The waves that are left out give
q⁴ n ∫ L̂² k² d³k/(2π)³, k > c/r_c. The spacing follows from the ratio of the two, before the run.

R. W. Hockney, J. W. Eastwood, Computer Simulation Using Particles (1981), ch. 8; for ψ₀ as in prolates.py.
"""

from functools import cache
from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev, legendre

from minimd.core.potentials.prolates import Split, prolate
from minimd.core.structure.arrays import Array

POINTS = (4, 5, 6, 7, 8, 10, 12, 14, 16)  # that an atom sees in each direction
SHARE = 0.5  # of the mesh in the error, in units of that of the waves left out
# of the waves, 1/r_c, and atoms in r_c³: in the estimate, whatever the scene
LONGEST = 1.0
DENSITY = 20.0
FITTED = 0.01  # error of the polynomials, in units of the accuracy
NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)


class Window(NamedTuple):
    """points : P.
    bandwidth : of ψ₀.
    spacing : h, the largest that does [length]."""

    points: int
    bandwidth: float
    spacing: float

    def __call__(self, y: Any) -> Any:
        """φ at x = y P/2."""
        wave = prolate(self.bandwidth)
        return (legendre.legval(y, wave.series) - wave.at_end) / wave.at_zero

    def transform(self, f: Any) -> Any:
        """φ̂ of frequencies in units of 1/h."""
        waves = np.cos(pi * self.points * np.multiply.outer(f, NODES))
        return 0.5 * self.points * (waves @ (self(NODES) * WEIGHTS))

    def pieces(self, accuracy: float, width: int) -> Array:
        """φ of each of the P points, as polynomials of t: the first point is (t + 1)/2 from the edge; (D, width)."""

        def at(t: Array) -> Array:
            x = np.add.outer(0.5 * (t + 1.0), np.arange(self.points))
            return self(x * 2.0 / self.points - 1.0)

        t = np.linspace(-1.0, 1.0, 33)

        for degree in range(4, 24):
            places = np.cos(pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
            series = chebyshev.chebfit(places, at(places), degree)
            error = np.abs(chebyshev.chebval(t, series).T - at(t)).max()
            if error < max(FITTED * accuracy, 1e-15):
                break

        values = np.zeros((degree + 1, width))
        polynomials = [chebyshev.cheb2poly(column) for column in series.T]
        values[:, : self.points] = np.stack(polynomials, axis=1)
        return values


@cache
def windows(split: Split) -> list[Window]:
    """A window for each number of points that does for a split; the spacing is the largest that does."""
    enough = SHARE * _left_out(split)
    chosen = []

    for points in POINTS:
        for finer in np.arange(1.1, 2.5, 0.05):  # times the points that the shortest wave needs
            bandwidth = pi * points * (1.0 - 0.5 / finer) * (1.1 + 0.9 / points)
            window = Window(points, bandwidth, pi / (split.largest_wave * float(finer)))
            if _error(split, window) < enough:
                chosen.append(window)
                break

    return chosen


def _left_out(split: Split) -> float:
    """The root mean square error of a force by the waves that are left out, for q = 1.

    √(n ∫ L̂² k² d³k/(2π)³), k > c/r_c
    """
    wave = prolate(split.bandwidth)
    x = 0.5 * (NODES + 1.0)
    smooth = legendre.legval(x, wave.series)
    chi = 0.5 * WEIGHTS * (smooth - wave.at_end) / (1.0 - wave.at_end)
    kappa = split.bandwidth * (2.0 + NODES)
    spectrum = 4.0 * pi * (np.cos(np.outer(kappa, x)) @ chi)  # times k²
    part = split.largest_wave * WEIGHTS * 4.0 * pi / (2.0 * pi) ** 3
    return float(np.sqrt(DENSITY / split.cutoff**3 * (part * spectrum**2).sum()))


def _error(split: Split, window: Window) -> float:
    """The root mean square error of a force by a mesh, for q = 1: the sum of pairs and of atoms and their own images.

    split : of 1/r.
    window : with its spacing.
    """
    lowest = LONGEST / split.cutoff
    half = 0.5 * (split.largest_wave - lowest)
    k = lowest + half * (NODES[:, None] + 1.0)
    u = NODES
    part = half * WEIGHTS[:, None] * WEIGHTS * (k / (2.0 * pi)) ** 2
    spectrum = split.spectrum(k**2)[0]
    step = 2.0 * pi / window.spacing
    table = np.linspace(0.0, 1.5, 600)
    transform = window.transform(table)
    f = window.spacing / (2.0 * pi) * k * u
    of_pairs = of_itself = 0.0

    for sign in (-1.0, 1.0):
        of_alias = np.interp(np.abs(f + sign), table, transform)
        ratio = of_alias / np.interp(np.abs(f), table, transform)
        aliased = k**2 + 2.0 * sign * step * k * u + step**2
        of_wave = (spectrum * ratio) ** 2 * (k**2 + aliased)
        of_pairs += 3.0 * float((part * of_wave).sum())
        of_itself += step * float((part * spectrum * ratio).sum())

    return float(np.sqrt(DENSITY / split.cutoff**3 * of_pairs + 1.5 * of_itself**2))
