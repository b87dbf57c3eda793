"""Tables of embedded atoms in the files that LAMMPS reads: funcfl (eam), setfl (eam/alloy), and that of eam/fs.

    setfl       three lines of comment; number and names of elements; nρ Δρ nr Δr r_c; for each element a line (atomic
                number, mass, lattice constant, lattice), nρ values of F and nr of g; nr values of r φ for each pair of
                elements, (1, 1), (2, 1), (2, 2), (3, 1) …
    eam/fs      the same, but with as many g for each element as there are: at atoms of the first, of the second …
    funcfl      a line of comment; the line of the element; nρ Δρ nr Δr r_c; F, Z and g, r φ = 27.2 · 0.529 Z²

Energies are in eV, lengths in Å. A file of one element is the same in the first two.
"""

import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from minimd.core.console.words import shown
from minimd.core.potentials.splines import FEWEST_POINTS
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_path

COMMENTS = 3  # lines of a setfl file
ELEMENT = re.compile(r"(?!NULL)[A-Za-z][\w+-]*")  # LAMMPS gets it
OF_ELEMENT = 4  # words: atomic number, mass, lattice constant, lattice
HARTREE_BOHR = 27.2 * 0.529  # eV Å, the factors of LAMMPS for effective charges
# by how much the cutoff may be beyond the last distance, relative to it: tables end there, or one step before
BEYOND = 0.01


@dataclass(frozen=True, eq=False, repr=False)
class EmbeddedTables:
    """The functions of a file, at ρ = 0, Δρ, 2Δρ … and r = 0, Δr, 2Δr …

    file : its name.
    elements : names.
    masses : (S,) [u].
    drho, dr : steps [density], [Å].
    cutoff : [Å].
    embedding : (S, nρ) F [eV].
    density : (S, S, nr) that an atom of the first element gives to one of the second.
    pair : (S, S, nr) r φ [eV Å], symmetric.
    """

    file: str
    elements: tuple[str, ...]
    masses: Array
    drho: float
    dr: float
    cutoff: float
    embedding: Array
    density: Array
    pair: Array

    def __repr__(self) -> str:
        return f"<tables of {', '.join(self.elements)} in {self.file!r}>"

    @property
    def is_symmetric(self) -> bool:
        """Whether two atoms give each other the same density."""
        return bool((self.density == self.density.swapaxes(0, 1)).all())

    @property
    def is_same_for_all(self) -> bool:
        """Whether the density that an atom gives depends on its own element only, as in setfl."""
        return bool((self.density == self.density[:, :1]).all())

    def as_text(self) -> str:
        """The tables as a file for eam/alloy if is_same_for_all, else for eam/fs, with all digits."""
        n = len(self.elements)
        n_rho, n_r = self.embedding.shape[1], self.pair.shape[-1]
        lines = [
            "tables of embedded atoms",
            repr(self.file),
            "written by minimd",
            f"{n} {' '.join(self.elements)}",
        ]
        lines.append(f"{n_rho} {self.drho!r} {n_r} {self.dr!r} {self.cutoff!r}")

        for a in range(n):
            lines.append(f"0 {float(self.masses[a])!r} 0 none")
            densities = self.density[a, : 1 if self.is_same_for_all else n]
            lines += _in_lines([self.embedding[a], *densities])
        functions = [self.pair[a, b] for a in range(n) for b in range(a + 1)]
        return "\n".join([*lines, *_in_lines(functions), ""])

    def pairs(self) -> Iterator[tuple[str, str, tuple[Array, Array]]]:
        """For each pair of elements, in both orders: the density at the first from the second, and r φ."""
        for a, first in enumerate(self.elements):
            for b, second in enumerate(self.elements):
                yield first, second, (self.density[b, a], self.pair[a, b])


class Header(NamedTuple):
    """nρ, Δρ, nr, Δr and r_c of a file."""

    n_rho: int
    drho: float
    n_r: int
    dr: float
    cutoff: float


def read_tables(file: str | os.PathLike[str]) -> EmbeddedTables:
    """The tables in a file of one of the three formats.
    Raises OSError for a file that cannot be read; ValueError for one that holds something else."""
    tables: EmbeddedTables = read_as(file, tables_from)
    return tables


def read_as(file: str | os.PathLike[str], reader: Callable[..., Any]) -> Any:
    """What a reader makes of the name and the text of a file.
    Raises OSError for a file that cannot be read; ValueError, with its path, as the reader."""
    path = checked_path("file", file)
    if path.exists() and not path.is_file():
        raise ValueError(f"file {str(path)!r} is not a regular file")
    try:
        return reader(path.name, path.read_text(encoding="utf-8-sig", errors="replace"))
    except ValueError as error:
        raise ValueError(f"file {str(path)!r}: {error}") from None


def tables_from(name: str, text: str) -> EmbeddedTables:
    """The tables in the text of such a file.
    Raises ValueError for one that holds something else."""
    lines = text.replace("\r\n", "\n").split("\n")
    return _setfl(name, lines) if _is_setfl(lines) else _funcfl(name, lines)


def _in_lines(functions: Iterable[Array]) -> list[str]:
    return ["\n".join(map(repr, function.tolist())) for function in functions]


def _is_setfl(lines: list[str]) -> bool:
    """Whether the fourth line is a number and as many names."""
    words = lines[COMMENTS].split() if len(lines) > COMMENTS else []
    return bool(words) and words[0].isdecimal() and len(words) == 1 + int(words[0]) > 1


def _header(line: str, where: str) -> Header:
    words = line.split()
    try:
        numbers = [_number(word) for word in words]
        n_rho, drho, n_r, dr, cutoff = numbers
        if not np.isfinite([*numbers, 1.0 / drho, 1.0 / dr]).all():
            raise ValueError
    except (ValueError, ZeroDivisionError):
        raise ValueError(
            f"{where} must be five finite numbers, nrho drho nr dr cutoff, of a table of embedded atoms "
            f"(funcfl, setfl, eam.fs); it is {shown(line)}"
        ) from None
    header = Header(int(n_rho), drho, int(n_r), dr, cutoff)
    is_whole = header.n_rho == n_rho and header.n_r == n_r
    if not (is_whole and min(n_rho, n_r) >= FEWEST_POINTS):
        raise ValueError(
            f"nrho and nr must be {FEWEST_POINTS} or more; they are {n_rho:g}, {n_r:g}"
        )
    if not (drho > 0.0 and dr > 0.0 and 0.0 < cutoff <= n_r * dr * (1.0 + BEYOND)):
        raise ValueError(
            "drho, dr and the cutoff must be positive, and the table of nr distances must reach to the cutoff; "
            f"they are {drho:g}, {dr:g}, {cutoff:g}, nr = {n_r:g}"
        )
    return header


def _number(word: str) -> float:
    """A number, also of Fortran."""
    return float(word.replace("D", "E").replace("d", "e"))


class Words:
    """The words of a file behind its header, taken one after the other."""

    def __init__(self, lines: list[str]) -> None:
        self.words = " ".join(lines).split()
        self._at = 0

    def element(self) -> list[str]:
        """Atomic number, mass, lattice constant, lattice."""
        self._at += OF_ELEMENT
        return self.words[self._at - OF_ELEMENT : self._at]

    def numbers(self, what: str, *shape: int) -> Array:
        """The next numbers, all finite."""
        size = int(np.prod(shape))
        words = self.words[self._at : self._at + size]
        self._at += size
        values = np.empty(size)
        for k, word in enumerate(words):
            try:
                values[k] = _number(word)
            except ValueError:
                values[k] = np.nan
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size:
            k = wrong[0]
            raise ValueError(f"{what} must be finite numbers; number {k + 1} is {shown(words[k])}")
        return values.reshape(shape)


def _setfl(name: str, lines: list[str]) -> EmbeddedTables:
    elements = tuple(lines[COMMENTS].split()[1:])
    n = len(elements)
    if len({*elements}) < n or not all(map(ELEMENT.fullmatch, elements)):
        raise ValueError(
            f"elements must be different, and names of letters and digits; they are {shown(' '.join(elements))}"
        )
    header = _header(lines[COMMENTS + 1] if len(lines) > COMMENTS + 1 else "", "the fifth line")
    n_rho, _, n_r, _, _ = header
    words = Words(lines[COMMENTS + 2 :])
    rest = n * (OF_ELEMENT + n_rho) + n * (n + 1) // 2 * n_r
    n_densities = {rest + n * n_r: 1, rest + n * n * n_r: n}.get(len(words.words))
    if n_densities is None:
        raise ValueError(
            f"{n} elements with nrho = {n_rho}, nr = {n_r} need {rest + n * n_r} numbers and words (eam/alloy), or "
            f"{rest + n * n * n_r} (eam/fs), behind the fifth line; there are {len(words.words)}"
        )

    masses = []
    embedding = []
    density = np.empty((n, n, n_r))
    pair = np.empty((n, n, n_r))

    for a, element in enumerate(elements):
        masses.append(_mass(words.element(), element))
        embedding.append(words.numbers(f"F of {element}", n_rho))
        density[a] = words.numbers(f"the density of {element}", n_densities, n_r)

    for a in range(n):
        for b in range(a + 1):
            what = f"r phi of {elements[a]} and {elements[b]}"
            pair[a, b] = pair[b, a] = words.numbers(what, n_r)

    tables = np.array(embedding), density, pair
    return EmbeddedTables(
        name, elements, np.array(masses), header.drho, header.dr, header.cutoff, *tables
    )


def _funcfl(name: str, lines: list[str]) -> EmbeddedTables:
    from ase.data import chemical_symbols

    header = _header(lines[2] if len(lines) > 2 else "", "the third line, or in setfl the fifth,")
    of_element = lines[1].split()
    if not (len(of_element) == OF_ELEMENT and of_element[0].isdecimal()):
        raise ValueError(
            f"the second line must begin with an atomic number; it is {shown(lines[1])}"
        )
    number = of_element[0]
    element = chemical_symbols[int(number)] if int(number) < len(chemical_symbols) else number
    n_rho, _, n_r, _, _ = header
    words = Words(lines[3:])
    if len(words.words) != n_rho + 2 * n_r:
        raise ValueError(
            f"nrho = {n_rho}, nr = {n_r} need {n_rho + 2 * n_r} numbers behind the third line; there are "
            f"{len(words.words)}"
        )

    embedding = words.numbers("F", 1, n_rho)
    charge = words.numbers("Z", 1, 1, n_r)
    density = words.numbers("the density", 1, 1, n_r)
    masses = np.array([_mass(of_element, element)])
    # LAMMPS leaves out the last point of each
    functions = embedding[..., :-1], density[..., :-1], HARTREE_BOHR * charge[..., :-1] ** 2
    return EmbeddedTables(
        name, (element,), masses, header.drho, header.dr, header.cutoff, *functions
    )


def _mass(words: list[str], element: str) -> float:
    try:
        mass = _number(words[1])
    except ValueError:
        mass = 0.0
    if not 0.0 < mass < np.inf:
        raise ValueError(
            f"the line of {element} must be its atomic number, mass, lattice constant and lattice; it is "
            f"{' '.join(words)}"
        )
    return mass
