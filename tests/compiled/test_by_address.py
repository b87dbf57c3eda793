"""Named tuples that kernels get by their address: what is read there, and that each copy has an address of its own."""

import copy
import pickle
from collections import namedtuple

import numpy as np
import pytest

from minimd.compiled.by_address import ByAddress
from minimd.compiled.kernels import kernel

COPIES = [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one)), lambda one: one._replace(whole=7)]


class Inner(ByAddress, namedtuple("Inner", "flat matrix")):
    pass


class Outer(ByAddress, namedtuple("Outer", "number inner pair whole")):
    """pair : an array and a number."""


@kernel
def read(outer):
    """Every field, by name, by index and unpacked."""
    number, inner, (flags, two), whole = outer
    flat, matrix = inner
    row = outer.inner.matrix[1]
    of_arrays = flat[flat.size - 1] + matrix[0, 2] + row[1] + 10.0 * row.size + 100.0 * flags[1]
    return number + two + whole + of_arrays + 1000.0 * outer[1].flat[0]


def outer():
    inner = Inner(np.array([1.0, 2.0, 0.125]), np.arange(6, dtype=np.int32).reshape(2, 3))
    return Outer(0.5, inner, (np.array([False, True]), 2.0), 4)


def test_a_kernel_reads_what_python_reads():
    assert read(outer()) == read.py_func(outer()) == 0.5 + 2.0 + 4 + 0.125 + 2 + 4 + 30.0 + 100.0 + 1000.0


@pytest.mark.parametrize("copied", COPIES)
def test_a_copy_has_its_own_address(copied):
    first = outer()
    before, second = read(first), copied(first)
    assert second.address != first.address
    second.inner.flat[0] += 1.0
    assert read(second) == read.py_func(second)
    assert read(first) == before + (1000.0 if second.inner is first.inner else 0.0)
