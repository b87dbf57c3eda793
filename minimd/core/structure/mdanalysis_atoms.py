"""Atoms of MDAnalysis as systems."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from MDAnalysis import AtomGroup, NoDataError, Universe
from MDAnalysis.lib.mdamath import triclinic_vectors
from numpy.typing import ArrayLike, NDArray

from minimd.core.structure.bond_graph import GROUPS
from minimd.core.structure.checks import checked_kind
from minimd.core.structure.units import LJ, UnitSystem


def universe_arguments(universe: Universe | AtomGroup, units: UnitSystem, groups: Mapping[str, ArrayLike | None],
                       pbc: ArrayLike | None) -> dict[str, Any]:  # fmt: skip
    """Arguments for System from a universe or a group of its atoms, as System.from_mdanalysis describes them.
    groups : bonds, angles, dihedrals and impropers by these names; None for those of the universe.
    Raises TypeError for anything else.  ValueError for atoms without masses, where the units have no default."""
    checked_kind("universe", universe, Universe | AtomGroup, "an MDAnalysis Universe or AtomGroup")
    checked_kind("units", units, UnitSystem, "minimd.units.LJ or minimd.units.ASE")
    atoms = universe.atoms
    ts, to_length, to_speed = atoms.universe.trajectory.ts, units.to_angstrom, units.to_picosecond / units.to_angstrom
    is_periodic = ts.dimensions is not None and bool(np.all(ts.dimensions[:3] > 0.0))
    return {"positions": atoms.positions.astype(np.float64) / to_length, "masses": _masses(atoms, units),
            "charges": charges_of(atoms),
            "velocities": atoms.velocities.astype(np.float64) * to_speed if ts.has_velocities else None,
            "cell": triclinic_vectors(ts.dimensions, dtype=np.float64) / to_length if is_periodic else None, "pbc": pbc,
            "species": _species(atoms),
            **{name: _within(atoms, name, GROUPS[name]) if given is None else given for name, given in groups.items()},
            "units": units}  # fmt: skip


def _masses(atoms: AtomGroup, units: UnitSystem) -> NDArray[np.float64] | None:
    masses = np.asarray(getattr(atoms, "masses", np.zeros(len(atoms))), dtype=np.float64)
    if not masses.any() and units is LJ:
        return None
    if not (masses > 0.0).all():
        first = int(np.argmin(masses > 0.0))
        given = f"MDAnalysis has {masses[first]} for atom {first}, as for all types that it does not know"
        remedy = "set universe.atoms.masses, or call universe.add_TopologyAttr('masses', values)"
        raise ValueError(f"masses must be positive; {given}: {remedy}")
    return masses


def charges_of(atoms: AtomGroup) -> NDArray[np.float64] | None:
    """Charges [e], or None. MDAnalysis rounds those of some files to float32; their shortest decimals are those of the
    file, with which neutral molecules stay neutral."""
    if (charges := getattr(atoms, "charges", None)) is None:
        return None
    charges = np.asarray(charges, dtype=np.float64)
    rounded = charges.astype(np.float32)
    return rounded.astype(str).astype(np.float64) if np.array_equal(rounded, charges) else charges


def _species(atoms: AtomGroup) -> list[str] | None:
    """Types, or else elements, or else names, or None."""
    for name in ("types", "elements", "names"):
        labels = [str(label) for label in getattr(atoms, name, ())]
        if any(labels):
            return [label or "X" for label in labels]
    return None


def _within(atoms: AtomGroup, name: str, size: int) -> NDArray[np.int64]:
    """Bonds, angles or dihedrals whose atoms are all in the group, as indices into it."""
    try:
        groups = np.asarray(getattr(atoms, name).indices, dtype=np.int64).reshape(-1, size)
    except (AttributeError, NoDataError):
        return np.zeros((0, size), np.int64)
    place = np.full(len(atoms.universe.atoms), -1)
    place[atoms.indices] = np.arange(len(atoms))
    found: NDArray[np.int64] = place[groups]
    return found[(found >= 0).all(axis=1)]
