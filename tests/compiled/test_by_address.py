"""What kernels get by the address of a named tuple, each copy of which has its own; the noise that they draw."""

import copy
import pickle
from collections import namedtuple

import numpy as np
import pytest

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, called_kernel, kernel
from minimd.core.compiled.normal_numbers import new_stream, normal, start_stream, three_normals
from minimd.core.compiled.program import operation

COPIES = [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one)), lambda one: one._replace(whole=7)]


class Inner(ByAddress, namedtuple("Inner", "flat matrix")):
    pass


class Outer(ByAddress, namedtuple("Outer", "number inner pair whole")):
    """pair : an array and a number."""


@kernel
def read(outer):
    number, inner, (flags, two), whole = outer
    flat, matrix = inner
    row = outer.inner.matrix[1]
    of_arrays = flat[flat.size - 1] + matrix[0, 2] + row[1] + 10.0 * row.size + 100.0 * flags[1]
    return number + two + whole + of_arrays + 1000.0 * outer[1].flat[0]


def outer():
    inner = Inner(np.array([1.0, 2.0, 0.125]), np.arange(6, dtype=np.int32).reshape(2, 3))
    return Outer(0.5, inner, (np.array([False, True]), 2.0), 4)


@pytest.mark.parametrize("copied", COPIES)
def test_a_kernel_reads_what_python_reads_and_a_copy_has_its_own_address(copied):
    first = outer()
    before, second = read(first), copied(first)
    assert before == read.py_func(first) == 0.5 + 2.0 + 4 + 0.125 + 2 + 4 + 30.0 + 100.0 + 1000.0
    assert second.address != first.address
    second.inner.flat[0] += 1.0
    assert read(second) == read.py_func(second)
    assert read(first) == before + (1000.0 if second.inner is first.inner else 0.0)


@called_kernel
def double_first(data, chunk):
    data.flat[0] *= 2
    return chunk


@pytest.mark.parametrize("other", [np.ones(3, np.int64), np.ones(3, np.float32), np.ones((3, 1)), np.ones(6)[::2]])
def test_calls_by_address_refuse_data_of_a_second_type(other):
    """The code of the first would take it for its own, and write beyond the array."""
    calls, matrix = DirectCalls(), np.ones((2, 2))
    first, again = operation(calls, double_first, Inner(np.ones(3), matrix)), Inner(np.zeros(7), matrix)
    assert operation(calls, double_first, again).code == first.code
    with pytest.raises(TypeError, match=r"double_first .*\(float64, 1, 'C'.*; got"):
        operation(calls, double_first, Inner(other, matrix))


@kernel
def draw(key, contact, step, numbers):
    """numbers (n, M) : in row k those of atom k."""
    stream = new_stream(key)
    for k in range(numbers.shape[0]):
        start_stream(stream, k, contact, step)
        for m in range(numbers.shape[1]):
            numbers[k, m] = normal(stream)


@kernel
def draw_three(key, contact, step, numbers):
    """The same, the first three of many atoms."""
    stream = new_stream(key)
    for k in range(numbers.shape[0]):
        numbers[k, 0], numbers[k, 1], numbers[k, 2] = three_normals(stream, k, contact, step)


def test_noise_has_the_bits_of_numpy():
    """Its rare branches too: numbers at the edges of layers and in the tail."""
    seed, step, contact, numbers = 2**100 + 12345678901234567, -3, 2, np.empty((5, 200_000))
    draw(np.array([seed % 2**64, seed >> 64], dtype=np.uint64), contact, step, numbers)
    for k, row in enumerate(numbers):
        counter = np.array([0, k, contact, step % 2**64], dtype=np.uint64)
        expected = np.random.Generator(np.random.Philox(key=seed, counter=counter)).standard_normal(row.size)
        assert np.array_equal(row, expected)
    assert np.abs(numbers).max() > 3.66  # in the tail
    key, one, three = np.array([seed % 2**64, seed >> 64], dtype=np.uint64), np.empty((9999, 3)), np.empty((9999, 3))
    draw(key, contact, step, one)
    draw_three(key, contact, step, three)
    assert np.array_equal(one, three)
