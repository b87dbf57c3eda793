"""Atoms of MDAnalysis as systems."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from MDAnalysis import AtomGroup, NoDataError, Universe
from MDAnalysis.guesser.default_guesser import DefaultGuesser
from MDAnalysis.lib.mdamath import triclinic_vectors
from MDAnalysis.lib.util import openany
from MDAnalysis.units import get_conversion_factor
from numpy.typing import ArrayLike

from minimd.core.console.quiet import quiet, warn
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.bond_graph import GROUPS
from minimd.core.structure.checks import checked_kind
from minimd.core.structure.elements import ISOTOPES, Stated, identified, symbol_of
from minimd.core.structure.lammps_units import LAMMPS_UNITS
from minimd.core.structure.units import UnitSystem


def universe_arguments(
    universe: Universe | AtomGroup,
    units: UnitSystem,
    groups: Mapping[str, ArrayLike | None],
    pbc: ArrayLike | None,
    source: str = "this universe",
    masses: Any = None,
    elements: Any = None,
) -> dict[str, Any]:
    """Arguments for System from a universe or a group of its atoms, as System.from_mdanalysis describes them.

    groups : bonds, angles, dihedrals and impropers by these names; None for those of the universe.
    The topology is None where names, numbers or chains of residues are missing, or a text is not ASCII.
    source : in words, for messages.
    masses, elements : given by the user, see elements.identified.

    Raises TypeError for anything else.  ValueError for atoms whose masses are neither stated nor known by their
    elements, where the units have no default, and for velocities in unknown units.
    """
    checked_kind("universe", universe, Universe | AtomGroup, "an MDAnalysis Universe or AtomGroup")
    checked_kind("units", units, UnitSystem, "minimd.units.LJ or minimd.units.ASE")
    atoms = universe.atoms
    trajectory = atoms.universe.trajectory
    length, speed = _scales(trajectory, units, source)
    positions = length * as_decimals(atoms.positions)
    stated = stated_of(atoms, source, positions)
    weights, symbols = identified(stated, masses, elements, is_reduced=units.is_reduced)
    topology = None
    with suppress(NoDataError, UnicodeEncodeError):
        texts = np.array([stated.names, symbols, atoms.resnames, atoms.resids, atoms.segids], "S")
        topology = texts.T.astype(str)
    velocities = None
    if trajectory.ts.has_velocities:
        velocities = speed * as_decimals(atoms.velocities)
    joined = {
        name: _within(atoms, name, GROUPS[name]) if rows is None else rows
        for name, rows in groups.items()
    }
    return {
        "positions": positions,
        "masses": weights,
        "charges": charges_of(atoms),
        "velocities": velocities,
        "cell": _cell(trajectory.ts.dimensions, length, source),
        "pbc": pbc,
        "species": _types_or_elements(atoms, symbols),
        **joined,
        "units": units,
        "topology": topology,
    }


def _scales(trajectory: Any, units: UnitSystem, source: str) -> tuple[float, float]:
    """Factors from the numbers of a trajectory to lengths and velocities in units; 1 for reduced units, in which
    numbers are those of the file.
    Raises ValueError for velocities of LAMMPS files that state neither real nor metal
    units."""
    native = trajectory.units
    length = native.get("length") or "Angstrom"
    time = native.get("time") or "ps"
    speed = native.get("velocity") or f"{length}/{time}"
    to_speed = get_conversion_factor("speed", speed, "Angstrom/ps")
    is_converted = getattr(trajectory, "convert_units", False)
    is_lammps = trajectory.format in ("DATA", "LAMMPSDUMP")
    if units.is_reduced:
        return 1.0, 1.0 / to_speed if is_converted and is_lammps else 1.0
    scale = 1.0 if is_converted else to_speed
    if is_lammps and trajectory.ts.has_velocities:
        with openany(trajectory.filename) as file:
            stated = LAMMPS_UNITS.search(file.readline())
        name = stated and stated[1]
        if name not in ("real", "metal"):
            raise ValueError(
                f"the velocities of {source} are in units that its LAMMPS file does not state as real or metal; "
                "read it with minimd.ase.system_from_file and lammps_units="
            )

        scale *= 1.0 if name == "real" else 1.0 / to_speed

    to_length = 1.0 if is_converted else get_conversion_factor("length", length, "Angstrom")
    return to_length / units.to_angstrom, scale * units.to_picosecond / units.to_angstrom


def _cell(dimensions: Any, length: float, source: str) -> Array | None:
    """Cell vectors of lengths and angles; an edge of length 0 is an open direction. Edges or angles of 0 are no cell,
    nor is one that cannot be, which is told."""
    if dimensions is None:
        return None
    edges, angles = np.split(as_decimals(dimensions), 2)
    if not (edges.any() and angles.any()):
        return None
    is_open = edges == 0.0
    with quiet():
        vectors = triclinic_vectors([*np.where(is_open, 1.0, edges), *angles], float)
    if not vectors.any():
        warn(
            f"edges and angles {[*edges.tolist(), *angles.tolist()]} of {source} are no cell; give cell="
        )
        return None
    vectors[is_open] = 0.0
    return np.asarray(length * vectors)


def as_decimals(values: Any) -> Array:
    """Numbers that MDAnalysis has rounded to float32, in float64 and the same shape: their shortest decimals, which are
    those of a text file."""
    rounded = np.asarray(values, np.float32)
    return np.array([float(text) for text in rounded.ravel().astype(str)]).reshape(rounded.shape)


def stated_of(atoms: AtomGroup, source: str, positions: Array) -> Stated:
    """What a group of atoms states, apart from what MDAnalysis has guessed."""
    elements = residues = residue_of = None
    if _is_stated(atoms, "elements"):
        elements = [symbol_of(str(text)) for text in atoms.elements]
        # D and T are in the column of a PDB file, but not in MDAnalysis' elements
        for k, kind in enumerate(getattr(atoms, "types", ())):
            if not elements[k] and kind in ISOTOPES:
                elements[k] = str(kind)
    if hasattr(atoms, "resnames"):
        residues = [str(name) for name in atoms.resnames]
        residue_of = np.unique(atoms.resindices, return_inverse=True)[1]
    names = [str(name) for name in getattr(atoms, "names", _types(atoms))]
    return Stated(source, names, positions, elements, _masses(atoms), residues, residue_of)


def _is_stated(atoms: AtomGroup, name: str) -> bool:
    """Whether a universe has an attribute of atoms that MDAnalysis has not guessed."""
    attribute = getattr(atoms.universe._topology, name, None)
    return attribute is not None and not attribute.is_guessed


def _masses(atoms: AtomGroup) -> Array | None:
    """Masses [u] that are not those which MDAnalysis guesses; NaN where it knows none."""
    if not hasattr(atoms, "masses"):
        return None
    masses = np.array(atoms.masses, float)
    is_stated = _is_stated(atoms, "masses")
    kinds = getattr(atoms, "elements", getattr(atoms, "types", None))
    if kinds is None:
        return masses if is_stated else None
    guesser = DefaultGuesser(None)
    with quiet():
        is_guess = np.equal(guesser.guess_masses(np.asarray(kinds)), masses)
        types = guesser.guess_types(getattr(atoms, "names", kinds))
    if not is_stated:
        return np.where(is_guess | (masses <= 0.0), np.nan, masses)
    # Merge forgets that masses and types were guessed
    return None if is_guess.all() and (kinds == types).all() else masses


def charges_of(atoms: AtomGroup) -> Array | None:
    """Charges [e], or None. MDAnalysis rounds those of some files to float32; their shortest decimals are those of the
    file, with which neutral molecules stay neutral."""
    if not hasattr(atoms, "charges"):
        return None
    charges = np.asarray(atoms.charges, float)
    is_rounded = np.array_equal(charges.astype(np.float32), charges)
    return as_decimals(charges) if is_rounded else charges


def _types(atoms: AtomGroup) -> list[str]:
    """Types that a universe states, or else names, or nothing."""
    for name in ("types", "names"):
        labels = [str(label) for label in getattr(atoms, name, ())]
        if any(labels) and _is_stated(atoms, name):
            return labels
    return [""] * len(atoms)


def _types_or_elements(atoms: AtomGroup, symbols: Sequence[str]) -> list[str]:
    """Types that are stated, unless they are elements in capitals; else elements, or names where there are none."""
    has_types = _is_stated(atoms, "types")
    species = []
    for label, symbol in zip(_types(atoms), symbols, strict=True):
        is_type = has_types and label[:1].isalpha() and label.upper() != symbol.upper()
        name = label if is_type else symbol
        species.append(name or label or "X")
    return species


def _within(atoms: AtomGroup, name: str, size: int) -> Indices:
    """Bonds, angles or dihedrals whose atoms are all in the group, as indices into it."""
    try:
        groups = np.asarray(getattr(atoms, name).indices, np.int64).reshape(-1, size)
    except (AttributeError, NoDataError):
        return np.zeros((0, size), np.int64)
    place = np.full(len(atoms.universe.atoms), -1)
    place[atoms.indices] = np.arange(len(atoms))
    members: Indices = place[groups]
    return members[(members >= 0).all(axis=1)]
