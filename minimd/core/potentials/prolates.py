"""How 1/r is split for sums over periodic images: a part within the cutoff r_c, and a smooth rest with few waves.

    1/r = S(r) + L(r),   r L(r) = ∫₀^{r/r_c} χ(x) dx for r < r_c, and 1 beyond:  S(r) = 0 there
    the Fourier transform of L is 4π/k² ∫₀¹ χ(x) cos(k r_c x) dx

Of all functions on [−1, 1] the prolate spheroidal wave function ψ₀ has least outside |k| ≤ c/r_c. It does not quite
vanish at the ends; χ = (ψ₀ − ψ₀(1)) / ∫₀¹ (ψ₀ − ψ₀(1)) does, so that forces are continuous at the cutoff. Waves beyond
c/r_c are left out: that is the only error, and a single number, ψ₀(1)/ψ₀(0), tells how large it is.

All numbers are made by + − · / √ one by one, not by LAPACK or NumPy's sin: they are the same on every processor.

D. Slepian, H. O. Pollak, Bell Syst. Tech. J. 40, 43 (1961); Liang, Lu, Barnett, Greengard, Jiang, arXiv 2505.09727.
"""

from functools import cache
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev, legendre, polynomial

from minimd.core.compiled.simd.functions import cosine, sine
from minimd.core.structure.arrays import Array

Numbers = tuple[float, tuple[float, ...], tuple[float, ...]]

NARROWEST = 2.0  # bandwidth c
WIDEST = 40.0
ITERATIONS = 7  # each squares the error of ψ₀
# rms error of forces over rms force, in units of ψ₀(1)/ψ₀(0): 0.3 to 0.7 were measured in molten salts, 0.5 to 1.5 in
# water, up to 9 in cold crystals, whose forces nearly cancel, 0.04 in a slab of charge, whose forces are large
SAFETY = 9.0
DEGREES = (8, 12, 20, 28)  # of the polynomials in r²: one compiled form for each
FITTED = 0.0003  # error of a polynomial that is small enough, in units of the accuracy
LEAST_ACCURATE = 0.05  # what can be asked for
MOST_ACCURATE = 1e-13


class Split(NamedTuple):
    """1/r = S(r) + L(r) with numbers.

    cutoff : r_c [length].
    bandwidth : c.
    bound : of the rms error of forces over the rms force.
    numbers : (2/r_c², values, slopes) for the laws of coulomb.py: with t = 2 r²/r_c² − 1, L(r) = Σ valuesₖ tᵏ
        [1/length] and L′(r)/r = Σ slopesₖ tᵏ [1/length³].
    at_zero : L(0) [1/length].
    moment : ∫ S(r) d³r [length²].
    """

    cutoff: float
    bandwidth: float
    bound: float
    numbers: Numbers
    at_zero: float
    moment: float

    @property
    def largest_wave(self) -> float:
        """The largest |k| of the sum [1/length]."""
        return self.bandwidth / self.cutoff

    def spectrum(self, k2: Array) -> tuple[Array, Array]:
        """The Fourier transform of L at k² > 0 [length²], and its derivative by k² [length⁴]."""
        wave = prolate(self.bandwidth)
        k = np.sqrt(k2)
        kappa = k * self.cutoff
        y = kappa / wave.bandwidth
        # ∫₀¹ ψ₀(x) cos(c y x) dx is proportional to ψ₀(y)
        shape = legendre.legval(y, wave.series) / wave.at_zero - wave.at_end * sine(kappa) / kappa
        slope = legendre.legval(y, legendre.legder(wave.series))
        bend = slope / (wave.at_zero * wave.bandwidth)
        bend -= wave.at_end * (cosine(kappa) - sine(kappa) / kappa) / kappa
        scale = 4.0 * pi / (1.0 - wave.at_end)
        return scale * shape / k2, scale * (0.5 * bend * kappa - shape) / k2**2


class Prolate(NamedTuple):
    """ψ₀ of a bandwidth c on [−1, 1], with ∫₀¹ ψ₀ = 1.
    series : in Legendre polynomials.
    at_zero, at_end : ψ₀(0), ψ₀(1)."""

    bandwidth: float
    series: Array
    at_zero: float
    at_end: float


@cache
def prolate(bandwidth: float) -> Prolate:
    """ψ₀: the first eigenvector of a symmetric tridiagonal matrix, in even normalized Legendre polynomials.

    H. Xiao, V. Rokhlin, N. Yarvin, Inverse Problems 17, 805 (2001), eq. 63.
    """
    c2 = bandwidth**2
    k = 2.0 * np.arange(30 + int(bandwidth))
    n = k * (k + 1.0)
    diagonal = n + (2.0 * n - 1.0) / ((2.0 * k + 3.0) * (2.0 * k - 1.0)) * c2
    norms = (2.0 * k + 3.0) * np.sqrt((2.0 * k + 1.0) * (2.0 * k + 5.0))
    beside = (k + 2.0) * (k + 1.0) / norms * c2
    eigenvalue = bandwidth - 0.75  # nearly

    for _ in range(ITERATIONS):
        upwards = [1.0, 0.0]  # the vector, from its end, where it is smallest
        for i in range(len(k) - 1, 0, -1):
            below = (eigenvalue - diagonal[i]) * upwards[0] - beside[i] * upwards[1]
            upwards.insert(0, below / beside[i - 1])
        vector = np.array(upwards[:-1]) / upwards[0]
        eigenvalue += (diagonal[0] + beside[0] * vector[1] - eigenvalue) / (vector**2).sum()

    series = np.zeros(2 * len(k))
    series[::2] = vector * np.sqrt(k + 0.5)
    series /= series[0]  # ∫₀¹ of all others vanishes
    at_zero, at_end = legendre.legval([0.0, 1.0], series).tolist()
    return Prolate(bandwidth, series, at_zero, at_end)


def error_of(bandwidth: float) -> float:
    """Bound of the rms error of forces over the rms force."""
    wave = prolate(bandwidth)
    return SAFETY * abs(wave.at_end) / wave.at_zero


@cache
def split_for(cutoff: float, accuracy: float) -> Split:
    """The split with the smallest bandwidth whose bound is at most the accuracy."""
    bandwidth = WIDEST
    step = WIDEST - NARROWEST

    while step > 1e-3:
        step *= 0.5
        if error_of(bandwidth - step) <= accuracy:
            bandwidth -= step

    wave = prolate(bandwidth)
    integral = legendre.legint(wave.series)

    def smooth(t: Array) -> Array:
        """r_c L, of t = 2 r²/r_c² − 1."""
        x = np.sqrt(np.maximum(0.5 * (t + 1.0), 1e-24))
        area = legendre.legval(x, integral) - legendre.legval(0.0, integral) - wave.at_end * x
        return area / (x * (1.0 - wave.at_end))

    t = np.linspace(-1.0, 1.0, 1001)[1:-1]
    exact = smooth(t)
    enough = max(FITTED * accuracy, 1e-15) * exact.max()

    for degree in DEGREES:
        zeros = cosine(pi * (np.arange(degree + 1.0) + 0.5) / (degree + 1.0))
        products = chebyshev.chebvander(zeros, degree) * smooth(zeros)[:, None]
        series = 2.0 / len(zeros) * products.sum(axis=0)
        series[0] *= 0.5
        if np.abs(chebyshev.chebval(t, series) - exact).max() < enough:
            break

    values = chebyshev.cheb2poly(series) / cutoff
    slopes = 4.0 / cutoff**2 * polynomial.polyder(values)
    numbers = 2.0 / cutoff**2, tuple(values.tolist()), tuple(slopes.tolist())
    # ∫₀¹ x² ψ₀: of x² = (P₀ + 2 P₂)/3 the latter has ∫₀¹ P₂² = 1/5
    moment = (1.0 / 3.0 + 2.0 / 15.0 * wave.series[2] - wave.at_end / 3.0) / (1.0 - wave.at_end)
    at_zero = float(polynomial.polyval(-1.0, values))
    moment = 2.0 * pi * cutoff**2 * float(moment)
    return Split(cutoff, bandwidth, error_of(bandwidth), numbers, at_zero, moment)
