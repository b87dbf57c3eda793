"""What a minimd file holds of a run: one declaration of the type, shape and range of each array and number of a
restart, and of each series of frames.

Whoever writes a file can make its checksums right, and kernels index arrays without looking at their ends. Therefore
everything is compared with this declaration before it is used. What is not declared is damage, and so is what is
missing.
"""

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import LARGEST, SMALLEST

REAL, WHOLE, BYTE = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.uint8)
VECTOR, TENSOR = (3,), (3, 3)
MOST_STEPS = 2.0**62  # so that steps can still be added
ANY = -1  # any length along an axis
NUMBERED = re.compile(r"(?<=list_)\d+|(?<=^beside\.)\d+")  # lists, and other trajectories
OF_OBSERVER = re.compile(r"observer\.[^.]+\.[^.]+")


class Stored(NamedTuple):
    """What an array or a number must be.

    kind : its type; a single number may be of either type of NumPy's numbers.
    shape : with N for atoms, K for rigid bonds, L for lists.  least, most : of its elements, all of them finite.
    is_needed : whether a file without it is damaged.
    """

    kind: np.dtype
    shape: tuple[int | str, ...] = ()
    least: float = -LARGEST
    most: float = LARGEST
    is_needed: bool = False

    def problem(self, value: Any, sizes: Mapping[str, int]) -> str:
        """What is wrong with a value, in words; empty if nothing is."""
        array = np.asarray(value)
        shape = [sizes[length] if isinstance(length, str) else length for length in self.shape]
        kinds = (self.kind,) if self.shape else (REAL, WHOLE)
        lengths = [there if length == ANY else length for length, there in zip(shape, array.shape, strict=False)]
        if array.dtype not in kinds or array.shape != (*lengths, *shape[array.ndim :]):
            return f"is of type {array.dtype} and shape {array.shape}"
        if not ((array >= self.least) & (array <= self.most)).all():
            return "is out of range"
        return "is no whole number" if self.kind == WHOLE and (array % 1 != 0).any() else ""


PLACES = Stored(REAL, ("N", 3), is_needed=True)
LATTICE, COMBINATIONS = Stored(REAL, (3, 3)), Stored(WHOLE, (3, 3), -1e9, 1e9)
NUMBER, SIZE = Stored(REAL, is_needed=True), Stored(REAL, (), 0.0, is_needed=True)
STEP, COUNT = Stored(WHOLE, (), -MOST_STEPS, MOST_STEPS, True), Stored(WHOLE, (), 0.0, MOST_STEPS, True)
ARRAYS = {  # of a restart; observers look at their own
    "positions": PLACES,
    "velocities": PLACES,
    "images": Stored(REAL, ("K", 3)),
    "cell": LATTICE,
    "cell_reduction": COMBINATIONS,
    "list_#": Stored(REAL, ("N", 3)),
    "cell_of_list_#": LATTICE,
    "cell_of_list_#_reduction": COMBINATIONS,
    "region_of_list_#": Stored(REAL, (7,)),
    "beside.#": Stored(BYTE, (ANY,), 0, 255),
}
NUMBERS = {  # of a restart; older files have no work
    "step": STEP,
    "time": NUMBER,
    "reservoir_energy": NUMBER,
    "work": Stored(REAL),
    "displacement": SIZE,
    "equilibrated": COUNT,
    "clock_step": STEP,
    "clock_time": NUMBER,
    "tolerance": Stored(REAL, (), 0.0, 1.0, True),
    "skins": Stored(REAL, ("L",), 0.0, is_needed=True),
    "grid": Stored(REAL, (3,), SMALLEST),
    "n_frames": Stored(WHOLE, (), 0.0, MOST_STEPS),  # the start of a crash file has none
}

SINGLE = ["potential_energy", "kinetic_energy", "total_energy", "conserved_energy", "temperature", "pressure", "work"]
FRAMES = {  # of a frame; observables that scripts have registered may be anything
    **{f"particles/trajectory/{name}/value": ("N", 3) for name in ("position", "velocity", "force")},
    "particles/trajectory/box/edges/value": TENSOR,
    **{f"observables/{name}/value": () for name in SINGLE},
    **{f"observables/{name}/value": VECTOR for name in ("momentum", "angular_momentum")},
    **{f"observables/{name}/value": TENSOR for name in ("cell", "stress")},
}


def check_restart(arrays: Mapping[str, np.ndarray], numbers: Mapping[str, Any], n_atoms: int, n_bonds: int) -> None:
    """Raise ValueError unless a restart is of the kind that is declared.  n_bonds : lengths that are held fixed."""
    sizes = {"N": n_atoms, "K": n_bonds, "L": np.size(numbers.get("skins", ()))}
    _check_declared({name: one for name, one in arrays.items() if not OF_OBSERVER.fullmatch(name)}, ARRAYS, sizes)
    _check_declared(numbers, NUMBERS, sizes)
    if ("images" in arrays) != (n_bonds > 0):
        raise ValueError(f"it has {n_bonds} rigid bonds, and images of {len(arrays.get('images', ()))}")
    cells = {name.removesuffix("_reduction") for name in arrays if name.startswith("cell")}
    for name in sorted(cells):
        _check_cell(name, arrays[name], arrays[f"{name}_reduction"])
    for name, region in arrays.items():
        if name.startswith("region_of_list_") and not (region[3:] >= SMALLEST).all():
            raise ValueError(f"{name} is out of range")


def _check_declared(values: Mapping[str, Any], fields: Mapping[str, Stored], sizes: Mapping[str, int]) -> None:
    """Raise ValueError unless values are all that fields declare, and nothing else."""
    for name in {name for name, field in fields.items() if field.is_needed} | set(values):
        field = fields.get(NUMBERED.sub("#", name))
        is_beyond = "list_" in name and int(NUMBERED.findall(name)[0]) >= sizes["L"]
        if field is None or name not in values or is_beyond:
            raise ValueError(f"{name} is missing, or unknown")
        if problem := field.problem(values[name], sizes):
            raise ValueError(f"{name} {problem}")


def _check_cell(name: str, vectors: np.ndarray, reduction: np.ndarray) -> None:
    """Raise ValueError unless the vectors span a cell, and the reduction gives its reduced lattice."""
    Cell(vectors, np.ones(3, dtype=bool))
    reduced = Cell.of_reduction(vectors, reduction).strained(vectors)
    spans_lattice = round(abs(np.linalg.det(reduction))) == 1
    if not (spans_lattice and np.array_equal(reduced.reduction, reduction)):
        raise ValueError(f"{name}_reduction does not give the reduced lattice of {name}")


def check_frames(series: Mapping[str, Any], n_atoms: int) -> None:
    """Raise ValueError unless series of frames, by path, are numbers of the declared shapes."""
    for path, values in series.items():
        is_free = path.startswith("observables/") and path not in FRAMES
        shape = tuple(n_atoms if length == "N" else length for length in FRAMES.get(path, ()))
        if not is_free and (values.dtype not in (REAL, WHOLE) or values.shape[1:] != shape):
            raise ValueError(f"{path} is of type {values.dtype} and shape {values.shape}")
