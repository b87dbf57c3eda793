"""What a minimd file holds of a run: one declaration of the shape, range and type of each array and number of a
restart, and of each entry of the series of frames.

Whoever writes a file can make its checksums right, and kernels index arrays without looking at their ends. Therefore
everything is compared with this declaration before it is used; what is not declared is damage.
"""

import re
from collections.abc import Iterable
from typing import Any, NamedTuple

import h5py
import numpy as np

from minimd.core.structure.checks import LARGEST, SMALLEST

REAL = np.dtype(np.float64)
WHOLE = np.dtype(np.int64)
MOST_STEPS = 2.0**62  # so that steps can still be added


class Stored(NamedTuple):
    """What an array or a number must be.

    shape : with N for atoms, K for rigid bonds, and * for any length.
    least, most : of its elements, all of them finite.
    kind : its type; a single number may be of either type of NumPy's numbers.
    """

    shape: tuple[Any, ...] = ()
    least: Any = -LARGEST
    most: float = LARGEST
    kind: np.dtype = REAL


STEPS = "particles/trajectory/position/step"  # of frames
UNKNOWN = Stored((-1,))  # no array is so
NUMBER = Stored()
STEP = Stored((), -MOST_STEPS, MOST_STEPS, WHOLE)
COUNT = Stored((), 0.0, MOST_STEPS, WHOLE)
VECTOR = Stored((3,))
VECTORS = Stored(("N", 3))
TENSOR = Stored((3, 3))
COMBINATIONS = Stored((3, 3), -1e9, 1e9, WHOLE)
FIELDS = {
    # a restart
    "positions": VECTORS,
    "velocities": VECTORS,
    "images": Stored(("K", 3)),
    "memory": Stored(("*",)),
    "cell": TENSOR,
    "cell_reduction": COMBINATIONS,
    "list_#": VECTORS,
    "cell_of_list_#": TENSOR,
    "cell_of_list_#_reduction": COMBINATIONS,
    "region_of_list_#": Stored((7,), [-LARGEST] * 3 + [SMALLEST] * 4),
    "beside.#": Stored(("*",), 0, 255, np.dtype(np.uint8)),
    "step": STEP,
    "time": NUMBER,
    "reservoir_energy": NUMBER,
    "work": NUMBER,
    "displacement": Stored((), 0.0),
    "equilibrated": COUNT,
    "clock_step": STEP,
    "clock_time": NUMBER,
    "tolerance": Stored((), 0.0, 1.0),
    "skins": Stored(("*",), 0.0),
    "grid": Stored((3,), SMALLEST),
    "n_frames": COUNT,
    # frames; observables of scripts may be anything
    "minimd/time": NUMBER,
    STEPS: STEP,
    "particles/trajectory/position/time": NUMBER,
    "particles/trajectory/position/value": VECTORS,
    "particles/trajectory/velocity/value": VECTORS,
    "particles/trajectory/force/value": VECTORS,
    "particles/trajectory/box/edges/value": TENSOR,
}
# observables of frames, by name
OBSERVABLES = {
    "potential_energy": NUMBER,
    "kinetic_energy": NUMBER,
    "total_energy": NUMBER,
    "conserved_energy": NUMBER,
    "temperature": NUMBER,
    "pressure": NUMBER,
    "work": NUMBER,
    "volume": NUMBER,
    "momentum": VECTOR,
    "angular_momentum": VECTOR,
    "cell": TENSOR,
    "stress": TENSOR,
}
FIELDS |= {f"observables/{name}/value": field for name, field in OBSERVABLES.items()}


def check_fields(values: Iterable[tuple[str, Any]], scene: h5py.Group) -> None:
    """Raise ValueError unless arrays and numbers, by name, are as declared; observers look at their own.
    scene : the group of minimd."""
    sizes = {"N": len(scene["species_index"]), "K": len(scene.get("constraints/pairs", ()))}

    for name, value in values:
        if name.startswith("observer."):
            continue
        array = np.asarray(value)
        field = FIELDS.get(re.sub(r"\d+", "#", name), UNKNOWN)
        kinds = (field.kind,) if field.shape else (REAL, WHOLE)
        shape = tuple(
            array.size if length == "*" else sizes.get(length, length) for length in field.shape
        )
        is_alike = array.dtype in kinds and array.shape == shape
        is_whole = is_alike and (field.kind == REAL or (array == np.rint(array)).all())
        is_inside = is_whole and ((array >= field.least) & (array <= field.most)).all()
        if not is_inside:
            raise ValueError(
                f"{name} is unknown or out of range: type {array.dtype}, shape {array.shape}"
            )
