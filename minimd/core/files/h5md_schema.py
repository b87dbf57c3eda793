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
    minimd/topology         (N, 5, W) uint8, the texts of System.topology in ASCII, if there are any

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

from minimd.core.compiled.machine import EPS
from minimd.core.console import __version__
from minimd.core.console.display import as_text
from minimd.core.console.words import printable
from minimd.core.constraints.solver import ROUNDINGS
from minimd.core.diagnosis.judge import too_long_a_step
from minimd.core.engine.engine import Engine
from minimd.core.engine.record import SERIES, Frame
from minimd.core.files.h5_items import NOTHING, REFERENCE, TEXT, Item
from minimd.core.files.stored_fields import STEPS
from minimd.core.forces.contacts import thin_cell
from minimd.core.integrators.barostats import StochasticCellRescaling
from minimd.core.structure.cell import Cell
from minimd.core.structure.constraints import Constraint, DistanceConstraints, FixedAtoms
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
TOLERANCE, SOLVER = ("the tolerance of lengths",), ("the solver of lengths",)  # words, as of _held
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
    """All series of a file, positions last: for MDAnalysis their length is the number of frames.  spacing : time
    between observations [time]; None for a file that does not hold it."""
    units = system.units
    to = factors(system.units)
    ps = system.units.to_picosecond
    named = {name: getattr(units, SERIES.get(name) or "", "") for name in observables}
    at_edges = (
        (lambda at: (at.cell or system.cell).vectors * to["positions"])
        if has_edges(system.cell)
        else None
    )
    at_forces = (lambda at: at.forces * to["forces"]) if store_forces else None
    # path, unit, entry; None: the file does not hold it
    rows: list[tuple[str, str, Callable[[Frame], Any] | None]] = [
        ("minimd/time", units.time, lambda at: at.time),
        (STEPS, "", lambda at: at.step),
        (TIMES, "ps", lambda at: at.time * ps),
        *(
            (f"observables/{name}/value", unit, partial(_observed, name))
            for name, unit in named.items()
        ),
        (f"observables/{SPACING}/value", "ps", None if spacing is None else lambda _: spacing * ps),
        (f"{TRAJECTORY}/box/edges/value", "Angstrom", at_edges),
        (
            f"{TRAJECTORY}/velocity/value",
            "Angstrom ps-1",
            lambda at: at.velocities * to["velocities"],
        ),
        (f"{TRAJECTORY}/force/value", "kJ mol-1 Angstrom-1", at_forces),
        (f"{TRAJECTORY}/position/value", "Angstrom", lambda at: at.positions * to["positions"]),
    ]
    return [Column(path, unit, entry) for path, unit, entry in rows if entry is not None]


def _observed(name: str, at: Frame) -> Any:
    return at.observables[name]


def factors(units: UnitSystem) -> dict[str, float]:
    """By what positions, velocities and forces of a system are multiplied in a file [Å, Å/ps, kJ/mol/Å]."""
    per_time = units.to_angstrom / units.to_picosecond
    force = units.to_kj_per_mol / units.to_angstrom
    return {"positions": units.to_angstrom, "velocities": per_time, "forces": force}


def has_edges(cell: Cell) -> bool:
    """True if MDAnalysis can hold this cell: some direction is periodic, and the three vectors span a volume."""
    return cell.is_periodic and np.linalg.matrix_rank(cell.vectors) == 3


def chunk_rows(entry: np.ndarray, n_frames: int | None = None) -> int:
    """The number of entries in a chunk of a series; a chunk takes its full size on the disk.  n_frames : expected in
    the file, if known."""
    expected = CHUNK_ROWS if n_frames is None else max(FEW_ROWS, n_frames)
    return max(1, min(CHUNK_BYTES // entry.nbytes, CHUNK_ROWS, expected))


def series(
    columns: list[Column], entries: dict[str, np.ndarray], first: int, n_frames: int | None
) -> dict[str, Item]:
    """Series of a file from the index `first` on; what was behind it is replaced.  Series of H5MD share one step and
    one time.  entries : by path.  n_frames : as for chunk_rows."""
    found: dict[str, Item] = {}
    for path, unit, _ in columns:
        about = {"unit": unit} if unit and first == 0 else NOTHING
        found[path] = Item(about, entries[path], chunk_rows(entries[path][0], n_frames), first)
        group, _, name = path.rpartition("/")
        if name == "value" and first == 0 and not STEPS.startswith(group):
            found |= {
                f"{group}/{other.rpartition('/')[2]}": Item(other=other) for other in (STEPS, TIMES)
            }
    return found


def description(engine: Engine) -> dict[str, Item]:
    """All that does not change: the program, species, masses, charges, bonds, cell, method, constraints."""
    system = engine.system
    names = engine.system.species_names
    boundary = ["periodic" if has_edges(system.cell) else "none"] * 3
    labels = {str(name): number for number, name in enumerate(names)}
    kind = (
        h5py.enum_dtype(labels, basetype=np.int64)
        if len(labels) <= LARGEST_ENUMERATION
        else np.dtype(np.int64)
    )
    texts = [name.encode() if isinstance(name, str) else name for name in names]
    title = engine.notes["title"] or f"{len(system)} atoms of {', '.join(map(str, names))}"
    about = {
        "version": __version__,
        "units": system.units.name,
        "pbc": system.cell.pbc,
        "title": title,
    }
    found = {
        "h5md": Item({"version": [1, 1]}),
        "h5md/author": Item({"name": "N/A"}),
        "h5md/creator": Item({"name": "minimd", "version": __version__}),
        f"{TRAJECTORY}/box": Item({"dimension": 3, "boundary": boundary}),
        f"{TRAJECTORY}/species": Item(data=system.species_index.astype(kind)),
        "minimd": Item(about | {"scene": engine.notes["scene"]} | of_method(engine)),
        "minimd/species_names": Item(
            data=np.array(texts, dtype=TEXT if isinstance(names[0], str) else np.int64)
        ),
        "minimd/cell": Item(data=system.cell.vectors),
        "minimd/species_index": Item(data=system.species_index),
    }
    for name, second, unit in (("mass", "masses", "u"), ("charge", "charges", "e")):
        if (values := getattr(system, second)).any():
            found[f"{TRAJECTORY}/{name}"] = Item({"unit": unit}, values)
            found[f"minimd/{second}"] = Item(other=f"{TRAJECTORY}/{name}")
    if len(system.topology):
        found["minimd/topology"] = Item(
            data=system.topology.astype("S").view(np.uint8).reshape(len(system), 5, -1)
        )
    for name, members in system.groups().items():
        if len(members) or name == "bonds":
            found[f"connectivity/{name}"] = Item({REFERENCE: TRAJECTORY}, members)
            found[f"minimd/{name}"] = Item(other=f"connectivity/{name}")
    for one in engine.constraints:
        if isinstance(one, FixedAtoms):
            found["minimd/constraints/fixed"] = Item(data=one.atoms)
        else:
            found["minimd/constraints"] = Item({"tolerance": one.tolerance, "solver": one.solver})
            found |= {
                f"minimd/constraints/{name}": Item(data=getattr(one, name))
                for name in ("pairs", "lengths")
            }
    return found


def of_method(engine: Engine, before: Mapping[str, Any] = NOTHING) -> dict[str, Any]:
    """Method and time step of the frames that come next, and the options with which they are computed.
    before : the attributes of the group minimd in the file."""
    now = {name: told(engine) for name, (told, _) in METHOD.items()}
    if goes_on_otherwise(engine, before):
        now["since"] = max(engine.step, before.get("since", 0))
    return now | {
        name: value for name, value in engine.method.parameters.items() if isinstance(value, float)
    }


def goes_on_otherwise(engine: Engine, before: Mapping[str, Any]) -> bool:
    """Whether method, bath or a parameter of them is another one than in the attributes of the group minimd."""
    now = {name: METHOD[name][0](engine) for name in DECISIVE}
    return any(before.get(name, now[name]) != now[name] for name in DECISIVE)


def read_method(group: h5py.Group) -> dict[str, Any]:
    """What of_method told, by the names of H5MDContents; older files have no barostat."""
    return {name: read(group.attrs.get(name, "")) for name, (_, read) in METHOD.items()}


def read_constraints(group: h5py.Group) -> tuple[Constraint, ...]:
    """The constraints in the group of minimd, to the last bit."""
    stored = group.get("constraints", {})
    found: list[Constraint] = [FixedAtoms(stored["fixed"][:])] if "fixed" in stored else []
    if "pairs" in stored:
        solver: Any = str(stored.attrs["solver"])
        pairs = stored["pairs"][:]
        lengths = stored["lengths"][:]
        tolerance = float(stored.attrs["tolerance"])
        found.append(DistanceConstraints(pairs, lengths, tolerance, solver))
    return tuple(found)


def potentials_in_words(potentials: Sequence[Any]) -> list[str]:
    """The class of each potential, and the call that makes it again."""
    return [f"{type(one).__name__}: {one!r}" for one in potentials]


def _text(stored: Any) -> str:
    return printable(str(stored))


# attribute: as written, and as read
METHOD: dict[str, tuple[Callable[[Engine], Any], Callable[[Any], Any]]] = {
    "method": (lambda of: of.method.name, _text),
    # a seed may be larger than the integers of HDF5
    "parameters": (lambda of: json.dumps(of.method.parameters), json.loads),
    "conserves_momentum": (lambda of: of.conserves_momentum, bool),
    "moves_freely": (lambda of: of.moves_freely, bool),
    "precision": (lambda of: of.interactions.options.precision, str),
    "skin": (
        lambda of: np.nan if of.interactions.options.skin is None else of.interactions.options.skin,
        lambda stored: None if np.isnan(stored) else float(stored),
    ),
    "potentials": (
        lambda of: potentials_in_words(of.interactions.potentials),
        lambda stored: [printable(one) for one in stored],
    ),
    "too_long_a_step": (lambda of: too_long_a_step(of) or "", _text),
    "thin_cell": (lambda of: thin_cell(of.system, of.interactions.potentials), _text),
    "barostat": (
        lambda of: "" if of.barostat is None else json.dumps(of.barostat.parameters),
        lambda stored: StochasticCellRescaling(**json.loads(stored)) if stored else None,
    ),
}
DECISIVE = "method", "parameters", "barostat"  # for the bits of steps


def other_potentials(stored: Sequence[str], potentials: Sequence[Any]) -> str:
    """How the potentials in a file differ from those with which its run goes on, in words;
    empty if they are the same."""
    before, now = (
        sorted(AT.sub("", one) for one in several)
        for several in (stored, potentials_in_words(potentials))
    )
    if before == now:
        return ""
    was, becomes = (
        [one for one in several if one not in others]
        for several, others in ((before, now), (now, before))
    )
    return f"{'; '.join(was) or 'none'} before, {'; '.join(becomes) or 'none'} now"


def other_method(name: str, parameters: Mapping[str, Any], precision: str, engine: Engine) -> str:
    """The method, bath and precision of the last steps in a file beside those with which its run goes on, in words;
    empty if they are the same, or if only the temperature of the bath is another: who anneals means it."""
    ours = (
        engine.method.name,
        json.loads(json.dumps(engine.method.parameters)),
        engine.interactions.options.precision,
    )
    annealed = {
        key: ours[1].get(key) if key == "temperature" else value
        for key, value in parameters.items()
    }
    if ours == (name, annealed, precision):
        return ""
    before, now = (
        f"{one}({', '.join(f'{key}={as_text(value)}' for key, value in given.items())})"
        + ("" if ours[2] == precision else f" in {its} precision")
        for one, given, its in ((name, parameters, precision), ours)
    )
    return f"{before} before, {now} now"


def other_constraints(
    file: Sequence[Constraint], simulation: Sequence[Constraint], positions: NDArray[np.float64]
) -> str:
    """The first difference between the constraints of file and simulation, in words;
    empty if they agree within tolerance and rounding.

    positions : (N, 3) [length]; the largest coordinate sets the rounding of lengths that were measured in positions.
    """
    was = _held(file)
    kept = _held(simulation)
    rounding = ROUNDINGS * EPS * float(np.abs(positions).max())
    for key in sorted(was | kept):
        words, *atoms = key
        if key not in was or key not in kept:
            return f"{words.format(*atoms)} in the {'file' if key in was else 'simulation'} alone"
        slack = was[TOLERANCE] * was[key] + rounding if len(atoms) == 2 else 0.0
        if was[key] != kept[key] and not (slack and abs(kept[key] - was[key]) <= slack):
            return f"{words.format(*atoms)}: {was[key]!r} in the file and {kept[key]!r} in the simulation"
    return ""


def _held(constraints: Sequence[Constraint]) -> dict[tuple[Any, ...], Any]:
    """What is held: words and atoms, with the length, or another value."""
    found: dict[tuple[Any, ...], Any] = {}
    for one in constraints:
        if isinstance(one, FixedAtoms):
            found |= dict.fromkeys(
                (("atom {} is fixed", atom) for atom in one.atoms.tolist()), True
            )
        else:
            pairs = np.sort(one.pairs, axis=1).tolist()
            lengths = () if one.lengths is None else one.lengths.tolist()
            found |= {
                ("the length of atoms {}-{} is kept", *pair): length
                for pair, length in zip(pairs, lengths, strict=False)
            }
            found |= {TOLERANCE: one.tolerance, SOLVER: one.solver}
    return found
