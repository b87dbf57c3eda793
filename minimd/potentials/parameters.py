"""Where the parameters of a pair come from: one tuple for all, a table by species, or a row for each pair."""

from collections import namedtuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from minimd.compiled.kernels import by_type


class SameForAll(namedtuple("SameForAll", "numbers")):
    """One tuple of numbers for every pair."""


class BySpecies(namedtuple("BySpecies", "columns species")):
    """columns : tuple of (S, S) arrays, one for each parameter.  species : (N,) int."""


class ByPair(namedtuple("ByPair", "columns")):
    """columns : tuple of (P,) arrays, one for each parameter."""


def parameters_of_pair(source, p, i, j):
    """The parameters of pair p between atoms i and j: a tuple of numbers, the squared cutoff first."""
    if isinstance(source, SameForAll):
        return source.numbers
    if isinstance(source, BySpecies):
        return tuple(column[source.species[i], source.species[j]] for column in source.columns)
    return tuple(column[p] for column in source.columns)


@overload(parameters_of_pair)
def _parameters_of_pair(source, p, i, j):
    kind = source.instance_class
    if kind is SameForAll:
        return lambda source, p, i, j: source.numbers
    if kind is BySpecies:
        return lambda source, p, i, j: _row(source.columns, (source.species[i], source.species[j]))
    return lambda source, p, i, j: _row(source.columns, p)


@by_type
def _row(columns, index):
    """(columns[0][index], columns[1][index], …), unrolled by the compiler."""
    if len(columns) == 1:
        return lambda columns, index: (columns[0][index],)
    return lambda columns, index: (columns[0][index],) + _row(columns[1:], index)


def by_species(table: NDArray[np.float64], species: NDArray[np.int64]) -> SameForAll | BySpecies:
    """Where the loop finds the numbers of a table (S, S, 1 + P), for atoms of these species (N,)."""
    if len(table) == 1:
        return SameForAll(tuple(table[0, 0].tolist()))
    return BySpecies(from_table(table), species)


def from_table(table: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """The columns (last axis) of a parameter table as contiguous arrays."""
    return tuple(np.ascontiguousarray(table[..., k]) for k in range(table.shape[-1]))
