"""The layout of a minimd file, which follows H5MD.

    particles/trajectory    box/edges, position, velocity, force [Å, Å/ps, kJ/mol/Å; times in ps], species, mass
    connectivity/bonds      pairs of bonded atoms; likewise angles, dihedrals and impropers, if there are any
    observables/<name>      the numbers of the record, to the last bit, in the units of the simulation
    observables/dt          the time between observations [ps], for each frame: MDAnalysis looks for it only here
    minimd                  data without a place in H5MD: units, cell, pbc, timestep, method, exact times, restarts,
                            digests
    minimd/constraints      pairs (K, 2), their lengths (K,), with the attributes tolerance and solver; fixed (F,)
                            atoms; without what the run does not have

Numbers in reduced units are written unchanged with the same labels, because MDAnalysis refuses a file without units;
the attribute units of the group minimd is then "LJ". For MDAnalysis a box with edges is periodic in all directions, and
one without edges in none. Edges are written if any direction is periodic and the cell has three independent vectors;
the attribute pbc says which are periodic. P. de Buyl, P. H. Colberg, F. Höfling, Comput. Phys. Commun. 185,
1546 (2014); H5MD 1.1.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from minimd.compiled.machine import EPS, version
from minimd.console.display import as_text
from minimd.constraints.solver import ROUNDINGS
from minimd.diagnosis.judge import too_long_a_step
from minimd.engine.engine import Engine
from minimd.engine.record import SERIES, Frame
from minimd.structure.cell import Cell
from minimd.structure.constraints import Constraint, DistanceConstraints, FixedAtoms
from minimd.structure.system import System

CHUNK_BYTES = 64 * 1024  # of one series; a larger entry is a chunk of its own
CHUNK_ROWS, FEW_ROWS = 512, 16  # the most rows, and the fewest for a file with few frames: more may be appended
LARGEST_ENUMERATION = 1000  # so many labels fit into the header of a dataset, 64 KiB
TRAJECTORY = "particles/trajectory"
CONSTRAINTS = "constraints"
STEPS, TIMES = f"{TRAJECTORY}/position/step", f"{TRAJECTORY}/position/time"
# the name in Timestep.data that MDAnalysis' Timestep.dt reads first; its H5MD reader fills data from observables
SPACING = "dt"


class Column(NamedTuple):
    """A series of the file: its path, its unit (empty for a pure number, or if it is not known),
    and the function for its entry for a frame."""

    path: str
    unit: str
    entry: Callable[[Frame], Any]


def columns(system: System, observables: list[str], store_forces: bool, spacing: float | None) -> list[Column]:
    """All series of a file, positions last: for MDAnalysis their length is the number of frames.

    spacing : time between observations [time]; None for a file that does not hold it.
    """
    units = system.units
    per_time, force = units.to_angstrom / units.to_picosecond, units.to_kj_per_mol / units.to_angstrom
    angstrom, picosecond = units.to_angstrom, units.to_picosecond
    series = [
        Column("minimd/time", units.time, lambda frame: frame.time),
        Column(STEPS, "", lambda frame: frame.step),
        Column(TIMES, "ps", lambda frame: frame.time * picosecond),
    ]
    for name in observables:
        unit = getattr(units, SERIES.get(name) or "", "")
        series.append(Column(f"observables/{name}/value", unit, partial(observable, name)))
    if spacing is not None:
        series.append(Column(f"observables/{SPACING}/value", "ps", lambda _: spacing * picosecond))
    for name, unit, is_kept, entry in (
        ("box/edges", "Angstrom", has_edges(system.cell), lambda at: (at.cell or system.cell).vectors * angstrom),
        ("velocity", "Angstrom ps-1", True, lambda at: at.velocities * per_time),
        ("force", "kJ mol-1 Angstrom-1", store_forces, lambda at: at.forces * force),
        ("position", "Angstrom", True, lambda at: at.positions * angstrom),
    ):
        series += [Column(f"{TRAJECTORY}/{name}/value", unit, entry)] if is_kept else []
    return series


def observable(name: str, frame: Frame) -> Any:
    """One observable of a frame."""
    return frame.observables[name]


def has_edges(cell: Cell) -> bool:
    """True if MDAnalysis can hold this cell: some direction is periodic, and the three vectors span a volume."""
    return cell.is_periodic and np.linalg.matrix_rank(cell.vectors) == 3


def chunk_rows(entry: np.ndarray, n_frames: int | None = None) -> int:
    """The number of entries in a chunk of a series; a chunk takes its full size on the disk.

    n_frames : expected in the file, if known.
    """
    expected = CHUNK_ROWS if n_frames is None else max(FEW_ROWS, n_frames)
    return int(np.clip(CHUNK_BYTES // entry.nbytes, 1, min(CHUNK_ROWS, expected)))


def series_of(h5: h5py.File, column: Column, like: np.ndarray, n_frames: int | None = None) -> h5py.Dataset:
    """The series of a column; if it does not exist, an empty one for entries like this one.

    Series of H5MD share one step and one time.

    n_frames : as for chunk_rows.
    """
    if column.path in h5:
        return h5[column.path]
    growing = {"maxshape": (None, *like.shape), "chunks": (chunk_rows(like, n_frames), *like.shape)}
    series = h5.create_dataset(column.path, (0, *like.shape), like.dtype, **growing)
    if column.unit:
        series.attrs["unit"] = column.unit
    if column.path.endswith("/value") and "step" not in series.parent:
        series.parent["step"], series.parent["time"] = h5[STEPS], h5[TIMES]
    return series


def describe(h5: h5py.File, engine: Engine) -> None:
    """Write everything that does not change: the program, species, masses, bonds, cell, method, constraints."""
    system = engine.system
    _describe_standard(h5, system)
    group = h5.create_group("minimd")
    title = engine.notes["title"] or f"{len(system)} atoms of {', '.join(str(name) for name in system.species_names)}"
    group.attrs.update({"version": version("minimd"), "units": system.units.name, "pbc": system.cell.pbc})
    group.attrs.update({"title": title, "scene": engine.notes["scene"]})
    describe_method(group, engine)
    describe_constraints(group, engine.constraints)
    names = system.species_names
    group["species_names"] = np.array(names, dtype=h5py.string_dtype() if isinstance(names[0], str) else np.int64)
    group["cell"], group["species_index"] = system.cell.vectors, system.species_index
    group["masses"] = h5[f"{TRAJECTORY}/mass"]
    group.update({name: h5[f"connectivity/{name}"] for name in h5["connectivity"]})


def potentials_in_words(potentials: Sequence[Any]) -> list[str]:
    """The class of each potential, and the call that makes it again."""
    return [f"{type(one).__name__}: {one!r}" for one in potentials]


def other_potentials(stored: Sequence[str], potentials: Sequence[Any]) -> str:
    """How the potentials in a file differ from those with which its run goes on, in words;
    empty if they are the same."""
    both = stored, potentials_in_words(potentials)
    before, now = (sorted(re.sub(r" at 0x[0-9a-fA-F]+", "", one) for one in several) for several in both)
    if before == now:
        return ""
    was, becomes = ([one for one in several if one not in others] for several, others in ((before, now), (now, before)))
    return f"{'; '.join(was) or 'none'} before, {'; '.join(becomes) or 'none'} now"


def other_method(name: str, parameters: Mapping[str, Any], precision: str, engine: Engine) -> str:
    """The method, bath and precision of the last steps in a file beside those with which its run goes on, in words;
    empty if they are the same."""
    ours = engine.method.name, json.loads(json.dumps(engine.method.parameters)), engine.interactions.options.precision
    if ours == (name, parameters, precision):
        return ""
    before, now = (
        f"{one}({', '.join(f'{key}={as_text(value)}' for key, value in given.items())})"
        + ("" if ours[2] == precision else f" in {its} precision")
        for one, given, its in ((name, parameters, precision), ours)
    )
    return f"{before} before, {now} now"


def describe_method(group: h5py.Group, engine: Engine) -> None:
    """Write method and time step of the frames that come next, and the options with which they are computed."""
    options = engine.interactions.options
    group.attrs.update({"method": engine.method.name, "conserves_momentum": engine.conserves_momentum})
    group.attrs.update({"precision": options.precision, "skin": np.nan if options.skin is None else options.skin})
    group.attrs["potentials"] = potentials_in_words(engine.interactions.potentials)
    group.attrs["too_long_a_step"] = too_long_a_step(engine) or ""
    group.attrs["barostat"] = "" if engine.barostat is None else json.dumps(engine.barostat.parameters)
    group.attrs["parameters"] = json.dumps(engine.method.parameters)  # a seed may be larger than the integers of HDF5
    group.attrs.update({name: value for name, value in engine.method.parameters.items() if isinstance(value, float)})


def _describe_standard(h5: h5py.File, system: System) -> None:
    """Write the part of the description that H5MD defines."""
    h5.create_group("h5md").attrs["version"] = np.array([1, 1])
    h5.create_group("h5md/author").attrs["name"] = "N/A"
    h5.create_group("h5md/creator").attrs.update({"name": "minimd", "version": version("minimd")})
    particles = h5.create_group(TRAJECTORY)
    box = particles.create_group("box")
    box.attrs.update({"dimension": 3, "boundary": ["periodic" if has_edges(system.cell) else "none"] * 3})
    labels = {str(name): number for number, name in enumerate(system.species_names)}
    kind = h5py.enum_dtype(labels, basetype=np.int64) if len(labels) <= LARGEST_ENUMERATION else np.int64
    particles.create_dataset("species", data=system.species_index, dtype=kind)
    particles["mass"] = system.masses
    particles["mass"].attrs["unit"] = "u"
    for name, groups in system.groups().items():
        if len(groups) or name == "bonds":
            h5[f"connectivity/{name}"] = groups
            h5[f"connectivity/{name}"].attrs["particles_group"] = particles.ref


def describe_constraints(group: h5py.Group, constraints: Sequence[Constraint]) -> None:
    """Write the constraints of a simulation, lengths included, into the group of minimd."""
    made = group.create_group(CONSTRAINTS) if constraints else group
    for one in constraints:
        if isinstance(one, FixedAtoms):
            made["fixed"] = one.atoms
        else:
            made["pairs"], made["lengths"] = one.pairs, one.lengths
            made.attrs.update({"tolerance": one.tolerance, "solver": one.solver})


def read_constraints(group: h5py.Group) -> tuple[Constraint, ...]:
    """The constraints that describe_constraints wrote, to the last bit."""
    stored = group.get(CONSTRAINTS, {})
    found: list[Constraint] = [FixedAtoms(stored["fixed"][:])] if "fixed" in stored else []
    if "pairs" in stored:
        solver: Any = str(stored.attrs["solver"])
        pairs, lengths, tolerance = stored["pairs"][:], stored["lengths"][:], float(stored.attrs["tolerance"])
        found.append(DistanceConstraints(pairs, lengths, tolerance, solver))
    return tuple(found)


def other_constraints(
    file: Sequence[Constraint], simulation: Sequence[Constraint], positions: NDArray[np.float64]
) -> str:
    """The first difference between the constraints of file and simulation, in words;
    empty if they agree within tolerance and rounding.

    positions : (N, 3) [length]; the largest coordinate sets the rounding of lengths that were measured in positions.
    """
    both = file, simulation
    theirs, ours = (
        {atom for one in several if isinstance(one, FixedAtoms) for atom in one.atoms.tolist()} for several in both
    )
    if only := theirs ^ ours:
        return f"atom {min(only)} is fixed in the {'file' if min(only) in theirs else 'simulation'} alone"
    before, now = (next((one for one in several if isinstance(one, DistanceConstraints)), None) for several in both)
    if not (before and now):
        alone = before or now
        where = "file" if before else "simulation"
        return f"the {where} alone keeps lengths, {len(alone.pairs)} of them" if alone else ""
    was, kept = _by_pair(before), _by_pair(now)
    if unlike := was.keys() ^ kept.keys():
        i, j = min(unlike)
        return f"the length of atoms {i}-{j} is kept in the {'file' if (i, j) in was else 'simulation'} alone"
    rounding = ROUNDINGS * EPS * float(np.abs(positions).max())
    for (i, j), length in was.items():
        if abs(kept[i, j] - length) > before.tolerance * length + rounding:
            return f"the length of atoms {i}-{j} is {length:.17g} in the file and {kept[i, j]:.17g} in the simulation"
    for name in ("tolerance", "solver"):
        if (first := getattr(before, name)) != (second := getattr(now, name)):
            return f"the {name} of lengths is {first!r} in the file and {second!r} in the simulation"
    return ""


def _by_pair(constraints: DistanceConstraints) -> dict[tuple[int, int], float]:
    """The length of each pair, the lower atom first."""
    lengths = [] if constraints.lengths is None else constraints.lengths.tolist()
    return {(i, j): length for (i, j), length in zip(np.sort(constraints.pairs, axis=1).tolist(), lengths, strict=True)}
