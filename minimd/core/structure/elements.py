"""Chemical elements and masses of atoms that another program has read: what it states, and what their names tell.

A stated mass wins, then the mass of a stated element. Else the element is guessed from the names of atom and residue:

    ion       the residue is called as its atom, or ION: NA of NA is sodium, CA of CA calcium; SOD, CLA of CHARMM
    residue   of proteins, nucleic acids: the first letter, which is H, C, N, O, P or S: CA of ALA is carbon; of water:
              O, OW, OH2, OT are oxygen, H... hydrogen
    other     the first letters; MDAnalysis must not guess another element

Without all of these, and where a guess is absurd, atoms are refused: beads and massless sites have no element.
"""

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from ase.data import atomic_masses, atomic_numbers
from scipy.spatial import cKDTree

from minimd.core.console.quiet import warn
from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.checks import checked_number

ISOTOPES = {"D": 2.014, "T": 3.016}  # u
IONS = {
    "SOD": "Na",
    "CLA": "Cl",
    "POT": "K",
    "CAL": "Ca",
    "CES": "Cs",
    "LIT": "Li",
    "RUB": "Rb",
    "BAR": "Ba",
}
# symbols of one letter that ions have; W alone is a bead of water, not tungsten
SINGLE = ("K", "F", "I")
LETTERS = frozenset("HCNOPS")  # elements of proteins and nucleic acids; others are F, I, B, K
OXYGEN = ("O", "OW", "OH", "OT")  # letters of its names in water; OM is a massless site
SELENIUM = ("MSE", "SEC", "CSE")  # residues with SE
# symbols of two letters that other residues have
LONG = re.compile("CL|BR|SI|FE|ZN|MG|MN|CU|NI|CO|CR|RU|RH|SE|SN|PD|IR|AG|AU|PT|TI|AL|LI")
MOST_NAMES = 10_000  # that are remembered
TOLD = 12  # of the names that are guessed by the last rule
BEADS = 2.5  # Å; bonds of guessed elements are shorter
REMEDY = (
    "give masses={'NAME': mass} or elements={'NAME': 'symbol'}, or one for each atom, "
    "elements=['O', 'H', 'H', ...], in a scene under [structure], or a PSF or topology file beside it; "
    "atoms of ASE have set_masses; sites without mass must be removed"
)


class Stated(NamedTuple):
    """What is stated of N atoms; None where nothing is.

    source : the file or object, in words.
    names : (N,) of atoms.
    residues : (N,) names of residues; residue_of : (N,) their numbers, from 0 on.
    elements : (N,) chemical symbols, "" for atoms without.
    masses : (N,) [u], NaN for atoms without.
    positions : (N, 3) [Å].
    """

    source: str
    names: Sequence[str]
    positions: Array
    elements: Sequence[str] | None = None
    masses: Array | None = None
    residues: Sequence[str] | None = None
    residue_of: Indices | None = None


def is_element(symbol: str) -> bool:
    """Whether a text is the symbol of a chemical element."""
    return isinstance(symbol, str) and atomic_numbers.get(symbol, 0) > 0


def symbol_of(text: str) -> str:
    """The symbol in capitals or not, as a chemical symbol; "" if it is none."""
    symbol = text.capitalize()
    return symbol if is_element(symbol) or symbol in ISOTOPES else ""


def atomic_mass(element: str) -> float:
    """Mass of a chemical element [u]; D and T are isotopes of hydrogen.

    Raises
    ------
    ValueError : if it is not a chemical symbol.
    """
    if is_element(element):
        return float(atomic_masses[atomic_numbers[element]])
    if element not in (*ISOTOPES,):
        raise ValueError(
            f"element must be a chemical symbol, such as 'Ar'; element = {shown(element)}"
        )
    return ISOTOPES[element]


def identified(
    stated: Stated, masses: Any = None, elements: Any = None, *, is_reduced: bool = False
) -> tuple[Array, list[str]]:
    """Masses (N,) [u] and elements (N,) of atoms, "" for an atom with a mass, but without element.

    masses, elements : given by the user, which win: a sequence of N, or by names of atoms; or, as masses, what a second
        file states of the same atoms.
    is_reduced : masses that are not stated are 1, whatever the element.

    Warns of elements that are guessed.
    Raises ValueError for atoms that have neither mass nor element, for massless sites, and for names and lengths that
        do not fit.
    """
    n = len(stated.names)
    symbols = list(stated.elements or [""] * n)
    weights = np.full(n, np.nan)
    if stated.masses is not None:
        weights[:] = stated.masses

    for k, symbol in _by_atom("elements", elements, stated).items():
        atomic_mass(symbol)
        symbols[k] = symbol
        weights[k] = np.nan

    source = stated.source
    if isinstance(masses, Stated):
        source = masses.source
        if not is_reduced:
            weights = _of_both(weights, masses, stated)
    else:
        for k, mass in _by_atom("masses", masses, stated).items():
            weights[k] = checked_number("masses", mass, "positive and finite")

    massless = np.flatnonzero(weights == 0.0)
    if massless.size:
        raise ValueError(
            f"the mass of atom {massless[0]}, {stated.names[massless[0]]!r}, is 0 in {source}: it is a massless site, "
            "and the file does not tell which atoms it follows; remove it, and give Sites to System, or call water_of"
        )

    missing = np.flatnonzero(np.isnan(weights)).tolist()
    nameless = [k for k in missing if not symbols[k]]
    if nameless and not is_reduced:
        _guess(stated, nameless, symbols)
    for k in missing:
        weights[k] = 1.0 if is_reduced else atomic_mass(symbols[k])
    if stated.residues is not None and not is_reduced:  # elements of atoms whose masses are stated
        kinds = zip(stated.names, stated.residues, strict=True)
        for k, kind in enumerate(kinds):
            symbols[k] = symbols[k] or certain_element(*kind) or ""

    return weights, symbols


def _of_both(weights: Array, second: Stated, stated: Stated) -> Array:
    """Masses of two files: those of the second where it states them."""
    if len(second.names) != len(weights):
        raise ValueError(
            f"{second.source} has {len(second.names)} atoms; {stated.source} has {len(weights)}"
        )
    if second.masses is None:
        return weights
    return np.where(np.isnan(second.masses), weights, second.masses)


def species_of(symbols: Sequence[str], labels: Sequence[Any]) -> list[Any]:
    """Elements of atoms, and labels of those without."""
    return [symbol or label for symbol, label in zip(symbols, labels, strict=True)]


def check_names(stated: Stated) -> None:
    """Raise ValueError where the elements, which another program has made of names, are not those of the names, or
    stand as far apart as beads."""
    symbols = stated.elements or []
    kinds = zip(stated.names, stated.residues or [], strict=True)
    for k, (name, residue) in enumerate(kinds):
        symbol = symbols[k]
        expected = guessed_element(name, residue)
        is_known = expected or certain_element(name, residue) is not None
        if symbol != expected and is_known:
            raise ValueError(
                f"atom {k}, {name!r} of residue {residue!r}, of {stated.source} is {symbol or 'no element'}, but its "
                f"name tells {expected or 'no element'}; read the file with minimd.ase.system_from_file, or call "
                "atoms.set_masses"
            )
    _check_distance(stated, range(len(symbols)), symbols)


def _by_atom(name: str, values: Any, stated: Stated) -> dict[int, Any]:
    """What the user gives for atoms, by their indices."""
    labels = stated.names
    n = len(labels)
    if values is None:
        return {}
    if isinstance(values, Mapping):
        of_label = {str(label): value for label, value in values.items()}
        known = set(labels)

        for label in of_label:
            if label not in known:
                raise ValueError(
                    f"{name} names {label!r}, but the atoms of {stated.source} are called "
                    f"{', '.join(sorted(known)[:8])}"
                )

        return {k: of_label[label] for k, label in enumerate(labels) if label in of_label}

    array = np.asarray(values)
    if array.shape not in ((), (n,)):
        raise ValueError(
            f"{name} must be one for each of the {n} atoms of {stated.source}, or by their names; "
            f"{name} = {shown(values)}"
        )

    return dict(enumerate(np.broadcast_to(array, n).tolist()))


def _guess(stated: Stated, atoms: Sequence[int], symbols: list[str]) -> None:
    """Fill the symbols of atoms by their names.
    Raises and warns as identified."""
    residues = stated.residues or [""] * len(symbols)
    known: dict[tuple[str, str], str] = {}

    for k in atoms:
        name = stated.names[k]
        residue = residues[k]
        symbols[k] = known[name, residue] = guessed_element(name, residue)
        if not symbols[k]:
            of_residue = f" of residue {residue!r}" if residue else ""
            raise ValueError(
                f"{stated.source} states neither mass nor element of atom {k}, {name!r}{of_residue}, and its name "
                f"does not tell them; {REMEDY}"
            )

    _check_distance(stated, atoms, symbols)
    first = atoms[0]
    others = []
    for (name, residue), symbol in known.items():
        if residue and certain_element(name, residue) is None:
            others.append(f"{name} of {residue} is {symbol}")
    in_others = f"; in residues that are not known, {', '.join(others[:TOLD])}" if others else ""
    warn(
        f"{stated.source} states no elements: they, and with them masses, are guessed from the names of atoms and "
        f"residues; atom {first}, {stated.names[first]!r}, is {symbols[first]}{in_others}; if this is wrong, {REMEDY}"
    )


def _check_distance(stated: Stated, atoms: Sequence[int], symbols: Sequence[str]) -> None:
    """Raise ValueError for residues of one name whose atoms, other than metals, stand as far from the nearest as beads,
    by their median."""
    if stated.residue_of is None or stated.residues is None:
        return
    is_shared = np.bincount(stated.residue_of)[stated.residue_of] > 1
    of_name: dict[str, list[int]] = {}
    for k in atoms:
        if is_shared[k] and symbols[k] in LETTERS:
            of_name.setdefault(stated.residues[k], []).append(k)
    tree = cKDTree(stated.positions)

    for residue, members in of_name.items():
        nearest = tree.query(stated.positions[members], k=2)[0][:, 1]
        apart = np.median(nearest)
        if apart > BEADS:
            first = members[0]
            raise ValueError(
                f"atoms of residues {residue!r} of {stated.source} stand {apart:.3g} Å from the nearest, as beads do, "
                f"so that atom {first}, {stated.names[first]!r}, is not {symbols[first]}, as its name says; {REMEDY}"
            )


@lru_cache(MOST_NAMES)
def guessed_element(name: str, residue: str = "") -> str:
    """The element of an atom by its name and that of its residue, by the rules above; "" if they do not tell."""
    certain = certain_element(name, residue)
    if certain is not None:
        return certain
    from MDAnalysis.guesser.default_guesser import DefaultGuesser

    letters = _letters(name)
    long = letters[:2].capitalize()
    is_whole = not residue and is_element(letters.capitalize())
    is_long = is_whole or name[:2] == long or LONG.match(letters)
    symbol = long if is_long and is_element(long) else letters[:1]
    other = str(DefaultGuesser(None).guess_atom_element(name)).capitalize()
    is_usual = len(symbol) == 2 or symbol in (*LETTERS, *SINGLE, "B")
    return symbol if is_usual and (symbol == other or not is_element(other)) else ""


@lru_cache(MOST_NAMES)
def certain_element(name: str, residue: str) -> str | None:
    """The element of an ion, or of an atom in a residue of proteins, nucleic acids or water; "" if it has none there,
    None for other atoms."""
    from MDAnalysis.core.selection import NucleicSelection, ProteinSelection, WaterSelection

    letters = _letters(name)
    ion = IONS.get(letters, letters.capitalize())
    may_be_ion = is_element(ion) and (len(ion) == 2 or ion in SINGLE)
    if may_be_ion and _letters(residue) in (letters, "ION", "IONS"):
        return ion
    if residue in SELENIUM and letters == "SE":
        return "Se"
    if residue in WaterSelection.water_res:
        return letters[:1] if letters in OXYGEN or letters[:1] == "H" else ""
    if residue in ProteinSelection.prot_res or residue in NucleicSelection.nucl_res:
        return letters[:1] if letters[:1] in LETTERS else ""
    return None


def _letters(name: str) -> str:
    return re.sub(r"[^A-Za-z]", "", name).upper()
