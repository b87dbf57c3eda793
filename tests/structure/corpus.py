"""Files that nobody here wrote, through the door for structure files: what comes in must be what they state.

    python tests/structure/corpus.py [FOLDER ...]       without folders: the files of the package MDAnalysisTests

Each file is read once more by lines of this script, or by a program that is right for its format. A verdict is

    right               masses, positions, cell, bonds and velocities are those of the other reading
    right, told         the same, and what the file does not state was guessed and told
    refused             with one sentence
    refused, reader     with one sentence, which is that of the reader: such files are broken
    REFUSED BADLY       by another exception, or in several lines
    WRONG               what came in differs, and was not told

Prints a line for each file that is not right, and a table of counts."""

import sys
import warnings
from collections import Counter
from pathlib import Path
from unittest import mock

import ase.io
import MDAnalysis
import numpy as np
from ase.data import atomic_masses, atomic_numbers
from MDAnalysis.lib.util import openany

import minimd as md
from minimd.ase import system_from_file
from minimd.core.files import structure_file

FORMATS = ("gro", "pdb", "ent", "cif", "mmcif", "xyz", "extxyz", "mol2", "gsd", "pqr", "pdbqt", "crd", "dms", "txyz",
           "mmtf", "data", "lmp", "lammpstrj", "dump")  # fmt: skip
MASS = 0.05  # u, by which tables of masses differ
PLACE = 2e-3  # Å
TOLD = ("guessed from the names", "is taken for velocities")


def form_of(path):
    name = path.name.lower().removesuffix(".gz").removesuffix(".bz2")
    return name.rpartition(".")[2]


def lines_of(path):
    with openany(str(path)) as file:
        return file.read().splitlines()


def standard(symbol):
    """Mass of an element, NaN if the text is none."""
    number = atomic_numbers.get(symbol.strip().capitalize(), 0)
    return float(atomic_masses[number]) if number else np.nan


def of_pdb(path):
    """The last model, by columns."""
    lines = lines_of(path)
    first = max([k for k, line in enumerate(lines) if line.startswith("MODEL ")], default=0)
    atoms = [line for line in lines[first:] if line.startswith(("ATOM  ", "HETATM"))]
    cells = [line for line in lines if line.startswith("CRYST1")]
    edges = np.array([float(cells[-1][k : k + 9]) for k in (6, 15, 24)]) if cells else np.zeros(3)
    return {
        "positions": np.array([[float(line[k : k + 8]) for k in (30, 38, 46)] for line in atoms]),
        "masses": np.array([standard(line[76:78]) for line in atoms]),
        "edges": edges * (not np.allclose(edges, 1.0)),
    }


def of_gro(path):
    """The last frame, by columns, whose width the distance of the points tells."""
    lines = lines_of(path)
    first, n = 0, int(lines[1])
    while first + n + 4 < len(lines) and lines[first + n + 4].strip():
        first += n + 3
        n = int(lines[first + 1])
    rows = lines[first + 2 : first + 2 + n]
    width = rows[0].index(".", rows[0].index(".") + 1) - rows[0].index(".")
    numbers = [[float(row[20 + width * k : 20 + width * (k + 1)]) for k in range(3)] for row in rows]
    box = [float(word) for word in lines[first + 2 + n].split()]
    vectors = np.diag(box[:3]) if len(box) > 2 else np.full((3, 3), np.nan)
    if len(box) == 9:
        vectors[[0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]] = box[3:]
    edges = np.linalg.norm(vectors, axis=1)
    answer = {"positions": 10.0 * np.array(numbers), "masses": np.full(n, np.nan), "edges": 10.0 * edges}
    speeds = [[row[20 + width * (3 + k) : 20 + width * (4 + k)] for k in range(3)] for row in rows]
    if all(all(map(str.strip, row)) for row in speeds):
        answer["velocities"] = 10.0 * np.array(speeds, dtype=float)
    return answer


def of_ase(path):
    """By ASE, whose symbols these formats state."""
    atoms = ase.io.read(str(path), do_not_split_by_at_sign=True)
    edges = np.where(atoms.pbc, atoms.cell.lengths(), 0.0)
    return {"positions": atoms.positions, "masses": atoms.get_masses(), "edges": edges}


def of_mdanalysis(path):
    """By MDAnalysis, whose masses these formats state if they are not guessed."""
    universe = MDAnalysis.Universe(str(path))
    universe.trajectory[-1]
    masses = np.full(len(universe.atoms), np.nan)
    if not universe._topology.masses.is_guessed:
        masses = universe.atoms.masses
    elif hasattr(universe.atoms, "elements"):
        masses = np.array([standard(symbol) for symbol in universe.atoms.elements])
    edges = np.zeros(3) if universe.dimensions is None else universe.dimensions[:3].astype(float)
    answer = {"positions": universe.atoms.positions.astype(float), "edges": edges, "masses": masses}
    if universe.trajectory.ts.has_velocities:
        answer["velocities"] = universe.atoms.velocities
    if hasattr(universe, "bonds"):
        answer["n_bonds"] = len(universe.bonds)
    return answer


OTHERS = {"pdb": of_pdb, "ent": of_pdb, "gro": of_gro, "xyz": of_ase, "extxyz": of_ase}


def differences(path, system, told):
    """What differs from the other reading, in words."""
    other = OTHERS.get(form_of(path), of_mdanalysis)(path)
    if len(other["positions"]) != len(system):
        return [f"{len(system)} atoms, not {len(other['positions'])}"]
    words = []
    apart = other["positions"] - system.positions
    if system.cell.pbc.all():  # images, which MDAnalysis does not read
        shifts = apart @ np.linalg.inv(system.cell.vectors)
        apart = (shifts - np.rint(shifts)) @ system.cell.vectors
    if (apart := np.abs(apart).max()) > PLACE:
        words.append(f"positions differ by {apart:.3g} Å")
    stated = ~np.isnan(other["masses"])
    off = np.abs(other["masses"] - system.masses) > MASS
    if (stated & off).any():
        k = int(np.argmax(stated & off))
        words.append(f"mass of atom {k} is {system.masses[k]:g}, not {other['masses'][k]:g}")
    if not stated.all() and not told:
        words.append("masses that the file does not state were not told")
    edges = np.linalg.norm(system.cell.vectors, axis=1) * system.cell.pbc
    known = ~np.isnan(other["edges"])
    if not np.allclose(edges[known], other["edges"][known], rtol=1e-5, atol=2e-3):
        words.append(f"cell {edges}, not {other['edges']}")
    if "velocities" in other:
        found = system.velocities * md.units.ps
        if not np.allclose(found, other["velocities"], rtol=1e-5, atol=1e-4):
            words.append(f"velocities up to {found.max():.4g} Å/ps, not {np.max(other['velocities']):.4g}")
    if "n_bonds" in other and other["n_bonds"] != len(system.bonds):
        words.append(f"{len(system.bonds)} bonds, not {other['n_bonds']}")
    return words


def read(path):
    """The system of a file; a LAMMPS file that does not state its units is given real ones."""
    try:
        return system_from_file(path)
    except ValueError as error:
        if "does not state its units" not in str(error):
            raise
        return system_from_file(path, lammps_units="real")


def verdict(path):
    """The verdict on a file, and words about it."""
    with warnings.catch_warnings(record=True, action="always") as seen:
        try:
            system = read(path)
        except ValueError as error:
            words = str(error)
            if "\n" in words or str(path) not in words:
                return "REFUSED BADLY", words
            return "refused, reader" if "gives up with" in words else "refused", words
        except Exception as error:
            return "REFUSED BADLY", repr(error)
    told = any(words in str(one.message) for one in seen for words in TOLD)
    with warnings.catch_warnings(action="ignore"):
        try:
            words = differences(path, system, told)
        except Exception as error:
            return "no other reading", repr(error)
    return ("WRONG", "; ".join(words)) if words else ("right, told" if told else "right", "")


def judged(folders):
    """Counts of verdicts by format, and all that are not right."""
    files = [path for folder in folders for path in Path(folder).rglob("*") if form_of(path) in FORMATS]
    counts, told = {}, []
    for path in sorted(filter(Path.is_file, files)):
        with mock.patch.object(structure_file, "looked_at", lambda _, look: look()):  # nothing here is hostile
            kind, words = verdict(path)
        counts.setdefault(form_of(path), Counter())[kind] += 1
        if not kind.startswith("right"):
            told.append((kind, path.name, words))
    return counts, told


def main(folders):
    if not folders:
        import MDAnalysisTests

        folders = [Path(MDAnalysisTests.__file__).parent / "data"]
    counts, told = judged(folders)
    for kind, name, words in told:
        print(f"{kind:16s} {name:30s} {' '.join(words.split())[:240]}")
    kinds = sorted({kind for row in counts.values() for kind in row}, key=str.lower)
    print(f"\n{'format':10s}" + "".join(f"{kind:>18s}" for kind in kinds))
    for form, row in sorted(counts.items()):
        print(f"{form:10s}" + "".join(f"{row[kind]:18d}" for kind in kinds))
    total = sum(counts.values(), Counter())
    print(f"{'all':10s}" + "".join(f"{total[kind]:18d}" for kind in kinds), "of", sum(total.values()))
    return int(any(kind.isupper() for kind in kinds))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
