"""The properties of the atoms of a system as attributes of an MDAnalysis universe."""

from typing import TypeVar

import MDAnalysis
import numpy as np
from MDAnalysis.guesser.tables import SYMB2Z
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from minimd.structure.constraints import DistanceConstraints
from minimd.structure.system import System

U = TypeVar("U", bound=MDAnalysis.Universe)
MOLECULE = "MOL"  # resname of a molecule without a formula
MOST_COUNTS = 10**7  # of molecules times species


def bare_universe(kind: type[U], system: System) -> U:
    """A universe without a trajectory: masses, types, names, elements if labels are symbols, bonds, angles, dihedrals;
    each molecule is a residue.

    kind : its class.  Residues are numbered from 1, in the order of their first atoms;
        their names are chemical formulas, or "MOL".
    """
    labels, of_atoms = [str(label) for label in system.species], molecules(system)
    n_molecules = int(of_atoms.max()) + 1
    made = kind.empty(
        len(system),
        n_residues=n_molecules,
        atom_resindex=of_atoms,
        residue_segindex=np.zeros(n_molecules, int),
        trajectory=False,
    )
    made.add_TopologyAttr("masses", system.masses)
    made.add_TopologyAttr("types", labels)
    made.add_TopologyAttr("names", labels)
    if any(label in SYMB2Z for label in labels):
        made.add_TopologyAttr("elements", [label if label in SYMB2Z else "" for label in labels])
    made.add_TopologyAttr("resids", np.arange(1, n_molecules + 1))
    made.add_TopologyAttr("resnames", _formulas(system, of_atoms))
    made.add_TopologyAttr("segids", ["SYSTEM"])
    for name, groups in system.groups().items():
        if len(groups):
            made.add_TopologyAttr(name, [tuple(group) for group in groups.tolist()])
    return made


def molecules(system: System) -> NDArray[np.int64]:
    """(N,) number of the molecule of each atom, from 0;
    bonds and lengths held fixed connect the atoms of a molecule."""
    held = [one.pairs for one in system.constraints if isinstance(one, DistanceConstraints)]
    i, j = np.concatenate([system.bonds, *held]).T
    numbers = connected_components(
        coo_array((np.ones(len(i), bool), (i, j)), shape=(len(system), len(system))), directed=False
    )[1]
    _, first, inverse = np.unique(numbers, return_index=True, return_inverse=True)
    order = np.empty(len(first), np.int64)
    order[np.argsort(first)] = np.arange(len(first))
    return order[inverse]


def _formulas(system: System, of_atoms: NDArray[np.int64]) -> list[str]:
    """Name of each molecule."""
    names = [str(name) for name in system.species_names]
    n_molecules = int(of_atoms.max()) + 1
    if n_molecules * len(names) > MOST_COUNTS:
        return [MOLECULE] * n_molecules
    counts = np.zeros((n_molecules, len(names)), np.int64)
    np.add.at(counts, (of_atoms, system.species_index), 1)
    kinds, which = np.unique(counts, axis=0, return_inverse=True)
    formulas = [_formula(dict(zip(names, row.tolist(), strict=True))) for row in kinds]
    return [formulas[kind] for kind in which.ravel().tolist()]


def _formula(counts: dict[str, int]) -> str:
    """The formula in Hill's order: carbon, hydrogen, then the others by name; without carbon all elements,
    also hydrogen, by name."""
    present = {name: n for name, n in counts.items() if n}
    if len(present) == 1 and sum(present.values()) == 1:
        return next(iter(present))
    if not all(name in SYMB2Z for name in present):
        return MOLECULE
    first = ("C", "H") if "C" in present else ()
    ordered = sorted(present, key=lambda name: (first.index(name) if name in first else len(first), name))
    return "".join(name + (str(present[name]) if present[name] > 1 else "") for name in ordered)
