"""The layout of a minimd file, which follows H5MD.

    particles/trajectory    box/edges, position, velocity, force [Å, Å/ps, kJ/mol/Å; times in ps], species, mass,
                            and charge, if there are charges
    connectivity/bonds      pairs of bonded atoms; likewise angles, dihedrals and impropers, if there are any
    observables/<name>      the numbers of the record, to the last bit, in the units of the simulation
    observables/dt          the time between observations [ps], for each frame: MDAnalysis looks for it only here
    minimd                  data without a place in H5MD: units, cell, pbc, timestep, method, exact times; restarts,
                            observers, digests: see h5md_digest
    minimd/constraints      pairs (K, 2), their lengths (K,), with the attributes tolerance and solver; fixed (F,)
                            atoms; without what the run does not have
    minimd/sites            atoms (S,), parents (S, P), weights (S, P), out_of_plane (S,) of System.sites, if any
    minimd/topology         (N, 5, W) uint8, the texts of System.topology in ASCII, if there are any

Numbers in reduced units are written unchanged with the same labels, because MDAnalysis refuses a file without units;
the attribute units of the group minimd is then "LJ". For MDAnalysis a box with edges is periodic in all directions, and
one without edges in none. Edges are written if any direction is periodic and the cell has three independent vectors;
the attribute pbc says which are periodic, the attribute dimensions, 2, that the scene is a plane. P. de Buyl, P. H.
Colberg, F. Höfling, Comput. Phys. Commun. 185, 1546 (2014); H5MD 1.1.
"""

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import h5py
import numpy as np

from minimd.core.compiled.machine import EPS
from minimd.core.console import __version__
from minimd.core.console.display import as_text
from minimd.core.console.words import printable
from minimd.core.constraints.solver import ROUNDINGS
from minimd.core.diagnosis.contacts import thin_cell
from minimd.core.diagnosis.judge import too_long_a_step
from minimd.core.engine.engine import Engine
from minimd.core.engine.record import SERIES, Frame
from minimd.core.files.h5_items import NOTHING, REFERENCE, TEXT, Item
from minimd.core.files.stored_fields import STEPS
from minimd.core.integrators.barostats import StochasticCellRescaling
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import Cell
from minimd.core.structure.constraints import Constraint, DistanceConstraints, FixedAtoms
from minimd.core.structure.sites import Sites
from minimd.core.structure.system import System
from minimd.core.structure.units import UnitSystem

CHUNK_BYTES = 64 * 1024  # of one series; a larger entry is a chunk of its own
# the most rows, and the fewest for a file with few frames: more may be appended
CHUNK_ROWS = 512
FEW_ROWS = 16
LARGEST_ENUMERATION = 1000  # so many labels fit into the header of a dataset, 64 KiB
TRAJECTORY = "particles/trajectory"
TIMES = f"{TRAJECTORY}/position/time"
# the name in Timestep.data that MDAnalysis' Timestep.dt reads first; its H5MD reader fills data from observables
SPACING = "dt"
TOLERANCE = ("the tolerance of lengths",)  # words, as of _held
SOLVER = ("the solver of lengths",)
AT = re.compile(r" at 0x[0-9a-fA-F]+")  # in the words of functions


class Column(NamedTuple):
    """A series of the file: its path, its unit (empty for a pure number, or if it is not known),
    and the function for its entry for a frame."""

    path: str
    unit: str
    entry: Callable[[Frame], Any]


def columns(
    system: System, observables: list[str], store_forces: bool, spacing: float | None
) -> list[Column]:
    """All series of a file, positions last: for MDAnalysis their length is the number of frames.
    spacing : time between observations [time]; None for a file that does not hold it."""
    units = system.units
    to = factors(units)
    ps = units.to_picosecond
    chosen = [
        Column("minimd/time", units.time, lambda frame: frame.time),
        Column(STEPS, "", lambda frame: frame.step),
        Column(TIMES, "ps", lambda frame: frame.time * ps),
    ]

    def add(path: str, unit: str, entry: Callable[[Frame], Any]) -> None:
        chosen.append(Column(f"{path}/value", unit, entry))

    for name in observables:
        unit = getattr(units, SERIES.get(name) or "", "")
        add(f"observables/{name}", unit, partial(_observed, name))
    if spacing is not None:
        add(f"observables/{SPACING}", "ps", lambda _: spacing * ps)
    if has_edges(system.cell):
        edges = f"{TRAJECTORY}/box/edges"
        add(edges, "Angstrom", lambda frame: (frame.cell or system.cell).vectors * to["positions"])
    velocity = f"{TRAJECTORY}/velocity"
    add(velocity, "Angstrom ps-1", lambda frame: frame.velocities * to["velocities"])
    if store_forces:
        force = f"{TRAJECTORY}/force"
        add(force, "kJ mol-1 Angstrom-1", lambda frame: frame.forces * to["forces"])
    add(f"{TRAJECTORY}/position", "Angstrom", lambda frame: frame.positions * to["positions"])
    return chosen


def _observed(name: str, frame: Frame) -> Any:
    return frame.observables[name]


def factors(units: UnitSystem) -> dict[str, float]:
    """By what positions, velocities and forces of a system are multiplied in a file [Å, Å/ps, kJ/mol/Å]."""
    per_time = units.to_angstrom / units.to_picosecond
    force = units.to_kj_per_mol / units.to_angstrom
    return {"positions": units.to_angstrom, "velocities": per_time, "forces": force}


def has_edges(cell: Cell) -> bool:
    """True if MDAnalysis can hold this cell: some direction is periodic, and the three vectors span a volume."""
    return cell.is_periodic and np.linalg.matrix_rank(cell.vectors) == 3


def chunk_rows(entry: np.ndarray, n_frames: int | None = None) -> int:
    """The number of entries in a chunk of a series; a chunk takes its full size on the disk.
    n_frames : expected in the file, if known."""
    expected = CHUNK_ROWS if n_frames is None else max(FEW_ROWS, n_frames)
    return max(1, min(CHUNK_BYTES // entry.nbytes, CHUNK_ROWS, expected))


def series(
    columns: list[Column], entries: dict[str, np.ndarray], first: int, n_frames: int | None
) -> dict[str, Item]:
    """Series of a file from the index `first` on; what was behind it is replaced.  Series of H5MD share one step and
    one time.
    entries : by path.
    n_frames : as for chunk_rows."""
    items: dict[str, Item] = {}
    for path, unit, _ in columns:
        attributes = {"unit": unit} if unit and first == 0 else NOTHING
        values = entries[path]
        items[path] = Item(attributes, values, chunk_rows(values[0], n_frames), first)
        group, _, name = path.rpartition("/")
        if name == "value" and first == 0 and not STEPS.startswith(group):
            items[f"{group}/step"] = Item(other=STEPS)
            items[f"{group}/time"] = Item(other=TIMES)
    return items


def description(engine: Engine) -> dict[str, Item]:
    """All that does not change: the program, species, masses, charges, bonds, cell, method, constraints."""
    system = engine.system
    names = system.species_names
    boundary = ["periodic" if has_edges(system.cell) else "none"] * 3
    labels = {str(name): number for number, name in enumerate(names)}
    kind = np.dtype(np.int64)
    if len(labels) <= LARGEST_ENUMERATION:
        kind = h5py.enum_dtype(labels, basetype=np.int64)
    if isinstance(names[0], str):
        stored_names = np.array([name.encode() for name in names], TEXT)
    else:
        stored_names = np.array(names, np.int64)

    attributes: dict[str, Any] = {
        "version": __version__,
        "units": system.units.name,
        "pbc": system.cell.pbc,
        "title": engine.notes["title"] or f"{len(system)} atoms of {', '.join(labels)}",
        "scene": engine.notes["scene"],
    }
    attributes |= {"dimensions": 2} if system.dimensions == 2 else {}
    items = {
        "h5md": Item({"version": [1, 1]}),
        "h5md/author": Item({"name": "N/A"}),
        "h5md/creator": Item({"name": "minimd", "version": __version__}),
        f"{TRAJECTORY}/box": Item({"dimension": 3, "boundary": boundary}),
        f"{TRAJECTORY}/species": Item(data=system.species_index.astype(kind)),
        "minimd": Item(attributes | of_method(engine)),
        "minimd/species_names": Item(data=stored_names),
        "minimd/cell": Item(data=system.cell.vectors),
        "minimd/species_index": Item(data=system.species_index),
    }
    per_atom = (("mass", "masses", "u"), ("charge", "charges", "e"))

    for name, own_name, unit in per_atom:
        values = getattr(system, own_name)
        if values.any():
            items[f"{TRAJECTORY}/{name}"] = Item({"unit": unit}, values)
            items[f"minimd/{own_name}"] = Item(other=f"{TRAJECTORY}/{name}")

    if len(system.topology):
        letters = system.topology.astype("S").view(np.uint8)
        items["minimd/topology"] = Item(data=letters.reshape(len(system), 5, -1))

    for name, members in system.groups().items():
        if len(members) or name == "bonds":
            items[f"connectivity/{name}"] = Item({REFERENCE: TRAJECTORY}, members)
            items[f"minimd/{name}"] = Item(other=f"connectivity/{name}")

    group = "minimd/constraints"

    for constraint in engine.constraints:
        if isinstance(constraint, FixedAtoms):
            items[f"{group}/fixed"] = Item(data=constraint.atoms)
        else:
            solution = {"tolerance": constraint.tolerance, "solver": constraint.solver}
            items[group] = Item(solution)
            items[f"{group}/pairs"] = Item(data=constraint.pairs)
            items[f"{group}/lengths"] = Item(data=constraint.lengths)

    return items | _of_sites(system)


def _of_sites(system: System) -> dict[str, Item]:
    arrays = {} if system.sites is None else vars(system.sites)
    return {f"minimd/sites/{name}": Item(data=array) for name, array in arrays.items()}


def of_method(engine: Engine, before: Mapping[str, Any] = NOTHING) -> dict[str, Any]:
    """Method and time step of the frames that come next, and the options with which they are computed.
    before : the attributes of the group minimd in the file."""
    attributes = {name: write(engine) for name, (write, _) in METHOD.items()}
    if goes_on_otherwise(engine, before):
        attributes["since"] = max(engine.step, before.get("since", 0))
    parameters = engine.method.parameters
    numbers = {name: value for name, value in parameters.items() if isinstance(value, float)}
    return attributes | numbers


def goes_on_otherwise(engine: Engine, before: Mapping[str, Any]) -> bool:
    """Whether method, bath or a parameter of them is another one than in the attributes of the group minimd."""
    now = {name: METHOD[name][0](engine) for name in DECISIVE}
    return any(before.get(name, value) != value for name, value in now.items())


def read_method(group: h5py.Group) -> dict[str, Any]:
    """What of_method told, by the names of H5MDContents; older files have no barostat."""
    return {name: read(group.attrs.get(name, "")) for name, (_, read) in METHOD.items()}


def read_constraints(group: h5py.Group) -> tuple[Constraint, ...]:
    """The constraints in the group of minimd, to the last bit."""
    stored = group.get("constraints", {})
    constraints: list[Constraint] = []
    if "fixed" in stored:
        constraints.append(FixedAtoms(stored["fixed"][:]))
    if "pairs" in stored:
        solver: Any = str(stored.attrs["solver"])
        tolerance = float(stored.attrs["tolerance"])
        pairs = stored["pairs"][:]
        constraints.append(DistanceConstraints(pairs, stored["lengths"][:], tolerance, solver))
    return tuple(constraints)


def read_sites(group: h5py.Group) -> Sites | None:
    """The sites in the group of minimd."""
    if "sites" not in group:
        return None
    stored = group["sites"]
    names = ("atoms", "parents", "weights", "out_of_plane")
    return Sites(*(stored[name][:] for name in names))


def potentials_in_words(potentials: Sequence[Any]) -> list[str]:
    """The class of each potential, and the call that makes it again."""
    words = []
    for potential in potentials:
        call = getattr(potential, "in_full", potential.__repr__)
        words.append(f"{type(potential).__name__}: {call()}")
    return words


def _text(stored: Any) -> str:
    return printable(str(stored))


# attribute: as written, and as read
METHOD: dict[str, tuple[Callable[[Engine], Any], Callable[[Any], Any]]] = {
    "method": (lambda engine: engine.method.name, _text),
    # a seed may be larger than the integers of HDF5
    "parameters": (lambda engine: json.dumps(engine.method.parameters), json.loads),
    "conserves_momentum": (lambda engine: engine.conserves_momentum, bool),
    "moves_freely": (lambda engine: engine.moves_freely, bool),
    "precision": (lambda engine: engine.interactions.options.precision, str),
    # NaN for None
    "skin": (
        lambda engine: (
            math.nan
            if engine.interactions.options.skin is None
            else engine.interactions.options.skin
        ),
        lambda stored: None if np.isnan(stored) else float(stored),
    ),
    "potentials": (
        lambda engine: potentials_in_words(engine.interactions.potentials),
        lambda stored: [printable(call) for call in stored],
    ),
    "too_long_a_step": (lambda engine: too_long_a_step(engine) or "", _text),
    "thin_cell": (lambda engine: thin_cell(engine.system, engine.interactions.potentials), _text),
    "barostat": (
        lambda engine: "" if engine.barostat is None else json.dumps(engine.barostat.parameters),
        lambda stored: StochasticCellRescaling(**json.loads(stored)) if stored else None,
    ),
}
DECISIVE = "method", "parameters", "barostat"  # for the bits of steps


def other_potentials(stored: Sequence[str], potentials: Sequence[Any]) -> str:
    """How the potentials in a file differ from those with which its run goes on, in words;
    empty if they are the same."""
    before = sorted(AT.sub("", call) for call in stored)
    now = sorted(AT.sub("", call) for call in potentials_in_words(potentials))
    if before == now:
        return ""
    left = "; ".join(call for call in before if call not in now)
    new = "; ".join(call for call in now if call not in before)
    return f"{left or 'none'} before, {new or 'none'} now"


def other_method(contents: Any, engine: Engine) -> str:
    """The method, barostat and precision of the last steps in a file beside those with which its run goes on, in words;
    empty if they are the same, or if only the temperature is another: who anneals means it.
    contents : H5MDContents, which has a barostat if the engine has one."""
    parameters = contents.parameters
    precision = contents.precision
    own = json.loads(json.dumps(engine.method.parameters))
    now = (engine.method.name, own, engine.interactions.options.precision)
    annealed = dict(parameters)
    if "temperature" in parameters:
        annealed["temperature"] = own.get("temperature")
    bath = engine.barostat
    is_same_bath = bath is None or bath == replace(contents.barostat, temperature=bath.temperature)
    if is_same_bath and now == (contents.method, annealed, precision):
        return ""
    before = (contents.method, parameters, precision)
    runs = []
    for (method, values, arithmetic), barostat in ((before, contents.barostat), (now, bath)):
        arguments = ", ".join(f"{key}={as_text(value)}" for key, value in values.items())
        beside = "" if is_same_bath else f" with {barostat!r}"
        suffix = "" if now[2] == precision else f" in {arithmetic} precision"
        runs.append(f"{method}({arguments}){beside}{suffix}")
    return "{} before, {} now".format(*runs)


def other_constraints(
    file: Sequence[Constraint], simulation: Sequence[Constraint], positions: Array
) -> str:
    """The first difference between the constraints of file and simulation, in words;
    empty if they agree within tolerance and rounding.

    positions : (N, 3) [length]; the largest coordinate sets the rounding of lengths that were measured in positions.
    """
    was = _held(file)
    now = _held(simulation)
    rounding = ROUNDINGS * EPS * float(np.abs(positions).max())

    for key in sorted(was | now):
        template, *atoms = key
        name = template.format(*atoms)
        if key not in was or key not in now:
            return f"{name} in the {'file' if key in was else 'simulation'} alone"
        is_same = was[key] == now[key]
        if len(atoms) == 2:
            is_same = abs(now[key] - was[key]) <= was[TOLERANCE] * was[key] + rounding
        if not is_same:
            return f"{name}: {was[key]!r} in the file and {now[key]!r} in the simulation"

    return ""


def _held(constraints: Sequence[Constraint]) -> dict[tuple[Any, ...], Any]:
    """What is held: words and atoms, with the length, or another value."""
    held: dict[tuple[Any, ...], Any] = {}
    for constraint in constraints:
        if isinstance(constraint, FixedAtoms):
            held |= {("atom {} is fixed", atom): True for atom in constraint.atoms.tolist()}
            continue
        pairs = np.sort(constraint.pairs, axis=1).tolist()
        lengths = () if constraint.lengths is None else constraint.lengths.tolist()
        for pair, length in zip(pairs, lengths, strict=False):
            held["the length of atoms {}-{} is kept", *pair] = length
        held |= {TOLERANCE: constraint.tolerance, SOLVER: constraint.solver}
    return held
