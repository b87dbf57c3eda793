"""Normal random numbers in compiled code: those of numpy, to the last bit.

numpy.random.Generator(Philox(key, counter)).standard_normal(3) takes much longer to set up than to draw the numbers;
here there is nothing to set up, so that each atom can have a counter of its own: its noise does not depend on others.

Philox4x64-10, four words for each value of a counter: J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, Random
numbers: as easy as 1, 2, 3, SC11 (2011). The ziggurat, 256 layers of equal area under the curve: G. Marsaglia, W. W.
Tsang, J. Stat. Softw. 5, 8 (2000).
"""

from collections import namedtuple
from math import exp, log, log1p

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numba.np.random import _constants as numpys

from minimd.core.compiled.kernels import inlined, kernel, scalar

# multipliers of Philox4x64
FIRST = np.uint64(0xD2E7470EE14C6C93)
SECOND = np.uint64(0xCA5A826395121157)
# what its key grows by: fractions of (√5 − 1)/2 and of √3 − 1
GOLDEN = np.uint64(0x9E3779B97F4A7C15)
ROOT = np.uint64(0xBB67AE8584CAA73B)
ROUNDS = 10
LAYERS = np.uint64(255)
MANTISSA = np.uint64((1 << 52) - 1)
# of the layers
INSIDE = numpys.ki_double
WIDTHS = numpys.wi_double
HEIGHTS = numpys.fi_double
TAIL = numpys.ziggurat_nor_r  # where the lowest layer ends and the tail of the curve begins
UNIT = 2.0**-53
# contacts that no bath of atoms reaches: one seed may serve a bath and all of these
OF_BAROSTATS, OF_DIRECTIONS, OF_DECISIONS = 2**32, 2**32 + 1, 2**32 + 2
# numbers of steps are taken modulo this; those of an equilibration, before step 0, are negative
STEPS = 2**64


def philox(seed: int, contact: int, step: int, stream: int = 0) -> np.random.Generator:
    """The generator of random numbers for a contact with a bath in a step, or for another stream of numbers."""
    counter = np.array([0, stream, contact, step % STEPS], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=seed, counter=counter))


class NoiseStream(namedtuple("NoiseStream", "key counter words place")):
    """Random words.
    key : (2,), counter : (4,), words : (4,) uint64, of it.
    place : (1,) int, how many are used."""


@inlined
def new_stream(key):
    """A stream with this key, (2,) uint64; start_stream must be called before its first number."""
    counter = np.zeros(4, dtype=np.uint64)
    words_of_counter = np.zeros(4, dtype=np.uint64)
    return NoiseStream(key, counter, words_of_counter, np.zeros(1, dtype=np.int64))


@scalar
def three_normals(stream, atom, contact, step):
    """The first three normal numbers of Philox(key, counter=[0, atom, contact, step])."""
    counter = np.uint64(1), np.uint64(atom), np.uint64(contact), np.uint64(step)
    a, b, c, _ = _philox(counter, stream.key)
    x, is_x = _inside(a)
    y, is_y = _inside(b)
    z, is_z = _inside(c)
    if is_x and is_y and is_z:  # 97 of 100
        return x, y, z
    start_stream(stream, atom, contact, step)
    x = normal(stream)
    y = normal(stream)
    z = normal(stream)
    return x, y, z


@scalar
def start_stream(stream, atom, contact, step):
    """Begin with the numbers of Philox(key, counter=[0, atom, contact, step])."""
    stream.counter[0] = 0
    stream.counter[1] = atom
    stream.counter[2] = contact
    stream.counter[3] = np.uint64(step)
    stream.place[0] = 4


@scalar
def normal(stream):
    """The next normal number."""
    while True:
        word = next_word(stream)
        x, is_inside = _inside(word)
        if is_inside:
            return x
        x, is_under_curve = _at_edge(x, word & LAYERS, word >> np.uint64(9) & MANTISSA, stream)
        if is_under_curve:
            return x


@kernel
def normals(key, atom, contact, step, n):
    """The first n normal numbers of Philox(key, counter=[0, atom, contact, step]); all of these are uint64."""
    stream = new_stream(key)
    start_stream(stream, atom, contact, step)
    numbers = np.empty(n)
    for k in range(n):
        numbers[k] = normal(stream)
    return numbers


@inlined
def sum_of_squares(stream, n):
    """The sum of the squares of n normal numbers, for n > 2 twice a gamma variate.
    G. Marsaglia, W. W. Tsang, ACM Trans. Math. Softw. 26, 363 (2000)."""
    total = 0.0
    if n < 3:
        for _ in range(n):
            total += normal(stream) ** 2
        return total
    d = 0.5 * n - 1.0 / 3.0
    while True:
        x = normal(stream)
        v = (1.0 + x / (9.0 * d) ** 0.5) ** 3
        if v > 0.0 and log(1.0 - _uniform(stream)) < 0.5 * x * x + d * (1.0 - v + log(v)):
            return 2.0 * d * v


@scalar
def _inside(word):
    """The number that a word stands for, and whether it lies inside its layer, as 99 of 100 do."""
    layer = word & LAYERS
    mantissa = word >> np.uint64(9) & MANTISSA
    x = mantissa * WIDTHS[layer]
    return (-x if word >> np.uint64(8) & np.uint64(1) else x), mantissa < INSIDE[layer]


@kernel
def _at_edge(x, layer, mantissa, stream):
    """A number that may lie above the curve, and whether it lies under it; or a number of the tail."""
    if layer > np.uint64(0):
        low = HEIGHTS[layer]
        high = HEIGHTS[layer - np.uint64(1)]
        height = (high - low) * _uniform(stream) + low
        return x, height < exp(-0.5 * x * x)
    while True:
        beyond = -log1p(-_uniform(stream)) * numpys.ziggurat_nor_inv_r
        level = -log1p(-_uniform(stream))
        if level + level > beyond * beyond:
            x = TAIL + beyond
            return (-x if mantissa >> np.uint64(8) & np.uint64(1) else x), True


@scalar
def _uniform(stream):
    """From 0 to 1, without 1."""
    return (next_word(stream) >> np.uint64(11)) * UNIT


@scalar
def next_word(stream):
    """The next word."""
    if stream.place[0] == 4:
        stream.counter[0] += np.uint64(1)
        for k, word in enumerate(_philox(stream.counter, stream.key)):
            stream.words[k] = word
        stream.place[0] = 0
    stream.place[0] += 1
    return stream.words[stream.place[0] - 1]


@scalar
def _philox(counter, key):
    """The four words of a counter."""
    a, b, c, d = counter[0], counter[1], counter[2], counter[3]
    k = key[0]
    m = key[1]
    for _ in range(ROUNDS):
        high, low = _words(FIRST, a)
        high_2, low_2 = _words(SECOND, c)
        a, b, c, d = high_2 ^ b ^ k, low_2, high ^ d ^ m, low
        k = k + GOLDEN
        m = m + ROOT
    return a, b, c, d


@intrinsic
def _words(_context, a, b):
    """The upper and the lower 64 of the 128 bits of a product of two words: one instruction."""
    kind = types.UniTuple(types.uint64, 2)

    def generate(context, builder, _signature, values):
        wide = ir.IntType(128)
        word = ir.IntType(64)
        product = builder.mul(*(builder.zext(value, wide) for value in values))
        high = builder.trunc(builder.lshr(product, wide(64)), word)
        low = builder.trunc(product, word)
        return context.make_tuple(builder, kind, (high, low))

    return kind(types.uint64, types.uint64), generate
