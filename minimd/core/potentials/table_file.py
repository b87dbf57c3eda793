"""The tables of pairs in a file for LAMMPS' pair_style table.

    # comments, and empty lines, anywhere
    KEYWORD
    N 500 R 0.8 2.5             or RSQ, of equally spaced r²; without both, r is that of each row
    1 0.8 34.1 643.2            number, r, u, force; N such rows

A tag UNITS in the first comment tells real from metal: energies in kcal/mol become eV, as in LAMMPS. FP and FPRIME, the
slopes of the force at both ends, are passed over: splines of minimd do not need them.
"""

import os
import re

import numpy as np

from minimd.core.console.words import listed, shown
from minimd.core.potentials.embedded_files import read_as
from minimd.core.structure.arrays import Array
from minimd.core.structure.units import KJ_PER_MOL_PER_EV

UNITS = re.compile(r"#.*\bUNITS:\s*(\S+)")
# by this tag: the energy of minimd's units, eV or ε
ENERGIES = {"metal": 1.0, "lj": 1.0, "real": 4.184 / KJ_PER_MOL_PER_EV}
NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
HEADER = re.compile(
    rf"(?=(?:.*\s)?N\s)(?:\s*(?:N\s+(\d+)|(RSQ|R)\s+({NUMBER})\s+({NUMBER})"
    rf"|FP(?:RIME)?\s+{NUMBER}\s+{NUMBER})(?=\s|$))+\s*"
)
POWERS = {"R": 1, "RSQ": 2}
COLUMNS = 4
# of the distance of two points: by how much r of a row may differ from that of the spacing, which is the one taken
ROUNDED = 0.1


def read_table(file: str | os.PathLike[str], keyword: str | None) -> Array:
    """r [length], u [energy] and the force [energy/length] of a keyword, (3, N); of the only one for None.
    Raises OSError for a file that cannot be read; ValueError for one that holds something else."""
    tables = read_as(file, _tables)
    if keyword is None and len(tables) == 1:
        (keyword,) = tables
    if keyword not in [*tables]:
        raise ValueError(
            f"keyword must be that of a section, {listed(tables)}; keyword = {shown(keyword)}"
        )
    return tables[keyword]


def _tables(_name: str, text: str) -> dict[str, Array]:
    """The tables in the text of a file, by keyword.
    Raises ValueError for a text that has something else."""
    tag = UNITS.match(text)
    units = tag[1] if tag else "metal"
    if units not in ENERGIES:
        raise ValueError(f"UNITS must be one of {listed(ENERGIES)}; it is {shown(units)}")
    split = [line.partition("#")[0].strip() for line in text.splitlines()]
    lines = [(k, line) for k, line in enumerate(split, 1) if line]
    tables: dict[str, Array] = {}

    while lines:
        number, line = lines[0]
        keyword = line.split()[0]
        where = f"section {shown(keyword)}, line {number}"
        if keyword in tables or re.fullmatch(NUMBER, keyword):
            raise ValueError(
                f"{where}: a new keyword must stand there; is N of the section before too small?"
            )
        second = lines[1][1] if lines[1:] else ""
        header = HEADER.fullmatch(second)
        if header is None:
            raise ValueError(
                f"{where}: the line behind it must have N, perhaps R or RSQ with the ends of r, and FP or FPRIME, as "
                f"'N 500 R 0.8 2.5'; it is {shown(second)}"
            )
        n = int(header[1])
        columns = _columns(where, n, [row for _, row in lines[2 : 2 + n]])
        if header[2]:
            power = POWERS[header[2]]
            first, last = (float(end) ** power for end in header.group(3, 4))
            r = np.linspace(first, last, n) ** (1.0 / power)
            wrong = np.flatnonzero(~(np.abs(columns[0] - r) <= ROUNDED * np.gradient(r)))
            if wrong.size:
                k = wrong[0]
                raise ValueError(
                    f"{where}: r of row {k + 1} must be {r[k]:.6g}, by the line with N; it is {columns[0, k]:.6g}"
                )
            columns[0] = r
        columns[1:] *= ENERGIES[units]
        tables[keyword] = columns
        lines = lines[2 + n :]

    return tables


def _columns(where: str, n: int, rows: list[str]) -> Array:
    """The numbers of n rows without the first of each, (3, n)."""
    try:
        columns = np.loadtxt(rows or ["0"], ndmin=2)
        reason = f"there are {len(rows)} of {columns.shape[1]}"
        if columns.shape == (n, COLUMNS) and np.isfinite(columns).all():
            return columns.T[1:].copy()
    except ValueError as error:
        reason = str(error)
    raise ValueError(
        f"{where}: N = {n} needs as many rows of four finite numbers, number, r, u and force; {reason}"
    )
