"""The restart in a minimd file: all that the next steps depend on, to the last bit, with a checksum;
and the restart before it.

minimd/restart, minimd/earlier_restart    the datasets and attributes of flattened(), the number n_frames of frames, and
                                          the digest of them all

The older of the two is overwritten, then the two exchange their names: if one is damaged,
the run goes on from the other.
"""

import zlib
from itertools import count
from typing import Any

import h5py
import numpy as np

from minimd.engine.engine import Checkpoint, Snapshot
from minimd.neighbors.verlet_list import Built
from minimd.structure.cell import Cell
from minimd.structure.grid import Grid

RESTART, EARLIER, SPARE = "minimd/restart", "minimd/earlier_restart", "minimd/spare"
DIGEST = "digest"


def flattened(checkpoint: Checkpoint) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """A checkpoint as named arrays and numbers. Arrays that it does not have are left out."""
    state, images = checkpoint.state, checkpoint.images
    arrays: dict[str, np.ndarray | None] = {"positions": state.positions, "velocities": state.velocities}
    arrays["images"] = None if images is None else images[0]
    for k, one in enumerate(checkpoint.lists):
        arrays |= {f"list_{k}": one.positions, f"region_of_list_{k}": one.region}
    for name, cell in [
        ("cell", state.cell),
        *((f"cell_of_list_{k}", one.cell) for k, one in enumerate(checkpoint.lists)),
    ]:
        arrays |= {} if cell is None else {name: cell.vectors, f"{name}_reduction": cell.reduction}
    numbers: dict[str, Any] = {
        "step": state.step,
        "time": state.time,
        "reservoir_energy": state.reservoir_energy,
        "displacement": checkpoint.displacement,
    }
    clock = state.clock or (state.step, state.time)
    numbers["work"] = state.work
    numbers |= {"clock_step": clock[0], "clock_time": clock[1], "equilibrated": checkpoint.equilibrated}
    numbers |= {
        "skins": np.array([one.skin for one in checkpoint.lists]),
        "tolerance": 0.0 if images is None else images[1],
    }
    if checkpoint.grid is not None:
        numbers["grid"] = np.array([checkpoint.grid.length, checkpoint.grid.momentum, checkpoint.grid.energy])
    return {name: array for name, array in arrays.items() if array is not None}, numbers


def unflattened(arrays: dict[str, np.ndarray], numbers: dict[str, Any]) -> Checkpoint:
    """The checkpoint with these flattened arrays and numbers."""
    step, time, energy = int(numbers["step"]), float(numbers["time"]), float(numbers["reservoir_energy"])
    lists = tuple(
        Built(
            float(skin), arrays.get(f"list_{k}"), _cell(arrays, f"cell_of_list_{k}"), arrays.get(f"region_of_list_{k}")
        )
        for k, skin in enumerate(numbers["skins"])
    )
    clock, moving = (
        (int(numbers["clock_step"]), float(numbers["clock_time"])),
        (arrays["positions"], arrays["velocities"]),
    )
    return Checkpoint(
        state=Snapshot(step, time, *moving, energy, clock, float(numbers.get("work", 0.0)), _cell(arrays, "cell")),
        displacement=float(numbers["displacement"]),
        lists=lists,
        images=(arrays["images"], float(numbers["tolerance"])) if "images" in arrays else None,
        equilibrated=int(numbers["equilibrated"]),
        grid=Grid(*map(float, numbers["grid"])) if "grid" in numbers else None,
    )


def _cell(arrays: dict[str, np.ndarray], name: str) -> Cell | None:
    return Cell.of_reduction(arrays[name], arrays[f"{name}_reduction"]) if name in arrays else None


def write_restart(
    h5: h5py.File, checkpoint: Checkpoint, n_frames: int, beside: dict[str, np.ndarray] | None = None
) -> None:
    """Write the newest restart; the one before becomes the earlier restart.  beside : arrays that are kept with it."""
    older = EARLIER if EARLIER in h5 else SPARE
    arrays, numbers = flattened(checkpoint)
    write_group(h5.require_group(older), arrays | (beside or {}), numbers | {"n_frames": n_frames})
    if older != SPARE:
        h5.move(older, SPARE)
    if RESTART in h5:
        h5.move(RESTART, EARLIER)
    h5.move(SPARE, RESTART)


def read_restart(h5: h5py.File) -> tuple[Checkpoint, int, bool]:
    """The newest restart that is intact, the number of frames in the file at that time,
    and whether it is the earlier restart.

    Raises ValueError if both restarts are damaged.
    """
    for name in (RESTART, EARLIER):
        if (found := _whole(h5, name)) is not None:
            return *found, name == EARLIER
    raise ValueError("its restart is damaged")


def arrays_of_restart(h5: h5py.File) -> dict[str, np.ndarray]:
    """All arrays of the restart that read_restart finds, with those that are kept with it;
    none if both restarts are damaged."""
    name = next((name for name in (RESTART, EARLIER) if _whole(h5, name) is not None), None)
    return {} if name is None else read_group(h5[name])[0]


def damaged_restart(h5: h5py.File) -> str:
    """The damaged restart in words; empty if there is none. After a single commit a file has no earlier restart."""
    if _whole(h5, RESTART) is None:
        return "numbers of the newest restart"
    return "numbers of the restart before the newest" if EARLIER in h5 and _whole(h5, EARLIER) is None else ""


def set_aside_damaged(h5: h5py.File) -> None:
    """Rename damaged restarts. They are not deleted: the bytes that they claim as theirs may belong to other data."""
    for name in (RESTART, EARLIER, SPARE):
        if h5.get(name, getlink=True) is not None and _whole(h5, name) is None:
            h5.move(name, next(free for k in count(1) if h5.get(free := f"{name}_damaged_{k}", getlink=True) is None))


def _whole(h5: h5py.File, name: str) -> tuple[Checkpoint, int] | None:
    """A restart, and the number of frames in the file at that time; None if it is damaged."""
    try:
        arrays, numbers = read_group(h5[name])
        return unflattened(arrays, numbers), int(numbers["n_frames"])
    except MemoryError:
        raise
    except Exception:  # HDF5 and h5py raise almost anything for bytes they do not expect
        return None


def write_group(group: h5py.Group, arrays: dict[str, np.ndarray], numbers: dict[str, Any]) -> None:
    """Write arrays, numbers and their digest into a group, in place of its contents."""
    for name in [name for name in group if name not in arrays]:
        del group[name]
    for name, array in arrays.items():
        if name in group and group[name].shape != array.shape:
            del group[name]
        group.require_dataset(name, array.shape, array.dtype)[...] = array
    for name, number in numbers.items():
        value = np.asarray(number, dtype=np.int64 if isinstance(number, int) else np.float64)
        if name in group.attrs and group.attrs[name].shape == value.shape:
            group.attrs.modify(name, value)
        else:
            group.attrs[name] = value
    group.attrs[DIGEST] = np.uint32(digest_of(arrays, numbers))


def read_group(group: h5py.Group) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and numbers as write_group wrote them.  Raises ValueError if their digest is wrong."""
    arrays, numbers = {name: group[name][()] for name in group}, dict(group.attrs)
    if digest_of(arrays, numbers) != numbers.pop(DIGEST, None):
        raise ValueError(f"{group.name} is damaged")
    return arrays, numbers


def digest_of(arrays: dict[str, np.ndarray], numbers: dict[str, Any]) -> int:
    """CRC-32 of the names, types and bytes of arrays and numbers."""
    digest = 0
    for name in sorted(arrays):
        digest = digest_of_array(name, arrays[name], digest)
    for name in sorted(set(numbers) - {DIGEST}):
        digest = zlib.crc32(np.asarray(numbers[name], dtype=np.float64).tobytes(), zlib.crc32(name.encode(), digest))
    return digest


def digest_of_array(name: str, array: np.ndarray, digest: int = 0) -> int:
    """CRC-32 of the name, type, shape and bytes of an array, continuing a digest."""
    return zlib.crc32(
        np.ascontiguousarray(array).data, zlib.crc32(f"{name} {array.dtype.str} {array.shape}".encode(), digest)
    )
