"""What a LAMMPS data file states, in the file's own units.

The layout is that of LAMMPS' command read_data: a title; a header, whose lines are numbers and a keyword; sections,
whose lines are words. "#" begins a comment. Whatever is wrong is told with the number of its line.
"""

import re
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from minimd.core.console.whole_file import text_of
from minimd.core.console.words import listed, shown
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import GROUPS
from minimd.core.structure.checks import LARGEST, SMALLEST, checked_choice
from minimd.core.structure.lammps_units import LAMMPS_UNITS

READ = ("atomic", "charge", "bond", "angle", "molecular", "full")
# the words of a line of Atoms in each atom style of LAMMPS, each with a letter of RULES; "?" for other layouts
LAYOUTS = dict(
    row.split()
    for row in """
    atomic        itxyz
    charge        itqxyz
    dpd           itnxyz
    mdpd          itnxyz
    bond          imtxyz
    angle         imtxyz
    molecular     imtxyz
    full          imtqxyz
    sphere        itnpxyz
    ellipsoid     itwpxyz
    body          itwpxyz
    edpd          itppxyz
    peri          itppxyz
    bpm/sphere    imtnpxyz
    line          imtwpxyz
    tri           imtwpxyz
    electron      itqwnxyz
    sph           itnqqxyz
    amoeba        ?
    apip          ?
    dielectric    ?
    dipole        ?
    granular      ?
    hybrid        ?
    oxdna         ?
    rheo          ?
    rheo/thermal  ?
    smd           ?
    spin          ?
    tdpd          ?
    template      ?
    wavepacket    ?""".strip().splitlines()
)
FLAGS = "www"  # numbers of images, which may follow in each style
# what the word of a letter stands for, what makes a value of it, and the least and the largest value; others are NUMBER
Rule = tuple[str, Callable[[str], Any], Any, Any]
WHOLE = 2**53
NUMBER: Rule = ("number", float, -LARGEST, LARGEST)
RULES: dict[str, Rule] = {
    "i": ("atom id", int, 1, WHOLE),
    "m": ("molecule id", int, 0, WHOLE),
    "w": ("whole number", int, -WHOLE, WHOLE),
    "n": ("number of at least 0", float, 0, LARGEST),
    "p": ("positive number", float, SMALLEST, LARGEST),
    "l": ("label that begins with a letter", str, "A", "~"),
}
BOUNDS = ("xlo xhi", "ylo yhi", "zlo zhi")
EDGES = ("avec", "bvec", "cvec")  # in place of bounds
# numbers; others have one
HEADER = dict.fromkeys(BOUNDS, 2) | dict.fromkeys((*EDGES, "abc origin", "xy xz yz"), 3)
KNOWN = re.compile(
    "Atoms|Velocities|Masses|Bonds|Angles|Dihedrals|Impropers|.* Coeffs|.* Type Labels"
)
BOUNDARY = re.compile(r"\bboundary((?:\s+[pfsm]{1,2}){3})\b")


class LammpsData(NamedTuple):
    """What a data file states. Atoms are in the order of their ids; what it does not state is None.

    positions : (N, 3) [length], in the images that the file names.
    types : (N,) their labels, or numbers as text.
    cell : (3, 3) [length], rows; its origin is not kept.
    groups : bonds, angles, dihedrals, impropers, (n, 2), (n, 3) or (n, 4) int, from 0 on, by these names.
    n_types : of these, how many types occur, where more than one.
    masses, charges : (N,).
    velocities : (N, 3).
    units : LAMMPS' word.
    pbc : three bools.
    skipped : names of sections that LAMMPS itself does not have.
    """

    positions: Array
    types: list[str]
    cell: Array
    groups: dict[str, Indices]
    n_types: dict[str, int]
    masses: Array | None
    charges: Array | None
    velocities: Array | None
    units: str | None
    pbc: tuple[bool, ...] | None
    skipped: list[str]


class DataFile:
    """The words of a data file, and what they mean.

    title : the first line.
    header : numbers by keyword, zeros for what is not there.
    sections : by name, the words of each line by its number, from the words behind that name on.
    labels : number of a type by its label, by kind.
    places : of atoms by their ids.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.title, *lines = text_of(path).split("\n")
        self.header: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])
        self.sections: dict[str, dict[int, list[str]]] = defaultdict(lambda: {1: []})
        self.labels: dict[str, dict[str, int]] = defaultdict(dict)
        self.places: dict[int, int] = {}
        section = None

        for place, line in enumerate(lines, start=2):
            content, _, comment = line.partition("#")
            words = content.split()
            if not words:
                continue
            if all(word[0].isalpha() for word in words):
                section = self.sections.setdefault(" ".join(words), {place: comment.split()})
            elif section is not None:
                section[place] = words
            else:
                numbers = [word for word in words if not word[0].isalpha()]
                keyword = " ".join(words[len(numbers) :])
                self.header[keyword] = values_of(numbers, [NUMBER] * HEADER.get(keyword, 1))
                if not self.header[keyword]:
                    raise self.fault(
                        place,
                        "a line of the header must be numbers and a keyword, such as '0.0 10.0 xlo xhi'; "
                        f"it is {shown(line.strip())}",
                    )

        for title, lines_of_labels in self.sections.items():
            if title.endswith(" Type Labels"):
                kind = title.split()[0].lower()
                rows = self.rows(title, f"{kind} types", "tl", kind)
                self.labels[kind] = {label: number for number, label in rows}
                if len(self.labels[kind]) != len(rows):
                    raise self.fault(next(iter(lines_of_labels)), "labels of types must differ")

    def fault(self, place: int, reason: str) -> ValueError:
        """The error for a line."""
        return ValueError(f"file {str(self.path)!r}, line {place}: {reason}")

    def rules(self, layout: str, kind: str) -> list[Rule]:
        """Those of the letters of a layout.
        kind : of what the types, "t", are: atom, bond, ..."""
        n_types = self.header[f"{kind} types"][0]
        labels = self.labels[kind]
        types: Rule = (
            f"one of {n_types:.0f} {kind} types",
            lambda word: labels.get(word) or int(word),
            1,
            n_types,
        )
        atoms: Rule = ("id of an atom", lambda word: self.places[int(word)], 0, WHOLE)
        rules = RULES | {"t": types, "a": atoms}
        return [rules.get(letter, NUMBER) for letter in layout]

    def rows(self, title: str, keyword: str, layout: str, kind: str = "") -> list[list[Any]]:
        """The values of the lines of a section, as many as the header states of a keyword. If the first is that of an
        atom or a type, only one line has it, and the rows are in its order."""
        (place, _), *lines = self.sections[title].items()
        expected = self.header[keyword][0]
        if len(lines) != expected:
            raise self.fault(
                place,
                f"section {title} must have a line for each of the {expected:.0f} {keyword} of the header; "
                f"it has {len(lines)}",
            )

        rules = self.rules(layout, kind)
        is_ordered = layout[0] != "w"
        rows = {}

        for place, words in lines:
            row = values_of(words, rules)
            key = row[0] if row and is_ordered else place
            if not row or key in rows:
                names = ", ".join(name for name, *_ in rules)
                once = ", the first in one line only" * is_ordered
                line = shown(" ".join(words))
                raise self.fault(place, f"a line of {title} must be {names}{once}; it is {line}")

            rows[key] = row

        return [row for _, row in sorted(rows.items())]

    def cell(self) -> Array:
        """The vectors of the cell (3, 3) [length]."""
        cell = np.array([self.header[keyword] for keyword in EDGES])
        sizes = [np.linalg.det(cell)]
        if not cell.any():
            low, high = np.array([self.header[keyword][:2] for keyword in BOUNDS]).T
            sizes = high - low
            cell = np.diag(sizes)
            cell[[1, 2, 2], [0, 0, 1]] = self.header["xy xz yz"]
        if min(sizes) <= 0.0:
            raise self.fault(
                1,
                f"the header must have {', '.join(BOUNDS)}, or {', '.join(EDGES)}, of a right-handed cell; "
                f"the vectors are {cell.tolist()}",
            )
        return cell

    def layout(self, atom_style: str | None) -> str:
        """That of Atoms, by the word behind the title, the atom style, or the only one that fits the lines."""
        (place, comment), *lines = self.sections["Atoms"].items()
        if not lines:
            raise self.fault(
                place, "a file must have a section Atoms with lines; this one has none"
            )

        named = [
            word.removesuffix("/kk") for word in comment if len(comment) == 1 or word == "hybrid"
        ]
        styles = [style for style in (*named, atom_style) if style in LAYOUTS]
        for flags in (FLAGS, ""):
            if not styles:
                styles = [style for style, layout in LAYOUTS.items() if self.fits(layout + flags)]
        layouts = {LAYOUTS[style] for style in styles}
        if len(layouts) != 1 or styles[0] not in READ:
            raise self.fault(
                place,
                f"the atom style must be certain, and one of {listed(READ)}; it is {listed(styles) or None}: "
                'name it as atom_style="full", in a scene under [structure], or let LAMMPS write another style',
            )

        (layout,) = layouts
        _, first = lines[0]
        return layout + FLAGS * (len(first) > len(layout))

    def fits(self, layout: str) -> bool:
        """Whether all lines of Atoms can be of a layout; there are no bonds without molecules."""
        _, *lines = self.sections["Atoms"].values()
        rules = self.rules(layout, "atom")
        may_have_bonds = "m" in layout or not self.header["bonds"][0]
        return may_have_bonds and all(values_of(words, rules) for words in lines)


def values_of(words: list[str], rules: list[Rule]) -> list[Any]:
    """What rules make of the words of a line; nothing if a word breaks its rule, or there are more or fewer words."""
    row = []
    try:
        for word, (_, read, least, most) in zip(words, rules, strict=True):
            value = read(word)
            if not least <= value <= most:
                return []
            row.append(value)
    except (KeyError, ValueError):
        return []
    return row


def read_lammps_data(path: str | Path, atom_style: str | None = None) -> LammpsData:
    """What a LAMMPS data file states.

    atom_style : one of READ, with which LAMMPS wrote it, where the file does not tell it: the word behind "Atoms #"
        does, and so do lines that fit no other style of LAMMPS.

    Raises
    ------
    ValueError : with the number of the line, if the file is not as LAMMPS' read_data expects it, or its style is not
        read.
    OSError : if it cannot be read.
    """
    if atom_style is not None:
        checked_choice("atom_style", atom_style, READ)
    file = DataFile(Path(path))
    cell = file.cell()
    layout = file.layout(atom_style)
    table = np.array(file.rows("Atoms", "atoms", layout, "atom"))
    column = dict(zip(layout, table.T, strict=True))
    file.places = {number: k for k, number in enumerate(column["i"].tolist())}
    kinds = column["t"].astype(np.int64)
    x = layout.index("x")
    positions = table[:, x : x + 3]
    if layout.endswith(FLAGS):
        positions = positions + table[:, -3:] @ cell
    groups = {}
    n_types = {}

    for name, size in GROUPS.items():
        rows = file.rows(name.capitalize(), name, "wt" + size * "a", name[:-1])
        groups[name] = np.array([row[2:] for row in rows], np.int64).reshape(-1, size)
        n = len({row[1] for row in rows})
        if n > 1:
            n_types[name] = n

    masses = None
    if "Masses" in file.sections:
        masses = np.array(file.rows("Masses", "atom types", "tp", "atom"))[kinds - 1, 1]
    velocities = None
    if "Velocities" in file.sections:
        velocities = np.array(file.rows("Velocities", "atoms", "aqqq"))[:, 1:]
    names = {number: label for label, number in file.labels["atom"].items()}
    units = LAMMPS_UNITS.search(file.title)
    boundary = BOUNDARY.search(file.title)
    return LammpsData(
        positions=positions,
        types=[names.get(kind, str(kind)) for kind in kinds.tolist()],
        cell=cell,
        groups=groups,
        n_types=n_types,
        masses=masses,
        charges=column.get("q"),
        velocities=velocities,
        units=units and units[1],
        pbc=boundary and tuple("p" in word for word in boundary[1].split()),
        skipped=[title for title in file.sections if not KNOWN.fullmatch(title)],
    )
