"""Decisions and normal numbers without rounding: exact, if the words they are made of are uniform and independent.

A decision compares a uniform number, whose bits are drawn as they are needed, with whole numbers that enclose e^(−x).
Floating point decides what is farther from the bound than its error, so that the results are the same everywhere. C.
Canonne, G. Kamath, T. Steinke, NeurIPS 33, 15676 (2020); C. F. F. Karney, ACM Trans. Math. Softw. 42, 3 (2016).
"""

from collections.abc import Callable
from fractions import Fraction
from math import exp

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.fixed_point import MOST
from minimd.core.compiled.kernels import kernel, scalar
from minimd.core.compiled.normal_numbers import UNIT, new_stream, next_word, philox, start_stream
from minimd.core.structure.arrays import Indices

Words = Callable[[], int]  # the next uniform word of 64 bits

WORD = 64
GUARD = 24  # bits, for the rounding of series and squares
FURTHER = 8  # bits of a bound, beyond those of the number that is compared with it
MARGIN = 2.0**-48  # more than the error of the probability in _drawn
UNDECIDED = np.iinfo(np.int64).min
WIDEST = int(MOST)


def bounds_of_exp(x: Fraction, bits: int) -> tuple[int, int]:
    """Whole numbers low ≤ 2^bits e^(−x) ≤ high, for x ≥ 0: the alternating series of x/2^r, squared r times."""
    r = (x.numerator // x.denominator).bit_length() + 1
    unit_bits = bits + r + GUARD
    low_y = (x.numerator << unit_bits) // (x.denominator << r)
    low = max(_series(low_y + 1, unit_bits, -1), 0)
    high = _series(low_y, unit_bits, 1)
    for _ in range(r):
        low = low * low >> unit_bits
        high = -(-high * high >> unit_bits)
    return low >> (unit_bits - bits), -(-high >> (unit_bits - bits))


def _series(y: int, bits: int, side: int) -> int:
    """2^bits e^(−y/2^bits), for y below 2^bits, beyond rounding: at least that (side 1), or at most (−1)."""
    total = term = 1 << bits
    n = 0
    while term:
        n += 1
        term = term * y // (n << bits)
        total += term if n % 2 == 0 else -term
    return total + side * (n + 2)


def happens(x: Fraction, words: Words) -> bool:
    """True with probability min(1, e^(−x)), exactly. It takes no word if x ≤ 0, else seldom more than one."""
    if x <= 0:
        return True
    known = 0
    n_bits = 0
    while True:
        known = known << WORD | words()
        n_bits += WORD
        low, high = bounds_of_exp(x, n_bits + FURTHER)
        if (known + 1) << FURTHER <= low:
            return True
        if known << FURTHER >= high:
            return False


_ROOT = bounds_of_exp(Fraction(1, 2), 8 * WORD)[0]
# of e^(−1/2), in base 2⁶⁴
DIGITS = np.array([_ROOT >> WORD * (7 - k) & (2**WORD - 1) for k in range(7)], dtype=np.uint64)


def whole_normals(
    seed: int, step: int, widths: Indices, dimensions: int, margin: float = MARGIN
) -> Indices:
    """Whole numbers y, (N, 3), from P(y) ∝ e^(−y²/2s²), |y| ≤ 2⁵⁰, exactly: independent ones for each atom and
    direction.

    seed, step : of the words; those of an atom depend on its number, not on others.
    widths : (N,) s, whole numbers below 2⁵⁰; 0 for atoms that are held fixed, and have none.
    margin : between a probability and a uniform number, within which whole numbers decide.
    """
    numbers = np.zeros((len(widths), 3), dtype=np.int64)
    key = np.array([seed % 2**WORD, seed >> WORD], dtype=np.uint64)
    _draw(key, np.uint64(step % 2**WORD), widths, dimensions, margin, numbers)
    for atom in np.flatnonzero((numbers == UNDECIDED).any(axis=1)):
        words = philox(seed, 0, step, int(atom)).bit_generator.random_raw  # type: ignore[attr-defined]
        own = [whole_normal(int(widths[atom]), words) for _ in range(dimensions)]
        numbers[atom, :dimensions] = own
    return numbers


def whole_normal(s: int, words: Words) -> int:
    """One of whole_normals, by whole numbers alone: y = ±(ks + j), 0 ≤ j < s, where k has the probability of e^(−k/2),
    and is then accepted with e^(−(k(k−1) + (j/s)(2k + j/s))/2)."""
    mask = 2 ** (s - 1).bit_length() - 1
    while True:
        k = 0
        while happens(Fraction(1, 2), words):
            k += 1
        word = words()
        while word & mask >= s:
            word = words()
        j = word & mask
        y = k * s + j
        is_negative = word >> WORD - 1
        if (y == 0 and is_negative) or y > WIDEST:
            continue
        if happens(Fraction(j * (2 * k * s + j), 2 * s * s) + Fraction(k * (k - 1), 2), words):
            return -y if is_negative else y


@kernel
def _draw(key, step, widths, dimensions, margin, numbers):
    """See whole_normals; the numbers of an atom end with UNDECIDED where floating point cannot decide."""
    stream = new_stream(key)
    for i in range(widths.size):
        if widths[i] > 0:
            start_stream(stream, i, 0, step)
            for c in range(dimensions):
                numbers[i, c] = _drawn(widths[i], stream, margin)
                if numbers[i, c] == UNDECIDED:
                    break


@scalar
def _drawn(s, stream, margin):
    """See whole_normal."""
    mask = np.uint64(1)
    while mask < np.uint64(s - 1):
        mask = mask << np.uint64(1) | np.uint64(1)
    if s == 1:
        mask = np.uint64(0)
    while True:
        k = 0
        while _is_below_root(stream):
            k += 1
        word = next_word(stream)
        while word & mask >= np.uint64(s):
            word = next_word(stream)
        j = np.int64(word & mask)
        y = k * s + j
        is_negative = word >> np.uint64(63) != 0
        if (y == 0 and is_negative) or y > WIDEST:
            continue
        if j == 0 and k < 2:  # certain
            return -y if is_negative else y
        x = j / s
        p = exp(-0.5 * (k * (k - 1) + x * (2 * k + x)))
        u = (next_word(stream) >> np.uint64(11)) * UNIT
        if u + UNIT <= p - margin:
            return -y if is_negative else y
        if u < p + margin:
            return UNDECIDED


@scalar
def _is_below_root(stream):
    """Whether a uniform number is below e^(−1/2)."""
    for digit in DIGITS:
        word = next_word(stream)
        if word != digit:
            return word < digit
    return False


def rotated(
    p: NDArray[np.float64], q: NDArray[np.float64], kept: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Whole numbers (p, q) turned towards q, by the angle whose cosine is kept, through three shears that are rounded:
    one-to-one, and undone for (p, −q). p² + q² changes a little."""
    sine = float(np.sqrt(1.0 - kept * kept))
    shear = (1.0 - kept) / sine  # tan of half the angle
    p = p + np.rint(shear * q)
    q = q - np.rint(sine * p)
    return p + np.rint(shear * q), q
