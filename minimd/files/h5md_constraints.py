"""Constraints in a minimd file: the atoms and lengths that a run holds fixed,
and how those of file and simulation differ.

minimd/constraints    pairs (K, 2), their lengths (K,), with the attributes tolerance and solver; fixed (F,) atoms

A kind of constraint that the run does not have is left out; the file of a run without constraints has no such group.
"""

from collections.abc import Sequence
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from minimd.compiled.machine import EPS
from minimd.constraints.solver import ROUNDINGS
from minimd.structure.constraints import Constraint, DistanceConstraints, FixedAtoms

NAME = "constraints"


def describe_constraints(group: h5py.Group, constraints: Sequence[Constraint]) -> None:
    """Write the constraints of a simulation, lengths included, into the group of minimd."""
    made = group.create_group(NAME) if constraints else group
    for one in constraints:
        if isinstance(one, FixedAtoms):
            made["fixed"] = one.atoms
        else:
            made["pairs"], made["lengths"] = one.pairs, one.lengths
            made.attrs.update({"tolerance": one.tolerance, "solver": one.solver})


def read_constraints(group: h5py.Group) -> tuple[Constraint, ...]:
    """The constraints that describe_constraints wrote, to the last bit."""
    stored = group.get(NAME, {})
    found: list[Constraint] = [FixedAtoms(stored["fixed"][:])] if "fixed" in stored else []
    if "pairs" in stored:
        solver: Any = str(stored.attrs["solver"])
        found.append(
            DistanceConstraints(stored["pairs"][:], stored["lengths"][:], float(stored.attrs["tolerance"]), solver)
        )
    return tuple(found)


def difference(file: Sequence[Constraint], simulation: Sequence[Constraint], positions: NDArray[np.float64]) -> str:
    """The first difference between the constraints of file and simulation, in words;
    empty if they agree within tolerance and rounding.

    positions : (N, 3) [length]; the largest coordinate sets the rounding of lengths that were measured in positions.
    """
    theirs, ours = (
        {atom for one in both if isinstance(one, FixedAtoms) for atom in one.atoms.tolist()}
        for both in (file, simulation)
    )
    if only := theirs ^ ours:
        return f"atom {min(only)} is fixed in the {'file' if min(only) in theirs else 'simulation'} alone"
    before, now = (
        next((one for one in both if isinstance(one, DistanceConstraints)), None) for both in (file, simulation)
    )
    if not (before and now):
        alone = before or now
        where = "file" if before else "simulation"
        return f"the {where} alone keeps lengths, {len(alone.pairs)} of them" if alone else ""
    was, kept = _by_pair(before), _by_pair(now)
    if several := was.keys() ^ kept.keys():
        i, j = min(several)
        return f"the length of atoms {i}-{j} is kept in the {'file' if (i, j) in was else 'simulation'} alone"
    rounding = ROUNDINGS * EPS * float(np.abs(positions).max())
    for (i, j), length in was.items():
        if abs(kept[i, j] - length) > before.tolerance * length + rounding:
            return f"the length of atoms {i}-{j} is {length:.17g} in the file and {kept[i, j]:.17g} in the simulation"
    for name in ("tolerance", "solver"):
        if (a := getattr(before, name)) != (b := getattr(now, name)):
            return f"the {name} of lengths is {a!r} in the file and {b!r} in the simulation"
    return ""


def _by_pair(constraints: DistanceConstraints) -> dict[tuple[int, int], float]:
    """The length of each pair, the lower atom first."""
    lengths = [] if constraints.lengths is None else constraints.lengths.tolist()
    return {(i, j): length for (i, j), length in zip(np.sort(constraints.pairs, axis=1).tolist(), lengths, strict=True)}
