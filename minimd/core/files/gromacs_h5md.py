"""H5MD files of GROMACS 2026 (`gmx mdrun -o traj.h5md`): their last frame as a structure, and runs in their layout.

    particles/system        position, velocity, force, each with value [nm, nm/ps, kJ/mol/nm], step and time [ps]; box
                            with the attribute boundary, and box/edges/value: for each frame of positions a (3, 3)
                            array, rows = vectors [nm]
    connectivity/bonds      (B, 2) atoms from 0 on
    h5md/modules/gromacs_topology
                            a group for each type of molecule: mass [u], charge [e], species (atomic numbers), and names
                            as indices of tables; the attributes molecule_block_names and molecule_block_counts say how
                            many molecules of which type follow each other

Numbers are float32, or float64 of a GROMACS in double precision; steps and times are compressed. In reading, GROMACS
looks at particles/system alone, and takes numbers for nm whatever their unit; float64 is an error in single precision.
It therefore does not read the files of minimd, in Å and float64.
"""

from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from minimd.core.console import __version__
from minimd.core.console.words import printable
from minimd.core.engine.record import Frame
from minimd.core.files.claim import JournaledFile
from minimd.core.files.h5_items import NOTHING, Item, put
from minimd.core.files.h5md_reader import GROMACS, frames_of, opened, read_file
from minimd.core.files.h5md_schema import factors, has_edges
from minimd.core.files.trajectory import checked_output, claimed
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import Cell
from minimd.core.structure.constraints import molecules_of
from minimd.core.structure.elements import Stated
from minimd.core.structure.system import System
from minimd.core.structure.units import ASE
from minimd.core.structure.vectors import upright

ATOMS = "particles/system"
TOPOLOGY = "h5md/modules/gromacs_topology"
NM = 10.0  # Å
VERSION = 0  # of the topology, its first number: another may mean another layout
FAR = 1e9  # nm, or nm/ps
LARGE = 2**31
FRAMES_AT_ONCE = 16  # in a commit
ALL = "SYSTEM"  # type of molecule of what is written
NM_PER_PS = "nm ps-1"
# of what is written
UNITS = {"box/edges": "nm", "position": "nm", "velocity": NM_PER_PS, "force": "kJ mol-1 nm-1"}


class Demanded(NamedTuple):
    """What a dataset must be.
    kind : of NumPy: "f", "i", or "S" for texts.
    shape : a digit, or a letter for each length that is the same in all fields of a file, or of a molecule.
    unit : its attribute.
    least, most : numbers."""

    kind: str
    shape: str
    unit: str = ""
    least: float = 0
    most: float = LARGE


FIELDS = {
    "position/value": Demanded("f", "FN3", "nm", -FAR, FAR),
    "position/step": Demanded("i", "F", "", -np.inf, np.inf),
    "box/edges/value": Demanded("f", "F33", "nm", -FAR, FAR),
    "velocity/value": Demanded("f", "VN3", NM_PER_PS, -FAR, FAR),
    "velocity/step": Demanded("i", "V", "", -np.inf, np.inf),
    "bonds": Demanded("i", "B2"),
    "mass": Demanded("f", "A", "u"),
    "charge": Demanded("f", "A", "e", -LARGE),
    "species": Demanded("i", "A", "", -LARGE),  # negative or 0: not known
    "particle_name": Demanded("i", "A"),
    "particle_name_table": Demanded("S", "P"),
    "residue_id": Demanded("i", "A", "", -LARGE),
    "residue_name": Demanded("i", "A"),
    "residue_name_table": Demanded("S", "R"),
}
OF_MOLECULE = [*FIELDS][6:]


def gromacs_structure(path: Path, source: str) -> tuple[dict[str, Any], Stated]:
    """The last frame of a file of GROMACS: arguments of System in ASE's units, without masses and species, and what the
    file states of the atoms.
    source : in words.

    Raises ValueError if something in it is not as declared in FIELDS.  OSError as opened.
    """
    from ase.data import chemical_symbols

    with opened(path, GROMACS) as h5:
        atoms = _group(h5, ATOMS)
        if "position" not in atoms:
            raise ValueError("it holds no positions; run GROMACS with nstxout > 0")
        sizes: dict[str, int] = {}
        positions = NM * _numbers(atoms, "position/value", sizes, -1)
        step = _numbers(atoms, "position/step", sizes, -1)
        arguments: dict[str, Any] = {"positions": positions, "charges": None, "units": ASE}
        is_periodic = _boundary(atoms)
        vectors = NM * _numbers(atoms, "box/edges/value", sizes, -1)
        arguments["cell"] = Cell.of(vectors, is_periodic) if is_periodic.any() else None
        # of the same step as the positions, or none: they may be written less often
        if "velocity" in atoms and step == _numbers(atoms, "velocity/step", sizes, -1):
            to_own = NM / factors(ASE)["velocities"]
            arguments["velocities"] = to_own * _numbers(atoms, "velocity/value", sizes, -1)
        if "connectivity" in h5:
            bonds = _numbers(_group(h5, "connectivity"), "bonds", {})
            if bonds.size and bonds.max() >= len(positions):
                raise ValueError(f"its bonds name atom {bonds.max()} of {len(positions)}")
            arguments["bonds"] = np.unique(np.sort(bonds, axis=1), axis=0)
        if TOPOLOGY not in h5:
            return arguments, Stated(source, ["X"] * len(positions), positions)
        columns = _columns(_group(h5, TOPOLOGY), len(positions))

    arguments["charges"] = columns["charge"]
    known = dict(enumerate(chemical_symbols[1:], start=1))
    elements = [known.get(number, "") for number in columns["species"].tolist()]
    names = columns["particle_name"].tolist()
    residues = columns["residue_name"].tolist()
    index = columns["residue_index"]
    stated = Stated(source, names, positions, elements, columns["mass"], residues, index)
    texts = (names, elements, residues, columns["residue_id"], columns["molecule"])
    with suppress(UnicodeEncodeError):  # of programs that select atoms by names in ASCII
        arguments["topology"] = np.array(texts, "S").T.astype(str)
    return arguments, stated


def _group(group: h5py.Group, path: str) -> h5py.Group:
    found = group.get(path)
    if not isinstance(found, h5py.Group):
        raise ValueError(f"it has no group {path!r}, which GROMACS 2026 writes")
    return found


def _numbers(
    group: h5py.Group, path: str, sizes: dict[str, int], frame: int | None = None
) -> NDArray[Any]:
    """The numbers or texts of a dataset, or of one frame.
    sizes : lengths by the letters of Demanded.shape; those that are new are added.
    Raises ValueError if they are not as declared."""
    field = FIELDS[path]
    stored = group.get(path)
    name = f"{group.name}/{path}"
    if not isinstance(stored, h5py.Dataset):
        raise ValueError(f"it lacks {name}, which GROMACS 2026 writes")
    kind = "S" if h5py.check_string_dtype(stored.dtype) else stored.dtype.kind
    unit = _text(stored.attrs.get("unit", ""))
    expected = [
        int(letter) if letter.isdigit() else sizes.get(letter, length)
        for letter, length in zip(field.shape, stored.shape, strict=False)
    ]
    is_alike = (kind, unit) == (field.kind, field.unit) and len(stored.shape) == len(field.shape)
    if not (is_alike and expected == list(stored.shape)):
        raise ValueError(
            f"{name} must have type {field.kind!r}, shape {field.shape} and unit {field.unit!r}; it has "
            f"{kind!r}, {stored.shape}, {unit!r}"
        )
    if frame is not None and not len(stored):
        raise ValueError(f"{name} holds no frame")

    sizes.update(zip(field.shape, stored.shape, strict=True))
    values = stored[()] if frame is None else stored[frame]
    if kind == "S":
        return np.array([_text(value) for value in values], str)
    if not ((values >= field.least) & (values <= field.most)).all():
        raise ValueError(f"{name} has numbers outside of {field.least:g} ... {field.most:g}")
    if kind == "i":
        return np.asarray(values).astype(np.int64)
    # the shortest decimals of float32 are those of a topology
    return np.asarray(values).astype(str).astype(np.float64)


def _text(value: Any) -> str:
    return printable(value.decode(errors="replace") if isinstance(value, bytes) else str(value))


def _boundary(atoms: h5py.Group) -> NDArray[np.bool_]:
    """Which directions are periodic (3,)."""
    words = np.atleast_1d(_group(atoms, "box").attrs.get("boundary", ""))
    texts = [_text(word) for word in words.tolist()]
    if len(texts) != 3 or not {*texts} <= {"periodic", "none"}:
        raise ValueError(
            f"the boundary of its box must be 3 words, 'periodic' or 'none', not {texts}"
        )
    return np.array(texts) == "periodic"


def _columns(topology: h5py.Group, n_atoms: int) -> dict[str, NDArray[Any]]:
    """Of each atom (N,): mass, charge, species, names of atom, residue and molecule, residue_id, residue_index."""
    attributes = topology.attrs
    version = np.atleast_1d(attributes.get("version", -1))
    if version[0] != VERSION:
        raise ValueError(f"its topology has version {version[0]}; minimd knows {VERSION}")
    names = [_text(name) for name in np.ravel(attributes.get("molecule_block_names", [])).tolist()]
    counts = np.ravel(attributes.get("molecule_block_counts", []))
    if counts.dtype.kind != "i" or len(counts) != len(names) or (counts < 0).any():
        raise ValueError(f"its topology has {len(names)} blocks of molecules, and counts {counts}")
    types = {name: _molecule(_group(topology, name)) for name in names}
    pairs = [*zip(names, counts.tolist(), strict=True)]
    n_found = sum(len(types[name]["mass"]) * count for name, count in pairs)
    if n_found != n_atoms or not n_atoms:
        raise ValueError(f"its topology has {n_found} atoms, but there are {n_atoms} positions")

    blocks = []
    n_residues = 0
    for name, count in pairs:
        block = {key: np.tile(values, count) for key, values in types[name].items()}
        n_own = int(types[name]["residue_index"][-1]) + 1
        index = block["residue_index"] + n_residues
        index += n_own * np.repeat(np.arange(count), len(types[name]["mass"]))
        block |= {"residue_index": index, "molecule": np.full(len(index), name)}
        if n_own == 1:  # molecules of a type have one number; structure files of GROMACS count them
            block["residue_id"] = index + 1
        n_residues += n_own * count
        blocks.append(block)

    return {key: np.concatenate([block[key] for block in blocks]) for key in blocks[0]}


def _molecule(group: h5py.Group) -> dict[str, NDArray[Any]]:
    """Of each atom of a type of molecule (A,), without its name: see _columns."""
    sizes: dict[str, int] = {}
    columns = {path: _numbers(group, path, sizes) for path in OF_MOLECULE}
    if not sizes["A"]:
        raise ValueError(f"{group.name} has no atoms")
    for key in ("particle_name", "residue_name"):
        index = columns[key]
        table = columns.pop(f"{key}_table")
        if index.max() >= len(table):
            raise ValueError(
                f"{group.name}/{key} has the index {index.max()}; its table has {len(table)} texts"
            )
        columns[key] = table[index]
    number = columns["residue_id"]
    name = columns["residue_name"]
    is_new = (number[1:] != number[:-1]) | (name[1:] != name[:-1])
    columns["residue_index"] = np.cumsum(np.r_[0, is_new])
    return columns


def to_gromacs(run: str | Path, file: str | Path, overwrite: bool = False) -> None:
    """Write all frames of a run as an H5MD file in the layout of GROMACS 2026, in float32:
    to_gromacs("run.h5md", "traj.h5md").

    Positions, velocities and forces, if the run stored them, are in nm, nm/ps and kJ/mol/nm; for reduced numbers 1 σ is
    1 Å and 1 τ is 1 ps, as in other files. A cell in another orientation than that of GROMACS (a along x, b in the xy
    plane) is turned, and the vectors of the atoms with it.

    Masses, charges, elements, names and bonds are in the file, all atoms as one type of molecule; system_from_file
    gives them back.

    run : the .h5md file of a run.
    file : to be written, also an .h5md file.

    Raises ValueError, FileExistsError, OSError as Simulation.run for trajectories, and as read_record.
    """
    contents = read_file(run)
    system = contents.system
    output = checked_output(file, overwrite, (".h5md",))
    basis: NDArray[Any] = np.zeros((3, 3))  # no box
    if has_edges(system.cell):
        from minimd.core.files.turned_cell import Turn

        basis = Turn(system.cell).combination
    claim = claimed(output, overwrite)
    disk = JournaledFile(claim)

    try:
        with h5py.File(disk, "w") as h5:
            put(h5, _description(system) | _topology(system))
            frames = frames_of(run, range(contents.n_frames), system.units)
            for k, frame in enumerate(frames):
                put(h5, _entries(frame, basis @ (frame.cell or system.cell).vectors, system, k))
                if (k + 1) % FRAMES_AT_ONCE == 0:
                    h5.flush()
                    disk.commit()
        disk.commit()
    finally:
        claim.release()


def _entries(frame: Frame, vectors: Array, system: System, k: int) -> dict[str, Item]:
    """Frame k of a file.
    vectors : lattice vectors as GROMACS takes them, but for their orientation [length]; 0 for no box."""
    to = factors(system.units)
    rotation, box = upright(vectors) if vectors.any() else (np.eye(3), vectors)
    arrays = {
        "box/edges": box * to["positions"] / NM,
        "position": frame.positions @ rotation * to["positions"] / NM,
        "velocity": frame.velocities @ rotation * to["velocities"] / NM,
    }
    if frame.forces is not None:
        arrays["force"] = frame.forces @ rotation * to["forces"] * NM
    time = frame.time * system.units.to_picosecond
    items = {
        f"{ATOMS}/position/step": Item(data=np.array([frame.step]), rows=1, first=k),
        f"{ATOMS}/position/time": Item(data=np.array([time]), rows=1, first=k),
    }

    for name, values in arrays.items():
        attributes = {"unit": _fixed(UNITS[name])} if k == 0 else NOTHING
        numbers = np.array([values], np.float32)
        items[f"{ATOMS}/{name}/value"] = Item(attributes, numbers, 1, k)
        if k == 0 and name != "position":
            items[f"{ATOMS}/{name}/step"] = Item(other=f"{ATOMS}/position/step")
            items[f"{ATOMS}/{name}/time"] = Item(other=f"{ATOMS}/position/time")

    return items


def _description(system: System) -> dict[str, Item]:
    """All that does not change: programs, boundary, bonds."""
    boundary = [
        "periodic" if has_edges(system.cell) and flag else "none" for flag in system.cell.pbc
    ]
    first, second = np.array([[1, 1], [1, 0]], np.int32)
    return {
        "h5md": Item({"version": first}),
        "h5md/author": Item({"name": _fixed("N/A")}),
        "h5md/creator": Item({"name": _fixed("minimd"), "version": _fixed(__version__)}),
        "h5md/modules/units": Item({"version": second, "system": _fixed("SI")}),
        f"{ATOMS}/box": Item({"dimension": np.int32(3), "boundary": _fixed(boundary)}),
        "connectivity": Item({"bond_count": np.int64(len(system.bonds))}),
        "connectivity/bonds": Item(data=system.bonds),
    }


def _topology(system: System) -> dict[str, Item]:
    """Masses, charges, elements and names: all atoms are one type of molecule, of which there is one.
    Without a topology of the system residues are its molecules."""
    from ase.data import atomic_numbers

    names = system.species.astype(str)
    elements = np.full(len(names), "") if system.units.is_reduced else names
    molecules = molecules_of(system)
    is_alone = np.bincount(molecules)[molecules] == 1
    residues = np.where(is_alone, names, "MOL")
    numbers = molecules + 1
    if len(system.topology):
        names, elements, residues, numbers, _ = system.topology.T

    columns: dict[str, NDArray[Any]] = {
        "mass": system.masses.astype(np.float32),
        "charge": system.charges.astype(np.float32),
        "species": np.array([atomic_numbers.get(element, 0) for element in elements], np.int32),
        "residue_id": numbers.astype(np.int32),
    }
    for name, texts in (("particle_name", names), ("residue_name", residues)):
        table, index = np.unique(texts, return_inverse=True)
        columns |= {name: index.astype(np.int32), f"{name}_table": _fixed(table)}
    one = {
        "version": np.array([VERSION, 1], np.int32),
        "molecule_block_counts": np.array([1], np.int32),
    }
    items = {
        TOPOLOGY: Item(one | {"molecule_block_names": _fixed([ALL])}),
        f"{TOPOLOGY}/{ALL}": Item({"particle_count": np.int64(len(names))}),
    }
    for name, values in columns.items():
        unit = FIELDS[name].unit
        items[f"{TOPOLOGY}/{ALL}/{name}"] = Item(
            {"unit": _fixed(unit)} if unit else NOTHING, values
        )

    return items


def _fixed(texts: str | list[str] | NDArray[np.str_]) -> NDArray[np.bytes_]:
    """Texts as GROMACS stores them, each of the same length and ended by a zero byte."""
    encoded = np.char.encode(texts, "utf-8")
    return encoded.astype(h5py.string_dtype("utf-8", encoded.itemsize + 1))
