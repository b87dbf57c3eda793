"""Elementary functions of vectors, to about two units in the last place: Taylor series, where they converge fast.

    sin, cos      x = k π/2 + r,  |r| ≤ π/4        series of sin r and cos r, exchanged and negated by k mod 4
    arctan        q = tan(θ + arctan q′)           θ = 0, π/8 or π/4:  |q′| ≤ tan π/16
    exp           x = k ln 2 + r,  |r| ≤ ½ ln 2    eˣ = 2ᵏ eʳ
    log           x = 2ᵏ m,  ½ < m² ≤ 2            ln x = k ln 2 + 2 artanh s,  s = (m − 1)/(m + 1)

π/2 and ln 2 are sums of two numbers, the products with k are rounded once (W. J. Cody, W. Waite, Software Manual for
the Elementary Functions (1980)): r has all its digits for |x| up to some 10⁹. Numbers below 2.2 · 10⁻³⁰⁸ count as zero.
"""

import math

import numpy as np

from minimd.core.compiled.kernels import in_kernels, scalar
from minimd.core.compiled.simd.arithmetic import bind_one, fma, select
from minimd.core.compiled.simd.vector import MAGIC, Vector, as_floats, bits_of, broadcast, float_of

HALF_PI = 0.5 * math.pi
REST_OF_PI = 6.123233995736766e-17  # the sum with HALF_PI is π/2
LN_2 = math.log(2.0)
REST_OF_LN_2 = 2.3190468138462996e-17  # the sum with LN_2 is ln 2
SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(1, 9))
COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(9))
ARCTANGENT = tuple((-1.0) ** k / (2 * k + 1) for k in range(1, 11))
EXPONENTIAL = tuple(1.0 / math.factorial(k) for k in range(2, 15))
LOGARITHM = tuple(2.0 / (2 * k + 1) for k in range(1, 12))
EIGHTH = math.tan(math.pi / 8.0)
MIDDLE = (math.tan(math.pi / 16.0), math.tan(3.0 * math.pi / 16.0))
LEAST = float(np.finfo(np.float64).tiny)
MOST = float(np.finfo(np.float64).max)
# float64: the exponent follows on 52 bits of the mantissa, and is that of a number from 1 to 2 if it is 1023
MANTISSA = (1 << 52) - 1
ONE = 1023 << 52
BIAS = 1023


def polynomial(t, c):
    """Σ c[k] tᵏ of a number or a vector; unrolled by the compiler."""
    total = 0.0
    for coefficient in c[::-1]:
        total = total * t + coefficient
    return total


@in_kernels(polynomial)
def _polynomial(t, c):
    if len(c) == 2:
        return lambda t, c: fma(t, c[1], c[0])
    if len(c) > 5:  # four at once: the compiler, which calls itself, must not go too deep

        def four(t, c):
            rest = fma(t, polynomial(t, c[4:]), c[3])
            return fma(t, fma(t, fma(t, rest, c[2]), c[1]), c[0])

        return four
    return lambda t, c: fma(t, polynomial(t, c[1:]), c[0])


@scalar
def _sine(x, shift):
    """sin(x + shift π/2)."""
    k = np.floor(x * (1.0 / HALF_PI) + 0.5)
    r = fma(k, -REST_OF_PI, fma(k, -HALF_PI, x))
    k = k + shift
    z = r * r
    half = 0.5 * k
    quarter = 0.25 * k
    is_sine = half == np.floor(half)
    value = select(is_sine, fma(r * z, polynomial(z, SINE), r), polynomial(z, COSINE))
    return select(quarter - np.floor(quarter) < 0.5, value, -value)


@scalar
def sine(x):
    """sin x."""
    return _sine(x, 0.0)


@scalar
def cosine(x):
    """cos x."""
    return _sine(x, 1.0)


@scalar
def arctangent(y, x):
    """The angle of (x, y), both finite, to the x axis, from −π to π; 0 for (0, 0)."""
    is_steep = abs(y) > abs(x)
    rise = select(is_steep, abs(x), abs(y))
    run = select(is_steep, abs(y), abs(x))
    is_wide = rise > MIDDLE[1] * run
    is_middle = rise > MIDDLE[0] * run
    slope = select(is_middle, broadcast(EIGHTH, x), 0.0)
    slope = select(is_wide, broadcast(1.0, x), slope)
    start = select(is_middle, broadcast(0.25 * HALF_PI, x), 0.0)
    start = select(is_wide, broadcast(0.5 * HALF_PI, x), start)
    q = fma(run, -slope, rise) / fma(rise, slope, run)
    q = select(run == 0.0, rise, q)
    angle = start + fma(q * (q * q), polynomial(q * q, ARCTANGENT), q)
    angle = select(is_steep, HALF_PI - angle, angle)
    angle = select(x < 0.0, math.pi - angle, angle)
    return select(y < 0.0, -angle, angle)


@scalar
def exponential(x):
    """eˣ."""
    k = np.floor(x * (1.0 / LN_2) + 0.5)
    r = fma(k, -REST_OF_LN_2, fma(k, -LN_2, x))
    half = np.floor(0.5 * k)  # 2ᵏ may be out of range where eˣ is not
    power = 1.0 + fma(r * r, polynomial(r, EXPONENTIAL), r)
    power = power * _two_to_the(half) * _two_to_the(k - half)
    return select(x > math.log(MOST), math.inf, select(x < math.log(LEAST), 0.0, power))


@scalar
def _two_to_the(k):
    return float_of((bits_of(k + MAGIC) + BIAS) << 52)


@scalar
def logarithm(x):
    """ln x; −∞ for 0, no number for x < 0."""
    bits = bits_of(x)
    k = as_floats((bits >> 52) - BIAS)
    m = float_of((bits & MANTISSA) | ONE)
    is_large = m > math.sqrt(2.0)
    k = select(is_large, k + 1.0, k)
    m = select(is_large, 0.5 * m, m)
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    log = fma(k, LN_2, 2.0 * s + fma(s * z, polynomial(z, LOGARITHM), k * REST_OF_LN_2))
    below = select(x >= 0.0, broadcast(-math.inf, x), math.nan)
    return select(x >= LEAST, select(x <= MOST, log, x), below)


_OPERATIONS = {"sin": sine, "cos": cosine, "exp": exponential, "log": logarithm}
for _name, _operation in _OPERATIONS.items():
    for _module in (math, np):
        bind_one(getattr(_module, _name), _operation)


@in_kernels(math.atan2)
@in_kernels(np.arctan2)
def _arctangent(y, x):
    return (lambda y, x: arctangent(y, x)) if isinstance(y, Vector) and y == x else None
