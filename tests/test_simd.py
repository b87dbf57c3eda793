"""Vectors compute, lane by lane, what numpy computes element by element."""

import math
import operator

import numba
import numpy as np
import pytest

from minimd.compiled.kernels import scalar
from minimd.compiled.simd import bits_from_mask, broadcast, convert, fma, lane, load, select, store, total, with_lane
from minimd.potentials.law import evaluate_law
from minimd.potentials.truncation import TRUNCATIONS

import minimd as md  # isort: skip

TYPES = [np.float64, np.float32, np.int32]
LANES = [4, 8, pytest.param(16, marks=pytest.mark.slow)]  # minimd has vectors of 4 and of 8
FLOATS = TYPES[:2]


def numbers(kind, n, seed=0, low=0.5, high=4.0):
    return (
        np.random.default_rng(seed).uniform(low, high, n).astype(kind)
        if kind != np.int32
        else np.random.default_rng(seed).integers(-50, 50, n, dtype=np.int32)
    )


def on_vectors(functions, n):
    """Functions of two vectors, compiled, as one function of two arrays of n elements that fills n more of a third for each of them."""

    def from_place(k):
        if k == len(functions):
            return scalar(lambda a, b, out: None)
        compiled, others = scalar(functions[k]), from_place(k + 1)

        def run(a, b, out):
            store(out, k * n, compiled(load(a, 0, n), load(b, 0, n)))
            others(a, b, out)

        return scalar(run)

    run_all = from_place(0)
    return numba.njit(error_model="numpy")(lambda a, b, out: run_all(a, b, out))


def rows(functions, a, b):
    """What each function makes of the vectors a and b."""
    out = np.zeros(len(functions) * len(a), a.dtype)
    on_vectors(functions, len(a))(a, b, out)
    return out.reshape(len(functions), -1)


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("n", LANES)
def test_arithmetic_and_memory(kind, n):
    a, b = numbers(kind, n), numbers(kind, n, 1)
    functions = [lambda x, y: x + y, lambda x, y: x - y * y, lambda x, y: x * y - x]
    for function, row in zip(functions, rows(functions, a, b), strict=True):
        assert np.array_equal(row, function(a, b))


@pytest.mark.parametrize("kind", FLOATS)
@pytest.mark.parametrize("n", LANES)
def test_division_functions_and_numbers(kind, n):
    a, b = numbers(kind, n), numbers(kind, n, 1)
    cases = [
        (lambda x, y: x / y, lambda x, y: x / y),
        (lambda x, y: 1.0 / x + 2 * y - 0.5, lambda x, y: kind(1) / x + kind(2) * y - kind(0.5)),
        (lambda x, y: -x, lambda x, y: -x),
        (lambda x, y: math.sqrt(x), lambda x, y: np.sqrt(x)),
        (lambda x, y: np.sqrt(y), lambda x, y: np.sqrt(y)),
        (lambda x, y: abs(x - y), lambda x, y: np.abs(x - y)),
        (lambda x, y: max(0.5, min(x, 1.5)), lambda x, y: np.clip(x, kind(0.5), kind(1.5))),
        (lambda x, y: min(max(x, y), 2.5), lambda x, y: np.minimum(np.maximum(x, y), kind(2.5))),
        (lambda x, y: select(x < y, x, 7.0), lambda x, y: np.where(x < y, x, kind(7))),
        (lambda x, y: select((x >= y) | (x <= 1.0), x, y), lambda x, y: np.where((x >= y) | (x <= 1), x, y)),
        (lambda x, y: select((x > y) & (x != 1.0), x, y), lambda x, y: np.where((x > y) & (x != 1), x, y)),
    ]
    for (_, expected), row in zip(cases, rows([function for function, _ in cases], a, b), strict=True):
        assert np.array_equal(row, expected(a, b).astype(kind))


@pytest.mark.parametrize("name", ["exp", "log", "sin", "cos", "tanh"])
def test_functions_lane_by_lane(name):
    a, of_math, of_numpy = numbers(np.float64, 8), getattr(math, name), getattr(np, name)
    assert rows([lambda x, y: of_math(x) + of_numpy(y)], a, a)[0] == pytest.approx(2 * of_numpy(a), rel=1e-15)


def test_powers_lane_by_lane():
    a, powers = numbers(np.float64, 8), (0.5, 2, 3, -1, 2.0, 1.5, -3)
    for power, row in zip(powers, rows([lambda x, y, power=power: x**power for power in powers], a, a), strict=True):
        assert row == pytest.approx(a**power, rel=1e-15)


def test_fused_multiply_add_rounds_once():
    a = np.full(8, 1.0 + 2.0**-30)
    (out,) = rows([lambda x, y: fma(x, y, broadcast(-1.0, x))], a, a)
    assert np.array_equal(out, np.full(8, 2.0**-29 + 2.0**-60))


@pytest.mark.parametrize("kind", FLOATS)
def test_masks_lanes_and_sums(kind):
    @numba.njit
    def run(a, out):
        x = load(a, 0, 8)
        store(out, 0, select(x > 2.0, x, 0.0))
        return bits_from_mask(x > 2.0), total(x), lane(x, 5), total(with_lane(x, 2, 100.0))

    a, out = numbers(kind, 8), np.zeros(8, kind)
    bits, sum_, fifth, changed = run(a, out)
    assert np.array_equal(out, np.where(a > 2.0, a, 0.0).astype(kind))
    assert bits == sum(1 << k for k in range(8) if a[k] > 2.0)
    pairs = a.reshape(2, 4).sum(axis=0)
    assert sum_ == (pairs[0] + pairs[2]) + (pairs[1] + pairs[3])
    assert fifth == a[5]
    assert changed == pytest.approx(a.sum() - a[2] + 100.0, rel=1e-5)


def test_conversion_rounds_to_the_nearest():
    @numba.njit
    def run(wide, narrow, back):
        x, like = load(wide, 0, 8), load(narrow, 0, 8)
        store(narrow, 0, convert(x, like))
        store(back, 0, convert(load(narrow, 0, 8), x))

    wide, narrow, back = numbers(np.float64, 8), np.zeros(8, np.float32), np.zeros(8)
    run(wide, narrow, back)
    assert np.array_equal(narrow, wide.astype(np.float32))
    assert np.array_equal(back, narrow.astype(np.float64))


@pytest.mark.parametrize("like", ["number", "vector"])
@pytest.mark.parametrize("n", LANES)
@pytest.mark.parametrize(
    ("kind", "to"), [(np.int32, np.float32), (np.int32, np.float64), (np.float64, np.float32), (np.float32, np.float64)]
)
def test_conversion_goes_by_the_type_of_a_number_or_a_vector(kind, to, n, like):
    """Integers beyond 2²⁴ are rounded to the nearest float32, ties to even; in float64 all are exact."""
    number = to(0.0)

    @numba.njit
    def run(values, out):
        store(out, 0, convert(load(values, 0, n), number if like == "number" else load(out, 0, n)))

    limits = [2**31 - 1, -(2**31), 2**24 + 1, 2**24 + 3, -(2**24) - 1, 0, 1, -7]
    values = np.resize(limits, n).astype(kind) if kind == np.int32 else numbers(kind, n)
    out = np.ones(n, to)
    run(values, out)
    assert np.array_equal(out, values.astype(to))


@pytest.mark.parametrize("kind", TYPES)
def test_conversion_to_the_same_type_changes_nothing(kind):
    @numba.njit
    def run(values, out):
        x = load(values, 0, 8)
        store(out, 0, convert(x, x))

    values, out = numbers(kind, 8), np.zeros(8, kind)
    if kind == np.int32:
        values[:2] = 2**31 - 1, -(2**31)
    run(values, out)
    assert np.array_equal(out, values)


def test_differences_of_large_integers_are_exact_before_they_are_converted():
    """What mixed precision stands on: a small distance between far places has no rounding error."""

    @numba.njit
    def run(a, b, out):
        store(out, 0, convert(load(a, 0, 8) - load(b, 0, 8), np.float32(0.0)))

    b = np.linspace(-(2**31) + 1000, 2**31 - 1000, 8).astype(np.int32)
    out, apart = np.zeros(8, np.float32), np.arange(1, 9, dtype=np.int32)
    run(b + apart, b, out)
    assert np.array_equal(out, apart)


@pytest.mark.parametrize("truncation", TRUNCATIONS)
def test_laws_compile_for_vectors_from_the_same_source(truncation):
    @numba.njit(error_model="numpy")
    def run(law, r2, parameters, out):
        u, f = evaluate_law(law, load(r2, 0, 8), parameters)
        store(out, 0, u)
        store(out, 8, f)

    potential = md.LennardJones(1.3, 0.9, 2.5, truncation)
    parameters = tuple(potential.table(("X",))[0, 0, 1:].tolist())
    r2, out = np.linspace(0.8, 7.0, 8), np.zeros(16)
    run(potential.law, r2, parameters, out)
    expected = np.array([evaluate_law(potential.law, x, parameters) for x in r2.tolist()])
    assert pytest.approx(expected, rel=1e-14, abs=1e-16) == out.reshape(2, 8).T


def test_vector_code_uses_vector_instructions():
    """Reads the compiled code; only where the processor has AVX-512."""
    import llvmlite.binding

    if not llvmlite.binding.get_host_cpu_features().get("avx512f"):
        pytest.skip("no AVX-512 here")
    run = on_vectors([lambda x, y: x / y + x], 8)
    run(*(np.ones(8) for _ in range(3)))
    code = next(iter(run.inspect_asm().values()))
    assert "vdivpd" in code
    assert "zmm" in code
    assert "vdivsd" not in code


@pytest.mark.parametrize("operation", [operator.mod, operator.floordiv])
def test_what_vectors_cannot_do_is_an_error(operation):
    with pytest.raises(numba.core.errors.TypingError):
        rows([lambda x, y: operation(x, y)], np.ones(8), np.ones(8))
