"""Parameters of laws on lists of things, such as bonds, dihedrals or atoms: one number for all, or one for each."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from minimd.console.words import shown
from minimd.structure.checks import checked_numbers

Array = NDArray[np.float64]


def checked_each(
    things: str, parameters: Mapping[str, ArrayLike], not_negative: tuple[str, ...] = ()
) -> dict[str, Array]:
    """Parameters by name: finite numbers, or (n,) arrays.  things : what there is one for each of, such as "dihedrals".
    Raises ValueError for anything else, and for negative numbers of those named in not_negative."""
    found = {}
    for name, values in parameters.items():
        array = checked_numbers(name, values, f"one number, or one for each of the {things}")
        if array.ndim > 1:
            raise ValueError(f"{name} must be one number, or one for each of the {things}; its shape is {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite; {name} = {shown(array.tolist())}")
        if name in not_negative and (array < 0.0).any():
            raise ValueError(f"{name} must not be negative; {name} = {shown(array.tolist())}")
        found[name] = array
    return found


def columns_of(things: str, parameters: Mapping[str, Array], n: int) -> tuple[Array, ...]:
    """The parameters of each of n things, as contiguous (n,) arrays.
    Raises ValueError for an array of another length."""
    for name, array in parameters.items():
        if array.shape not in ((), (n,)):
            wanted = f"one number or {n}, one for each of the {things}"
            raise ValueError(f"{name} must be {wanted}; its shape is {array.shape}")
    return tuple(np.array(np.broadcast_to(array, n)) for array in parameters.values())  # all of one type for kernels
