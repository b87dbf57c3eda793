"""The tables of pairs in a file for LAMMPS' pair_style table: sections of lines "number r u force".

    # comments, and empty lines, anywhere
    KEYWORD
    N 500 R 0.8 2.5             or RSQ, of equally spaced r²; without both, r is that of each line
    1 0.8 34.1 643.2

A tag UNITS in the first comment tells real from metal: energies in kcal/mol are returned in eV, as LAMMPS does.
"""

import os
import re
from math import isfinite
from typing import NamedTuple

import numpy as np

from minimd.core.console.words import listed, near, shown
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_path
from minimd.core.structure.units import KJ_PER_MOL_PER_EV

UNITS = re.compile(r"#.*\bUNITS:\s*(\S+)")
# by the tag UNITS: the energy of minimd's units, eV or ε
ENERGIES = {"metal": 1.0, "lj": 1.0, "real": 4.184 / KJ_PER_MOL_PER_EV}
SPACINGS = "R", "RSQ"
OF_ENDS = "FPRIME", "FP"  # slopes of the force at both ends, which splines of minimd do not need
COLUMNS = 4
# of the distance of two points: by how much r of a line may differ from that of the spacing, which is the one taken
ROUNDED = 0.1


class PairTable(NamedTuple):
    """A section of a file.
    r, u, force : (N,) [length], [energy], [energy/length]."""

    r: Array
    u: Array
    force: Array


class Line(NamedTuple):
    """A line that is neither empty nor a comment.
    number : in the file, from 1 on."""

    number: int
    words: list[str]


class Header(NamedTuple):
    """What the second line of a section says.
    spacing : a name of SPACINGS, or empty.  ends : the first and the last distance [length]."""

    n: int
    spacing: str
    ends: tuple[float, float]


def read_sections(file: str | os.PathLike[str]) -> dict[str, PairTable]:
    """The tables in a file, by keyword.
    Raises OSError for a file that cannot be read; ValueError for one that holds something else."""
    path = checked_path("file", file)
    if path.exists() and not path.is_file():
        raise ValueError(f"file {str(path)!r} is not a regular file")
    try:
        return sections_of(path.read_text(encoding="utf-8-sig", errors="replace"))
    except ValueError as error:
        raise ValueError(f"file {str(path)!r}: {error}") from None


def sections_of(text: str) -> dict[str, PairTable]:
    """The tables in the text of such a file, by keyword.
    Raises ValueError for one that holds something else."""
    tag = UNITS.match(text.partition("\n")[0])
    units = tag[1] if tag else "metal"
    if units not in ENERGIES:
        raise ValueError(f"UNITS must be one of {listed(ENERGIES)}; it is {shown(units)}")
    split = [line.partition("#")[0].split() for line in text.splitlines()]
    lines = [Line(number, words) for number, words in enumerate(split, start=1) if words]

    sections: dict[str, PairTable] = {}
    start = 0
    while start < len(lines):
        keyword = lines[start].words[0]
        where = f"section {shown(keyword)}, line {lines[start].number}"
        if len(lines[start].words) > 1 and all(map(_is_number, lines[start].words)):
            before = (
                f"section {shown([*sections][-1])} has more lines than its N"
                if sections
                else "there is none"
            )
            raise ValueError(
                f"line {lines[start].number} must be the keyword of a section; {before}"
            )
        if keyword in sections:
            raise ValueError(f"{where}: its keyword stands in the file twice")
        if start + 1 == len(lines):
            raise ValueError(f"{where}: the line with N is missing")
        header = _header(lines[start + 1])
        rows = lines[start + 2 : start + 2 + header.n]
        sections[keyword] = _table(where, header, rows, ENERGIES[units])
        start += 2 + header.n

    if not sections:
        raise ValueError(
            "it must have a section with a keyword, a line with N, and N lines; it is empty"
        )
    return sections


def section_named(sections: dict[str, PairTable], keyword: str | None) -> PairTable:
    """The table of a keyword; the only one for None.
    Raises ValueError if there is none."""
    if keyword is None and len(sections) == 1:
        return next(iter(sections.values()))
    if not isinstance(keyword, str) or keyword not in sections:
        hint = near(keyword, sections) if isinstance(keyword, str) else ""
        raise ValueError(
            f"keyword must be that of a section, {listed(sections)}; keyword = {shown(keyword)}{hint}"
        )
    return sections[keyword]


def _is_number(word: str) -> bool:
    try:
        return isfinite(float(word))
    except ValueError:
        return False


def _header(line: Line) -> Header:
    """What the line with N says.
    Raises ValueError for words that are not understood."""
    where = f"line {line.number}"
    words = iter(line.words)
    n = 0
    spacing = ""
    ends = (0.0, 0.0)
    for word in words:
        takes = 1 if word == "N" else 2
        numbers = [next(words, "") for _ in range(takes)]
        if word not in ("N", *SPACINGS, *OF_ENDS):
            known = listed(("N", *SPACINGS, *OF_ENDS))
            raise ValueError(
                f"{where} must have {known} with their numbers, as in 'N 500 R 0.8 2.5'; it has {shown(word)}"
            )
        if not all(map(_is_number, numbers)):
            raise ValueError(
                f"{where}: {word} needs {takes} finite numbers; they are {shown(numbers)}"
            )
        if word == "N":
            n = int(numbers[0]) if numbers[0].isdecimal() else 0
        elif word in SPACINGS:
            spacing = word
            ends = (float(numbers[0]), float(numbers[1]))
    if n < 2:
        raise ValueError(
            f"{where} must have N, a whole number of 2 or more lines; it is {shown(' '.join(line.words))}"
        )
    if spacing and not 0.0 <= ends[0] < ends[1]:
        raise ValueError(
            f"{where}: {spacing} needs two increasing distances; they are {ends[0]:g} and {ends[1]:g}"
        )
    return Header(n, spacing, ends)


def _table(where: str, header: Header, lines: list[Line], energy: float) -> PairTable:
    """The table of a section.
    energy : its unit.
    Raises ValueError for missing lines, for lines of another kind, and for distances that contradict the spacing."""
    rows = []
    for line in lines:
        if len(line.words) != COLUMNS or not all(map(_is_number, line.words)):
            raise ValueError(
                f"{where}: it needs N = {header.n} lines of {COLUMNS} finite numbers, number, r, u and force; line "
                f"{line.number} is {shown(' '.join(line.words))}"
            )
        rows.append([float(word) for word in line.words])
    if len(rows) < header.n:
        raise ValueError(f"{where}: N = {header.n}, and there are {len(rows)} lines")

    _, r, u, force = np.array(rows).T
    if header.spacing:
        power = SPACINGS.index(header.spacing) + 1
        first, last = (end**power for end in header.ends)
        spaced = np.linspace(first, last, header.n) ** (1.0 / power)
        wrong = np.flatnonzero(np.abs(r - spaced) > ROUNDED * np.gradient(spaced))
        if wrong.size:
            k = wrong[0]
            raise ValueError(
                f"{where}: r must be that of {header.spacing} {header.ends[0]:g} {header.ends[1]:g}, "
                f"{spaced[k]:.6g}; line {lines[k].number} has {r[k]:.6g}"
            )
        r = spaced
    return PairTable(r, energy * u, energy * force)
