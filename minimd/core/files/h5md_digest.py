"""Restart, observers, frames and description of a minimd file, each with a checksum that shows whether its numbers are
those that were written.

minimd/restart            all that the next steps depend on, to the last bit: the arrays and numbers of flattened() as
                          datasets and attributes, the number n_frames of frames, and the CRC-32 of them all;
                          observer.<name>.* are the arrays of the state of an observer
minimd/earlier_restart    the restart before it. The older of the two is overwritten, then the two exchange their names:
                          if one is damaged, the run goes on from the other
minimd/observers/<name>   attributes kind and arguments (JSON); at the end of a run the result: a dataset for each
                          series and for its standard error, and single numbers as attributes, in the units of the
                          simulation (attribute units)
minimd/blocks             (B, 2) a row for each block of frames: the number of frames up to its end, and the CRC-32 of
                          the block; the attribute series names the datasets that grow with the frames
minimd, attribute digest  the CRC-32 of everything that does not change: names, types, attributes, and arrays
                          that do not grow

Types are part of every checksum: the same bytes in another order are other numbers.

H5MD keeps averages that do not depend on time as groups in observables. The reader of MDAnalysis takes everything there
for series with an entry for each frame, and refuses a file in which that is not so. Therefore minimd keeps the results
of observers in its own group.
"""

import json
import zlib
from collections.abc import Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from minimd.core.console.annexes import from_annex
from minimd.core.console.quiet import warn
from minimd.core.console.words import listed, shown
from minimd.core.engine.observer import StoredObserver
from minimd.core.engine.snapshot import Checkpoint, Snapshot
from minimd.core.files.h5_items import NOTHING, REFERENCE, Item, put
from minimd.core.files.stored_fields import FIELDS, STEPS, check_fields
from minimd.core.neighbors.verlet_list import Built
from minimd.core.structure.cell import Cell
from minimd.core.structure.grid import Grid

RESTART = "minimd/restart"
EARLIER = "minimd/earlier_restart"
SPARE = "minimd/spare"
OBSERVERS = "minimd/observers"
MARK = "observer."
BLOCKS = "minimd/blocks"
DIGEST = "digest"
# groups; but for the above, they do not change
FIXED = ("h5md", "particles", "observables", "connectivity", "minimd")

Arrays = dict[str, np.ndarray]  # by name
Numbers = dict[str, Any]
# device and inode of the files whose observers a warning has named in this process: a run in many parts warns once
WARNED: set[tuple[int, int]] = set()


class Restart(NamedTuple):
    """A restart that is intact.
    n_frames : in the file at that time.
    arrays : all of it, with those that are kept beside the checkpoint.
    is_earlier : whether it is the earlier restart, because the newest is damaged."""

    checkpoint: Checkpoint
    n_frames: int
    arrays: Arrays
    is_earlier: bool

    def states(self) -> dict[str, Arrays]:
        """The state of each observer, by its name."""
        states: dict[str, Arrays] = {}
        for name, array in self.arrays.items():
            if name.startswith(MARK):
                _, observer, key = name.split(".")
                states.setdefault(observer, {})[key] = array
        return states


def flattened(checkpoint: Checkpoint) -> tuple[Arrays, Numbers]:
    """A checkpoint as named arrays and numbers. Arrays that it does not have are left out."""
    state = checkpoint.state
    lists = checkpoint.lists
    images, tolerance = checkpoint.images or (None, 0.0)
    clock = state.clock or (state.step, state.time)
    arrays: dict[str, Any] = {
        "positions": state.positions,
        "velocities": state.velocities,
        "images": images,
        "memory": state.memory,
    }
    cells = {"cell": state.cell}
    cells |= {f"cell_of_list_{k}": built.cell for k, built in enumerate(lists)}
    for name, cell in cells.items():
        if cell is not None:
            arrays |= {name: cell.vectors, f"{name}_reduction": cell.reduction}
    for k, built in enumerate(lists):
        arrays |= {f"list_{k}": built.positions, f"region_of_list_{k}": built.region}
    numbers: Numbers = {
        "step": state.step,
        "time": state.time,
        "reservoir_energy": state.reservoir_energy,
        "work": state.work,
        "displacement": checkpoint.displacement,
        "equilibrated": checkpoint.equilibrated,
        "clock_step": clock[0],
        "clock_time": clock[1],
        "tolerance": tolerance,
        "skins": np.array([built.skin for built in lists]),
    }
    if checkpoint.grid is not None:
        numbers["grid"] = np.array([*vars(checkpoint.grid).values()])
    return {name: array for name, array in arrays.items() if array is not None}, numbers


def unflattened(arrays: Arrays, numbers: Numbers) -> Checkpoint:
    """The checkpoint with these flattened arrays and numbers; older files have no work."""
    state = Snapshot(
        step=int(numbers["step"]),
        time=float(numbers["time"]),
        positions=arrays["positions"],
        velocities=arrays["velocities"],
        reservoir_energy=float(numbers["reservoir_energy"]),
        clock=(int(numbers["clock_step"]), float(numbers["clock_time"])),
        work=float(numbers.get("work", 0.0)),
        cell=_stored_cell(arrays, "cell"),
        memory=arrays.get("memory"),
    )
    lists = [
        Built(
            float(skin),
            arrays.get(f"list_{k}"),
            _stored_cell(arrays, f"cell_of_list_{k}"),
            arrays.get(f"region_of_list_{k}"),
        )
        for k, skin in enumerate(numbers["skins"])
    ]
    images = None
    if len(arrays.get("images", ())):
        images = arrays["images"], float(numbers["tolerance"])
    return Checkpoint(
        state,
        displacement=float(numbers["displacement"]),
        lists=tuple(lists),
        images=images,
        equilibrated=int(numbers["equilibrated"]),
        grid=Grid(*map(float, numbers["grid"])) if "grid" in numbers else None,
    )


def _stored_cell(arrays: Arrays, name: str) -> Cell | None:
    if name not in arrays:
        return None
    cell = Cell.of_reduction(arrays[name], arrays[f"{name}_reduction"])
    n = cell.dimensions
    if round(abs(np.linalg.det(cell.reduction[:n, :n]))) != 1:
        raise ValueError(f"{name}_reduction gives another lattice than {name}")
    return cell.strained(cell.vectors)  # reduced, whatever the file says


def write_restart(
    h5: h5py.File,
    checkpoint: Checkpoint,
    n_frames: int,
    observers: Sequence[StoredObserver] = (),
    beside: Mapping[str, np.ndarray] = NOTHING,
) -> None:
    """Write the newest restart; the one before becomes the earlier restart.
    beside : arrays that are kept with it."""
    older = EARLIER if EARLIER in h5 else SPARE
    arrays, numbers = flattened(checkpoint)
    for observer in observers:
        for key, part in observer.state().items():
            arrays[f"{MARK}{observer.name}.{key}"] = np.asarray(part)
    arrays |= beside
    numbers["n_frames"] = n_frames
    group = h5.require_group(older)
    for name in list(group):
        if name not in arrays or group[name].shape != arrays[name].shape:
            del group[name]
    put(h5, checked(older, arrays, numbers))
    if older != SPARE:
        h5.move(older, SPARE)
    if RESTART in h5:
        h5.move(RESTART, EARLIER)
    h5.move(SPARE, RESTART)


def read_restart(h5: h5py.File) -> Restart:
    """The newest restart that is intact.
    Raises ValueError if both are damaged."""
    for name in (RESTART, EARLIER):
        restart = _intact(h5, name)
        if restart is not None:
            return restart
    raise ValueError("its restart is damaged")


def damaged_restart(h5: h5py.File) -> str:
    """The damaged restart in words; empty if there is none. After a single commit a file has no earlier restart."""
    if _intact(h5, RESTART) is None:
        return "numbers of the newest restart"
    if EARLIER in h5 and _intact(h5, EARLIER) is None:
        return "numbers of the restart before the newest"
    return ""


def set_aside_damaged(h5: h5py.File) -> None:
    """Rename damaged restarts. They are not deleted: the bytes that they claim as theirs may belong to other data."""
    for name in (RESTART, EARLIER, SPARE):
        if _is_there(h5, name) and _intact(h5, name) is None:
            names = (f"{name}_damaged_{k}" for k in count(1))
            h5.move(name, next(free for free in names if not _is_there(h5, free)))


def _is_there(h5: h5py.File, name: str) -> bool:
    return h5.get(name, getlink=True) is not None


def _intact(h5: h5py.File, name: str) -> Restart | None:
    """The restart of a name; None if it is damaged."""
    try:
        arrays, numbers = read_group(h5[name])
        if STEPS in h5 and numbers["step"] < h5[STEPS][0]:
            return None  # frames of a run begin with it
        checkpoint = unflattened(arrays, numbers)
        return Restart(checkpoint, int(numbers["n_frames"]), arrays, name == EARLIER)
    except MemoryError:
        raise
    except Exception:  # HDF5 and h5py raise almost anything for bytes they do not expect
        return None


def checked(
    path: str, arrays: Mapping[str, np.ndarray], numbers: Mapping[str, Any]
) -> dict[str, Item]:
    """A group of arrays, numbers, and their digest."""
    attributes = {
        name: np.asarray(number, np.int64 if isinstance(number, int) else np.float64)
        for name, number in numbers.items()
    }
    attributes[DIGEST] = np.asarray(digest_of(arrays, numbers), np.uint32)
    datasets = {f"{path}/{name}": Item(data=array) for name, array in arrays.items()}
    return {path: Item(attributes)} | datasets


def read_group(group: h5py.Group) -> tuple[Arrays, Numbers]:
    """Arrays and numbers of a restart, as in checked.
    Raises ValueError if their digest is wrong, or if they are not of the kinds that are declared."""
    arrays = {name: group[name][()] for name in group}
    numbers = dict(group.attrs)
    if digest_of(arrays, numbers) != numbers.pop(DIGEST, None):
        raise ValueError(f"{group.name} is damaged")
    check_fields([*arrays.items(), *numbers.items()], group.file["minimd"])
    return arrays, numbers


def digest_of(arrays: Mapping[str, np.ndarray], numbers: Mapping[str, Any] = NOTHING) -> int:
    """CRC-32 of the names, types, shapes and bytes of arrays, and of the names and bytes of numbers."""
    digest = 0
    for name, array in sorted(arrays.items()):
        digest = zlib.crc32(f"{name} {array.dtype.str} {array.shape}".encode(), digest)
        digest = zlib.crc32(np.ascontiguousarray(array).data, digest)
    for name in sorted(set(numbers) - {DIGEST}):
        digest = zlib.crc32(name.encode(), digest)
        digest = zlib.crc32(np.asarray(numbers[name], dtype=np.float64).tobytes(), digest)
    return digest


def of_observers(observers: Sequence[StoredObserver]) -> dict[str, Item]:
    """The arguments of the observers."""
    return {
        f"{OBSERVERS}/{observer.name}": Item(
            {"kind": observer.kind, "arguments": json.dumps(observer.made_with())}
        )
        for observer in observers
    }


def restore_observers(
    h5: h5py.File, file: str | Path, restart: Restart, observers: Sequence[StoredObserver]
) -> None:
    """Give observers that have not looked yet the state that the file holds for them.

    Raises ValueError if the file holds an observer of the same name with other arguments, or in a state of another
    convention. Warns of observers in the file that the run does not have, once for each file.
    """
    stored = h5.get(OBSERVERS, {})
    states = restart.states()

    for observer in observers:
        if observer.name not in stored:
            continue
        was = json.loads(stored[observer.name].attrs["arguments"])
        now = json.loads(json.dumps(observer.made_with()))
        state = states.get(observer.name, {})
        if was != now and observer.can_restore(state):  # else restore tells of its convention
            raise ValueError(
                f"file {str(file)!r} holds the observer {observer.name} with the arguments {was}; "
                "use the same arguments, or pass another name="
            )

        if not observer.n_looks:
            observer.restore(state)

    others = set(stored) - {observer.name for observer in observers}
    place = Path(file).stat()
    inode = place.st_dev, place.st_ino
    if others and inode not in WARNED:
        WARNED.add(inode)
        warn(
            f"file {str(file)!r} holds the observers {listed(sorted(others))}, which this run does not continue; "
            "to continue them, pass them as observers=[...]; later runs in this file do not repeat this warning"
        )


def write_answers(h5: h5py.File, observers: Sequence[StoredObserver]) -> None:
    """Write the results of the observers that have looked, in place of those in the file."""
    for observer in observers:
        group = h5[f"{OBSERVERS}/{observer.name}"]
        for name in list(group):
            del group[name]
        if observer.n_looks:
            result = observer.result()
            looks = {"n_looks": observer.n_looks, "last_step": observer.last_step}
            group.attrs.update({**looks, "units": result.scene.units, **result.numbers()})
            for name, series in result.columns().items():
                # HDF5 allows no slash in names, that of a species may contain one
                group[name.replace("/", "_")] = series


def observers_of(h5: h5py.File, restart: Restart) -> dict[str, StoredObserver]:
    """The observers in an open file, by name, in their state at the restart;
    new ones where the convention of the state is another. A warning tells those of a kind that is not known here."""
    stored = h5.get(OBSERVERS, {})
    kinds = from_annex("observers by kind") if stored else {}
    states = restart.states()
    observers: dict[str, StoredObserver] = {}
    unknown: list[str] = []

    for name, group in stored.items():
        arguments: dict[str, Any] = json.loads(group.attrs["arguments"])
        kind = str(group.attrs["kind"])
        if kind not in kinds:
            unknown.append(f"{shown(name)} of the kind {shown(kind)}")
            continue
        state = states.get(name, {})
        try:
            observer = kinds[kind](**arguments)
            if observer.can_restore(state):
                observer.restore(state)
        except MemoryError:
            raise ValueError(
                f"observer {name} asks for more memory than there is, by {shown(arguments)}"
            ) from None

        observers[name] = observer

    if unknown:
        warn(
            f"observers of unknown kinds are left out: {', '.join(unknown[:5])}; "
            "to read them, register their classes: minimd.observers.KINDS[kind] = ..."
        )

    return observers


def add_block(h5: h5py.File, n_frames: int, entries: Arrays) -> None:
    """Append the row of a block: n_frames frames are now in the file; entries : of the frames of the block,
    by the paths of their series."""
    # a block that is written again replaces its row
    row = int(np.searchsorted(h5[BLOCKS][:, 0], n_frames)) if BLOCKS in h5 else 0
    attributes = NOTHING if row else {"series": sorted(entries)}
    put(h5, {BLOCKS: Item(attributes, np.array([[n_frames, digest_of(entries)]]), 64, row)})


def _series_of_blocks(h5: h5py.File) -> dict[str, h5py.Dataset]:
    return {path: h5[path] for path in h5[BLOCKS].attrs["series"]}


def damaged_frames(h5: h5py.File) -> str:
    """The frames that are not as they were written, in words; empty if there are none."""
    series = _series_of_blocks(h5)
    first = 0
    for last, digest in h5[BLOCKS][:].tolist():
        entries = {path: values[first:last] for path, values in series.items()}
        if last <= first or digest_of(entries) != digest:
            return f"frames {first} to {last - 1}"
        first = last
    return ""


def drop_frames(h5: h5py.File, n_frames: int) -> None:
    """Keep the first n_frames frames, and remove the others."""
    blocks = h5[BLOCKS]
    series = _series_of_blocks(h5)
    for values in series.values():
        values.resize(n_frames, axis=0)
    blocks.resize(int(np.searchsorted(blocks[:, 0], n_frames, side="right")), axis=0)
    first = n_whole_frames(h5)
    if first < n_frames:
        add_block(h5, n_frames, {path: values[first:] for path, values in series.items()})


def n_whole_frames(h5: h5py.File) -> int:
    """The number of frames in the file that have a checksum."""
    return int(h5[BLOCKS][-1, 0]) if BLOCKS in h5 and len(h5[BLOCKS]) else 0


def sign(h5: h5py.File, written: Mapping[str, Item] = NOTHING) -> None:
    """Store the digest of everything that does not change.
    written : all of it, which then is not read."""
    h5["minimd"].attrs[DIGEST] = np.uint32(_digest_of_description(h5, written))


def check_description(h5: h5py.File) -> None:
    """Raise ValueError unless the description is the one that was signed, and series of frames have the declared shapes
    and one length."""
    if h5["minimd"].attrs.get(DIGEST) != _digest_of_description(h5):
        raise ValueError("the checksum of the stored description of the run does not match")
    series = {path: h5[path] for path in FIELDS if path in h5}
    entries = {
        path: np.broadcast_to(np.zeros((), values.dtype), values.shape[1:])
        for path, values in series.items()
    }
    check_fields(entries.items(), h5["minimd"])
    observed = [h5[f"observables/{name}/value"] for name in h5["observables"]]
    lengths = {len(values) for values in (*observed, *series.values())}
    if lengths - {n_whole_frames(h5)}:
        raise ValueError("its series of frames differ in length")


def _digest_of_description(h5: h5py.File, written: Mapping[str, Item] = NOTHING) -> int:
    """CRC-32 of names, attributes and contents of everything that does not change, in order.
    written : as in sign."""
    names: dict[str, bool] = {}  # False for a second name of an item that is visited under another

    for path in FIXED:
        group = h5[path]
        names[path] = True
        # a visit stops if the function returns anything but None
        group.visit_links(lambda name, path=path: names.update({f"{path}/{name}": False}))
        group.visit(lambda name, path=path: names.update({f"{path}/{name}": True}))

    digest = 0

    for name, is_first in sorted(names.items()):
        if name == BLOCKS or name.startswith((RESTART, EARLIER, SPARE)):
            continue
        item = Item()
        if is_first:
            item = written.get(name, item) if written else _described(h5[name])
        item = written.get(item.other, item)
        digest = zlib.crc32(name.encode(), digest)
        for key in sorted(set(item.attributes) - {DIGEST, REFERENCE}):
            attribute = (key, np.asarray(item.attributes[key]).tolist())
            digest = zlib.crc32(repr(attribute).encode(), digest)
        data = item.data
        if data is not None:
            layout = (data.shape[bool(item.rows) :], data.dtype.str)
            digest = zlib.crc32(repr(layout).encode(), digest)
            if not item.rows:
                is_text = data.dtype.kind == "O"
                content = repr(data.tolist()).encode() if is_text else data.tobytes()
                digest = zlib.crc32(content, digest)

    return digest


def _described(stored: h5py.Group | h5py.Dataset) -> Item:
    """What is in a file, as an item; series that grow with the frames are left empty."""
    if isinstance(stored, h5py.Group):
        return Item(stored.attrs)
    if stored.maxshape[:1] == (None,):
        return Item(stored.attrs, np.empty((0, *stored.shape[1:]), stored.dtype), rows=1)
    return Item(stored.attrs, np.asarray(stored[()], stored.dtype))
